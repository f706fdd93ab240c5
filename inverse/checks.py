"""The checks of a problem: a combination that cannot be solved is one line that says what is missing."""

import dataclasses
from collections.abc import Sequence

from datasets.errors import InputError
from datasets.scene import Baffle, Scene
from gns.initial import Start
from inverse.parameters.parameters import kind, swept, with_unknowns
from inverse.settings import (
    ONE_NUMBER,
    Heights,
    LengthUnit,
    LoopSettings,
    Method,
    Observable,
    ObservationSettings,
    OptimiserSettings,
    TargetSettings,
    Unknown,
)


def require(ok: bool, key: str, expected: str, got: object) -> None:
    """Raise InputError unless `ok`."""
    if not ok:
        raise InputError(f"expected {expected}, got {got}", key=key)


def check_unknowns(scene: Scene, unknowns: Sequence[Unknown]) -> None:
    """Raise InputError for unknowns that the scene has not, or with bounds at which it could not be simulated."""
    require(len(unknowns) > 0, "unknowns", "at least one unknown", "none")
    names = [unknown.name for unknown in unknowns]
    for index, unknown in enumerate(unknowns):
        key = f"unknowns[{index}]"
        try:
            kind(unknown.name).check(scene)
        except InputError as error:
            raise InputError(error.message, key=f"{key}.name") from None
        require(names.count(unknown.name) == 1, f"{key}.name", "each unknown once", f"{unknown.name!r} twice")
        require(unknown.lower < unknown.upper, f"{key}.upper", f"a value above {unknown.lower:g}", unknown.upper)
        require(
            unknown.lower <= unknown.initial <= unknown.upper,
            f"{key}.initial",
            f"a value in [{unknown.lower:g}, {unknown.upper:g}]",
            unknown.initial,
        )
        for name in ("step", "learning_rate"):
            value = getattr(unknown, name)
            require(value is None or value > 0.0, f"{key}.{name}", "a positive number", value)
    initial = [unknown.initial for unknown in unknowns]
    _possible(scene, names, initial, "unknowns")
    for index, unknown in enumerate(unknowns):
        for bound in ("lower", "upper"):
            values = [*initial[:index], getattr(unknown, bound), *initial[index + 1 :]]
            _possible(scene, names, values, f"unknowns[{index}].{bound}")
    _check_swept(scene, unknowns)


def _possible(scene: Scene, names: Sequence[str], values: Sequence[float], key: str) -> None:
    """Raise InputError under `key` unless `scene` can be simulated with these values."""
    try:
        with_unknowns(scene, names, values)
    except InputError as error:
        raise InputError(f"expected a scene that can be simulated, but {error}", key=key) from None


def _check_swept(scene: Scene, unknowns: Sequence[Unknown]) -> None:
    """Baffles are boxes that move independently along the axes: all places are clear if the box of all places is."""
    boxes = swept(scene, [unknown.name for unknown in unknowns], [(each.lower, each.upper) for each in unknowns])
    baffles: list[Baffle] = [boxes.get(index, baffle) for index, baffle in enumerate(scene.baffles)]
    try:
        dataclasses.replace(scene, baffles=tuple(baffles))
    except InputError as error:
        message = f"expected bounds between which every scene can be simulated, but over all of them {error}"
        raise InputError(message, key="unknowns") from None


def check_observation(scene: Scene, observation: ObservationSettings) -> None:
    """Raise InputError for an observation that cannot be made of a deposit of `scene`."""
    length = scene.domain.size[0]
    spacing, line, width = observation.spacing, observation.line, observation.width
    if observation.kind is Observable.SEVERAL:
        return  # Each is checked where it is read (`inverse.observations.measurements`).
    require(0.0 < spacing <= length / 2, "observation.spacing", f"a length in (0, {length / 2:g}] m", spacing)
    if observation.kind is Observable.PASSED:
        require(line is not None, "observation.line", "the x [m] of a line that the flow may pass", "none")
        require(0.0 < (line or 0.0) < length, "observation.line", f"a length in (0, {length:g}) m", line)
        require(width is None or 0.0 < width <= length, "observation.width", f"a length in (0, {length:g}] m", width)
        return
    for key in ("line", "width"):
        got = getattr(observation, key)
        require(got is None, f"observation.{key}", f"it with kind passed alone, not with {observation.kind}", got)


def check_target(scene: Scene, names: Sequence[str], observation: ObservationSettings, target: TargetSettings) -> None:
    """Raise InputError for a target that is none of this observation."""
    sources = ("value", "values", "trajectory", "csv")
    given = [name for name in sources if getattr(target, name) is not None]
    given += [name for name in ("hidden", "least") if getattr(target, name)]
    if len(given) != 1:
        got = " and ".join(given) or "none"
        message = f"expected exactly one of {', '.join(sources)}, hidden = true and least = true, got {got}"
        raise InputError(message, key="target")
    observed = observation.kind
    own = {
        **dict.fromkeys(ONE_NUMBER, "value"),
        Observable.TOE: "values",
        Observable.PROFILE: "csv",
    }.get(observed, "")
    if given[0] in ("value", "values", "csv") and given[0] != own:
        others = " or ".join((*([own] if own else []), "trajectory", "hidden = true"))
        raise InputError(f"expected {others} for a target of kind {observed}", key=f"target.{given[0]}")
    if target.least and observed not in ONE_NUMBER:
        raise InputError(f"expected it with {', '.join(ONE_NUMBER)}, not with {observed}", key="target.least")
    if target.value is not None:
        if observed is Observable.PASSED:
            require(0.0 <= target.value <= 1.0, "target.value", "a share in [0, 1]", target.value)
        else:
            length = scene.domain.size[0]
            require(0.0 < target.value <= length, "target.value", f"a length in (0, {length:g}] m", target.value)
    if target.values is not None:
        inside = len(target.values) == scene.dimension and all(
            0.0 <= value <= size for value, size in zip(target.values, scene.domain.size, strict=True)
        )
        expected = f"{scene.dimension} coordinates [m] in the domain {list(scene.domain.size)}"
        require(inside, "target.values", expected, list(target.values))
    require(target.noise >= 0.0, "target.noise", "a standard deviation of at least 0", target.noise)
    require(0.0 <= target.noise_share < 1.0, "target.noise_share", "a share in [0, 1)", target.noise_share)
    if target.noise_share > 0.0 and target.value is None and target.csv is None:
        raise InputError("expected a percentage beside value or csv alone, else a length", key="target.noise")
    if target.csv is None:
        for key, usual in (("unit", LengthUnit.METRE), ("datum", 0.0), ("heights", Heights.EQUIVALENT)):
            got = getattr(target, key)
            require(got == usual, f"target.{key}", "it beside a csv alone", got)
    if target.hidden:
        _check_hidden(scene, names, target)
    elif target.truth:
        raise InputError("expected hidden = true beside a truth", key="target.truth")


def check_several(scene: Scene, names: Sequence[str], observation: ObservationSettings, target: TargetSettings) -> None:
    """Raise InputError for a target beside several observations that is neither hidden nor a trajectory."""
    require(observation.kind is Observable.SEVERAL, "observation.kind", "several", observation.kind)
    allowed = ("hidden", "seed", "truth", "trajectory")
    for part in dataclasses.fields(target):
        usual = part.default if part.default is not dataclasses.MISSING else {}
        if part.name not in allowed and getattr(target, part.name) != usual:
            message = f"expected {', '.join(allowed)} beside several observations, which bring the rest themselves"
            raise InputError(message, key=f"target.{part.name}")
    if target.hidden and target.trajectory is not None:
        raise InputError("expected hidden = true or a trajectory, got both", key="target")
    if target.hidden:
        _check_hidden(scene, names, target)
    elif target.truth:
        raise InputError("expected hidden = true beside a truth", key="target.truth")


def _check_hidden(scene: Scene, names: Sequence[str], target: TargetSettings) -> None:
    if target.seed < 0 or target.seed == scene.seed:
        raise InputError(f"expected a seed of at least 0 and other than the scene's {scene.seed}", key="target.seed")
    for name in target.truth:
        if name not in names:
            raise InputError(f"expected one of the unknowns {', '.join(names)}", key=f"target.truth.{name}")
    _possible(scene, list(target.truth), list(target.truth.values()), "target.truth")


def check_search(
    unknowns: Sequence[Unknown], observation: ObservationSettings, optimiser: OptimiserSettings, loop: LoopSettings
) -> None:
    """Raise InputError for a search that cannot be made."""
    for key, number, least in (
        ("optimiser.max_iterations", optimiser.max_iterations, 1),
        ("optimiser.max_trials", optimiser.max_trials, 1),
        ("optimiser.seed", optimiser.seed, 0),
        ("optimiser.starts", optimiser.starts, 1),
        ("loop.mpm_runs", loop.mpm_runs, 1),
        ("loop.seeds", loop.seeds, 2),
    ):
        require(number >= least, key, f"an integer of at least {least}", number)
    for key, value, most in (
        ("optimiser.stop_below", optimiser.stop_below, 1.0),
        ("optimiser.learning_rate", optimiser.learning_rate, 1e9),
        ("loop.confirm_within", loop.confirm_within, 1.0),
        ("loop.profile_within", loop.profile_within, 1.0),
        ("loop.runout_within", loop.runout_within, 1.0),
        ("loop.toe_within", loop.toe_within, 100.0),
        ("loop.deposit_within", loop.deposit_within, 100.0),
        ("loop.passed_within", loop.passed_within, 1.0),
        ("loop.several_within", loop.several_within, 100.0),
        ("loop.trust", loop.trust, 1.0),
    ):
        require(value is None or 0.0 < value <= most, key, f"a number in (0, {most:g}]", value)
    if optimiser.start is Start.FROM_MPM_FRAMES:
        for unknown in unknowns:
            if kind(unknown.name).moves_the_start:
                message = f"expected rest, the MPM's first frames depend on {unknown.name}"
                raise InputError(message, key="optimiser.start")
    if observation.kind is Observable.DEPOSIT:
        for unknown in unknowns:
            if kind(unknown.name).changes_volume:
                message = f"expected another kind than deposit: with {unknown.name} the number of particles changes"
                raise InputError(message, key="observation.kind")
    if optimiser.method is Method.GAUSS_NEWTON and observation.kind is Observable.DEPOSIT:
        others = " or ".join(method for method in Method if method is not Method.GAUSS_NEWTON)
        raise InputError(f"expected {others}: a deposit is too many numbers for their Jacobian", key="optimiser.method")
