"""The checks of a problem: a combination that has no answer is one line that says what is missing."""

import dataclasses
from collections.abc import Sequence

from datasets.errors import InputError
from datasets.scene import Baffle, Scene
from inverse.observations import KINDS, build
from inverse.parameters import Vector, with_kinds
from inverse.parameters.baffles import swept
from inverse.settings import (
    MEASURED,
    LoopSettings,
    Method,
    ObservationSettings,
    OptimiserSettings,
    Parameter,
    TargetSettings,
    noise_of,
)

FEWEST_RUNS = 5
"""MPM runs besides one for each unknown: a trend, its error, and one at the answer."""


def require(ok: bool, key: str, expected: str, got: object) -> None:
    """Raise InputError unless `ok`."""
    if not ok:
        raise InputError(f"expected {expected}, got {got}", key=key)


def check_parameters(scene: Scene, parameters: Sequence[Parameter]) -> None:
    """Raise InputError for parameters that the scene has not, or with bounds at which it could not be simulated."""
    require(len(parameters) > 0, "unknowns", "at least one unknown", "none")
    names = [each.name for each in parameters]
    for index, each in enumerate(parameters):
        key = f"unknowns[{index}]"
        try:
            each.kind.check(scene)
        except InputError as error:
            raise InputError(error.message, key=f"{key}.name") from None
        require(names.count(each.name) == 1, f"{key}.name", "each unknown once", f"{each.name!r} twice")
        require(each.lower < each.upper, f"{key}.upper", f"a value above {each.lower:g}", each.upper)
        inside = each.lower <= each.initial <= each.upper
        require(inside, f"{key}.initial", f"a value in [{each.lower:g}, {each.upper:g}]", each.initial)
        for name in ("step", "learning_rate"):
            value = getattr(each, name)
            require(value is None or value > 0.0, f"{key}.{name}", "a positive number", value)
    initial = [each.initial for each in parameters]
    _check_scene(scene, parameters, initial, "unknowns")
    apart = [index for index, each in enumerate(parameters) if not each.kind.independent]
    # A thousand velocities would be a thousand scenes: those that no other parameter bears on are tried together.
    for bound in ("lower", "upper"):
        together = [
            value if index in apart else getattr(parameters[index], bound) for index, value in enumerate(initial)
        ]
        try:
            _check_scene(scene, parameters, together, "unknowns")
        except InputError:
            apart = list(range(len(parameters)))
    for index in apart:
        each = parameters[index]
        for bound in ("lower", "upper"):
            values = [*initial[:index], getattr(each, bound), *initial[index + 1 :]]
            _check_scene(scene, parameters, values, f"unknowns[{index}].{bound}")
    # Baffles are boxes that move independently along the axes: all positions are clear if the box of them all is.
    boxes = swept(scene, [each.kind for each in parameters], [(each.lower, each.upper) for each in parameters])
    baffles: list[Baffle] = [boxes.get(index, baffle) for index, baffle in enumerate(scene.baffles)]
    try:
        dataclasses.replace(scene, baffles=tuple(baffles))
    except InputError as error:
        message = f"expected bounds between which every scene can be simulated, but over all of them {error}"
        raise InputError(message, key="unknowns") from None


def _check_scene(scene: Scene, parameters: Sequence[Parameter], values: Sequence[float] | Vector, key: str) -> None:
    """Raise InputError under `key` unless `scene` can be simulated with these values."""
    try:
        with_kinds(scene, [each.kind for each in parameters], values)
    except InputError as error:
        raise InputError(f"expected a scene that can be simulated, but {error}", key=key) from None


def check_options(settings: ObservationSettings, prefix: str) -> None:
    """Raise InputError for a kind that is not there, or for keys that its observation does not use."""
    if settings.kind not in KINDS:
        raise InputError(f"expected one of {', '.join(KINDS)}, got {settings.kind!r}", key=f"{prefix}.kind")
    kind = KINDS[settings.kind]
    used = ("kind", "name", "noise", *kind.sources, *kind.options)
    for field in dataclasses.fields(settings):
        if field.name not in used and getattr(settings, field.name) != field.default:
            users = [name for name, each in KINDS.items() if field.name in (*each.sources, *each.options)]
            message = f"expected it with kind {' or '.join(users)} alone, not with {settings.kind}"
            raise InputError(message, key=f"{prefix}.{field.name}")


def check_observation(scene: Scene, settings: ObservationSettings) -> None:
    """Raise InputError for a problem's only observation that cannot be made of a flow of `scene`."""
    check_options(settings, "observation")
    if not KINDS[settings.kind].alone:
        alone = ", ".join(name for name, kind in KINDS.items() if kind.alone)
        raise InputError(f"expected one of {alone}; others stand in [[observations]]", key="observation.kind")
    for key in ("name", *MEASURED):
        usual = next(field.default for field in dataclasses.fields(settings) if field.name == key)
        require(getattr(settings, key) == usual, f"observation.{key}", "it in [target]", getattr(settings, key))
    try:
        build(settings, scene)
    except InputError as error:
        raise InputError(error.message, key=f"observation.{error.key}") from None


def check_observations(settings: Sequence[ObservationSettings], target: TargetSettings) -> None:
    """Raise InputError for observations that cannot be joined, or a target beside them that is no simulated flow."""
    check_joined(settings)
    allowed = ("twin", "seed", "truth", "trajectory")
    for field in dataclasses.fields(target):
        usual = field.default if field.default is not dataclasses.MISSING else {}
        if field.name not in allowed and getattr(target, field.name) != usual:
            message = f"expected {', '.join(allowed)} beside multiple observations, which bring the rest themselves"
            raise InputError(message, key=f"target.{field.name}")
    if target.twin and target.trajectory is not None:
        raise InputError("expected twin = true or a trajectory, got both", key="target")


def check_joined(settings: Sequence[ObservationSettings]) -> None:
    """Raise InputError for observations that cannot be joined."""
    for index, each in enumerate(settings):
        check_options(each, f"observations[{index}]")
        if not KINDS[each.kind].jointly:
            joined = ", ".join(name for name, kind in KINDS.items() if kind.jointly)
            raise InputError(f"expected one of {joined}, got {each.kind!r}", key=f"observations[{index}].kind")


def check_target(scene: Scene, observation: ObservationSettings, target: TargetSettings) -> None:
    """Raise InputError for a target that is none of this observation."""
    kind = KINDS[observation.kind]
    sources = ("value", "values", "trajectory", "csv")
    given = [name for name in sources if getattr(target, name) is not None]
    given += [name for name in ("twin", "minimise") if getattr(target, name)]
    if len(given) != 1:
        got = " and ".join(given) or "none"
        message = f"expected exactly one of {', '.join(sources)}, twin = true and minimise = true, got {got}"
        raise InputError(message, key="target")
    (source,) = given
    if source in ("value", "values", "csv") and source not in kind.sources:
        others = " or ".join((*kind.sources, "trajectory", "twin = true"))
        raise InputError(f"expected {others} for a target of kind {observation.kind}", key=f"target.{source}")
    if target.minimise and not kind.scalar:
        scalar = ", ".join(name for name, each in KINDS.items() if each.scalar)
        raise InputError(f"expected it with {scalar}, not with {observation.kind}", key="target.minimise")
    try:
        share, _ = noise_of(target.noise)
        stated = {name: getattr(target, name) for name in ("value", "values")}
        build(observation, scene).stated(dataclasses.replace(observation, **stated), scene)
    except InputError as error:
        raise InputError(error.message, key=f"target.{error.key}") from None
    if share > 0.0 and source not in ("value", "csv"):
        raise InputError("expected a percentage beside value or csv alone, else a length", key="target.noise")
    if target.csv is None:
        for key in ("unit", "datum", "heights"):
            usual = next(field.default for field in dataclasses.fields(target) if field.name == key)
            require(getattr(target, key) == usual, f"target.{key}", "it beside a csv alone", getattr(target, key))


def check_twin(scene: Scene, parameters: Sequence[Parameter], target: TargetSettings) -> None:
    """Raise InputError for a twin whose scene is not another one than the inversion's, or cannot be simulated."""
    if not target.twin:
        require(not target.truth, "target.truth", "twin = true beside a truth", "none")
        return
    if target.seed < 0 or target.seed == scene.seed:
        raise InputError(f"expected a seed of at least 0 and other than the scene's {scene.seed}", key="target.seed")
    known = {each.name: each for each in parameters}
    for name in target.truth:
        if name not in known:
            raise InputError(f"expected one of the unknowns {', '.join(known)}", key=f"target.truth.{name}")
    true = [known[name] for name in target.truth]
    _check_scene(scene, true, list(target.truth.values()), "target.truth")


def check_search(
    parameters: Sequence[Parameter],
    observation: ObservationSettings,
    optimiser: OptimiserSettings,
    loop: LoopSettings,
) -> None:
    """Raise InputError for a search that cannot be made."""
    for key, number, minimum in (
        ("optimiser.max_iterations", optimiser.max_iterations, 1),
        ("optimiser.max_trials", optimiser.max_trials, 1),
        ("optimiser.seed", optimiser.seed, 0),
        ("loop.mpm_runs", loop.budget(len(parameters)), len(parameters) + FEWEST_RUNS),
    ):
        require(number >= minimum, key, f"an integer of at least {minimum}", number)
    for key, value, maximum in (
        ("optimiser.stop_below", optimiser.stop_below, 1.0),
        ("optimiser.learning_rate", optimiser.learning_rate, 1e9),
        ("loop.confirm_within", loop.confirm_within, 1.0),
        ("loop.profile_within", loop.profile_within, 1.0),
        ("loop.runout_within", loop.runout_within, 1.0),
        ("loop.toe_within", loop.toe_within, 100.0),
        ("loop.deposit_within", loop.deposit_within, 100.0),
        ("loop.passed_within", loop.passed_within, 1.0),
        ("loop.joint_within", loop.joint_within, 100.0),
        ("loop.mpm_seconds", loop.mpm_seconds, 1e9),
    ):
        require(value is None or 0.0 < value <= maximum, key, f"a number in (0, {maximum:g}]", value)
    every_particle = KINDS[observation.kind].every_particle
    for each in parameters:
        if every_particle and each.kind.changes_volume:
            message = f"expected another kind than {observation.kind}: with {each.name} the number of particles changes"
            raise InputError(message, key="observation.kind")
    if every_particle and optimiser.method is Method.GAUSS_NEWTON:
        others = " or ".join(method for method in Method if method is not Method.GAUSS_NEWTON)
        raise InputError(
            f"expected {others}: a {observation.kind} is too many numbers for their Jacobian", key="optimiser.method"
        )
