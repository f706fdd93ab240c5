"""The checks of a problem: a combination that has no answer is one line that says what is missing."""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import qmc

from datasets.errors import InputError, require
from datasets.field import FRICTION
from datasets.scene import Scene
from inverse.observations import KINDS, build
from inverse.parameters import Parameter, known_names, with_kinds
from inverse.parameters.prior import JointPrior
from inverse.settings import noise_of

if TYPE_CHECKING:
    from inverse.problem import Problem

FEWEST_RUNS = 5
"""MPM runs besides one for each unknown: a trend, its error, and one at the answer."""
MOST = 1_000_000
"""Of runs, draws and iterations: more would take years, and memory that no machine has."""
FILLING = 32
"""Points by which the box of the bounds is filled, and corners of it, that are tried."""
OF_FIELDS = ("mean", "deviation", "length")
"""Keys that an unknown has as a field alone."""
OF_NUMBERS = ("initial", "prior")
"""Keys that it has as a number alone."""


def check(problem: "Problem") -> None:
    """Raise InputError, which names the key, for a problem that has no answer."""
    check_parameters(problem.scene, problem.parameters)
    if problem.correlations:
        # It refuses pairs that are none.
        JointPrior(problem.numbers, problem.correlations)
    check_observations(problem)
    check_target(problem)
    check_search(problem)
    if any(each.is_field for each in problem.parameters):
        check_fields(problem)


def check_parameters(scene: Scene, parameters: Sequence[Parameter]) -> None:
    """Raise InputError for parameters that the scene has not, or with bounds at which it could not be simulated."""
    require(len(parameters) > 0, "unknowns", "at least one unknown", "none")
    names = [each.name for each in parameters]
    for index, each in enumerate(parameters):
        key = f"unknowns[{index}]"
        require(names.count(each.name) == 1, f"{key}.name", "each unknown once", f"{each.name!r} twice")
        start = () if each.prior is not None else ("initial",)
        needed = OF_FIELDS if each.is_field else (*start, "lower", "upper")
        for name in needed:
            require(getattr(each, name) is not None, f"{key}.{name}", "a value", "none, the key is missing")
        for name in OF_NUMBERS if each.is_field else OF_FIELDS:
            kind = "number" if each.is_field else "field, which has a spacing"
            require(getattr(each, name) is None, f"{key}.{name}", f"it of a {kind}, alone", getattr(each, name))
        if not each.is_field:
            check_number(scene, each, key)
    numbers = {f"unknowns[{index}]": each for index, each in enumerate(parameters) if not each.is_field}
    if numbers:
        check_bounds(scene, numbers, "unknowns")


def check_number(scene: Scene, parameter: Parameter, key: str) -> None:
    """Raise InputError for a number that `scene` has not, or with bounds that are none."""
    try:
        parameter.kind.check(scene)
    except InputError as error:
        message = error.message
        if message.startswith("expected one of"):
            message = f"expected one of {', '.join(known_names(scene))}, which the scene has, got {parameter.name!r}"
        raise InputError(message, key=f"{key}.name") from None
    lower, upper = parameter.bounds
    require(lower < upper, f"{key}.upper", f"a value above {lower:g}", upper)
    if parameter.prior is not None:
        parameter.prior.check(lower, upper, f"{key}.prior")
    require(lower <= parameter.start <= upper, f"{key}.initial", f"a value in [{lower:g}, {upper:g}]", parameter.start)


def check_bounds(scene: Scene, numbers: Mapping[str, Parameter], key: str) -> None:
    """Raise InputError for numbers by their keys, between whose bounds not every scene can be simulated.

    key: of all together.
    """
    parameters = [*numbers.values()]
    initial, bounds = [each.start for each in parameters], [each.bounds for each in parameters]
    _check_scene(scene, parameters, initial, key)
    lower, upper = np.array(bounds).T
    corners = [*itertools.islice(itertools.product(*bounds), FILLING), upper.tolist()]
    inside = lower + (upper - lower) * qmc.Sobol(len(bounds), seed=0).random(FILLING)
    for values in (*corners, *inside.tolist()):
        try:
            _check_scene(scene, parameters, values, key)
        except InputError as error:
            # One bound by itself, if there is such a one, says more.
            for row, (own, each) in enumerate(numbers.items()):
                for name, bound in zip(("lower", "upper"), each.bounds, strict=True):
                    alone = [*initial[:row], bound, *initial[row + 1 :]]
                    _check_scene(scene, parameters, alone, f"{own}.{name}")
            where = ", ".join(f"{each.name} = {value:.4g}" for each, value in zip(parameters, values, strict=True))
            raise InputError(f"{error.message} with {where}, all within their bounds", key=key) from None


def _check_scene(scene: Scene, parameters: Sequence[Parameter], values: Sequence[float], key: str) -> None:
    """Raise InputError under `key` unless `scene` can be simulated with these values."""
    try:
        with_kinds(scene, [each.kind for each in parameters], values)
    except InputError as error:
        raise InputError(f"expected a scene that can be simulated, but {error}", key=key) from None


def check_fields(problem: "Problem") -> None:
    """Raise InputError for fields that the adjoint cannot find, or a twin without their truth."""
    scene, target = problem.scene, problem.target
    indices = [index for index, each in enumerate(problem.parameters) if each.is_field]
    own = {(each.quantity, each.mass) for each in scene.fields}
    for index, each in zip(indices, problem.fields, strict=True):
        settings, key = each.settings, f"unknowns[{index}]"
        for name, bound in (("lower", settings.lower), ("upper", settings.upper)):
            others = tuple(other for other in scene.fields if other.quantity != settings.quantity)
            try:
                if bound is not None:
                    dataclasses.replace(scene, fields=(*others, each.uniform(bound)))
            except InputError as error:
                message = f"expected a bound at which the scene can be simulated, but {error}"
                raise InputError(message, key=f"{key}.{name}") from None
        known = not target.twin or (settings.quantity, settings.mass) in own
        require(known, f"{key}.name", f"a scene with a field of {each.name} as the truth", "none")
        if settings.quantity == FRICTION:
            expected = "a body without initial stress, whose yield depends on an unknown friction"
            for number, mass in enumerate(scene.masses):
                require(mass.k0 is None, f"scene.masses[{number}].k0", expected, mass.k0)
    for index, parameter in enumerate(problem.parameters):
        require(parameter.prior is None, f"unknowns[{index}].prior", "none beside a field", "one")
    require(not problem.correlations, "correlations", "none beside a field", "some")
    for index, kind in enumerate(each.kind for each in problem.observations):
        operator = KINDS[kind]
        jointly = operator.of_positions and not operator.every_particle
        require(jointly, f"observations[{index}].kind", "an observation of positions of few numbers", kind)
    expected = f"none of the {len(problem.seeds)} seeds from {problem.seeds[0]} on, which the search has"
    other = target.seed not in problem.seeds or not target.twin
    require(other, "target.seed", expected, target.seed)


def check_observations(problem: "Problem") -> None:
    """Raise InputError for observations that cannot be made of a flow of the scene, or compared with each other."""
    observations, target = problem.observations, problem.target
    require(len(observations) > 0, "observations", "at least one observation", "none")
    for index, settings in enumerate(observations):
        prefix = f"observations[{index}]"
        require(settings.kind in KINDS, f"{prefix}.kind", f"one of {', '.join(KINDS)}", repr(settings.kind))
        kind = KINDS[settings.kind]
        used = ("kind", "name", "noise", *kind.sources, *kind.options)
        for field in dataclasses.fields(settings):
            if field.name not in used and getattr(settings, field.name) != field.default:
                users = [name for name, each in KINDS.items() if field.name in (*each.sources, *each.options)]
                message = f"expected it with kind {' or '.join(users)} alone, not with {settings.kind}"
                raise InputError(message, key=f"{prefix}.{field.name}")
        given = [name for name in ("value", "values", "csv") if getattr(settings, name) is not None]
        require(len(given) < 2, prefix, "one of value, values and csv", " and ".join(given))
        alone = len(observations) == 1 or not kind.every_particle
        require(alone, f"{prefix}.kind", "an observation of few numbers beside others", repr(settings.kind))
        try:
            noise_of(settings.noise)
            if settings.csv is None:
                build(settings, problem.scene).stated(settings)
        except InputError as error:
            raise InputError(error.message, key=f"{prefix}.{error.key}") from None
        if target.measured and not given:
            message = f"expected what was measured for {settings.kind}: {' or '.join(kind.sources) or 'a trajectory'}"
            raise InputError(f"{message}; or twin or a trajectory in [target]", key=prefix)
        require(target.measured or not given, prefix, "no numbers beside those of [target]", " and ".join(given))


def check_target(problem: "Problem") -> None:
    """Raise InputError for two sources of numbers, a twin that is the inversion's own flow, or one without a truth."""
    scene, target = problem.scene, problem.target
    both = target.twin and target.trajectory is not None
    require(not both, "target", "one of twin = true and trajectory", "twin and trajectory")
    if not target.twin:
        require(not target.truth, "target.truth", "twin = true beside a truth", "none")
        require(target.cell is None, "target.cell", "twin = true beside cells of the twin", "none")
        return
    other = target.seed >= 0 and target.seed != scene.seed
    require(other, "target.seed", f"a seed of at least 0 and other than the scene's {scene.seed}", target.seed)
    known = {each.name: each for each in problem.numbers}
    for name in target.truth:
        require(name in known, f"target.truth.{name}", f"one of the unknowns {', '.join(known)}", name)
    _check_scene(scene, [known[name] for name in target.truth], list(target.truth.values()), "target.truth")
    if target.cell is not None:
        try:
            scene.with_cell(target.cell)
        except InputError as error:
            message = f"expected cells of which the box is a whole number, but {error}"
            raise InputError(message, key="target.cell") from None
        single = [each.kind for each in problem.observations if KINDS[each.kind].every_particle]
        require(not single, "target.cell", "an observation other than of every particle", "".join(single))


def check_search(problem: "Problem") -> None:
    """Raise InputError for a search that cannot be made."""
    optimiser, unknowns, kind = problem.optimiser, len(problem.parameters), problem.observations[0].kind
    for key, number, minimum in (
        ("optimiser.max_iterations", optimiser.max_iterations, 1),
        ("optimiser.seed", optimiser.seed, 0),
        ("optimiser.seeds", optimiser.seeds, 1),
        ("optimiser.ensemble", optimiser.ensemble, 4),
        ("loop.mpm_runs", problem.loop.budget(unknowns), unknowns + FEWEST_RUNS),
    ):
        require(number >= minimum, key, f"an integer of at least {minimum}", number)
        most = 2**62 if key.endswith(".seed") else MOST
        require(number <= most, key, f"an integer of at most {most}", number)
    for each in problem.numbers:
        fixed = not (KINDS[kind].every_particle and each.kind.changes_volume)
        expected = f"another kind: with {each.name} the number of particles changes"
        require(fixed, "observations[0].kind", expected, kind)
