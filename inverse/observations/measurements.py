"""From `[[observations]]` to what is compared: each one's places and times, its numbers and how well they are known."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets import measures
from datasets.errors import InputError
from datasets.records import fraction
from datasets.scene import Scene
from datasets.trajectory import Trajectory, solid_names
from inverse.observations.combined import Combined, Part, observed
from inverse.observations.deposit import Front, Observation, Passed, Runout, Toe, Values
from inverse.observations.over_time import FrontOverTime, Gauges, Impulse, Outline, PeakForce
from inverse.observations.profile import MeasuredProfile, check_box, profile_of, read_columns
from inverse.observations.sampled import SampledProfile, sampled
from inverse.observations.target import Target, deviation_of, hidden_scene, observation_of, read_target
from inverse.parameters.parameters import kind
from inverse.problem import Problem
from inverse.settings import Measurable, MeasurementSettings

CHANCE_CELLS = 0.25
"""Standard deviation of a length by the chance of one flow before an ensemble has measured it, in cells."""
CHANCE_OF_A_SHARE = 0.005
"""The same of a share that passed [-]."""
CHANCE_OF_A_FORCE = 0.05
"""The same of an impulse or a force, as a share of it."""
DIRECTIONS_DEG = np.arange(0.0, 360.0, 22.5)
"""Of an outline, where none are named."""

Matrix = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """One observation and what it measured."""

    settings: MeasurementSettings
    observation: Observation
    values: Values | None
    """In its unit, shape [M]; None where a run makes them."""
    profile: MeasuredProfile | None = None
    """Where it is one."""

    def covariance(self, values: Values, profile: MeasuredProfile | None, cell: float) -> tuple[Matrix, float]:
        """Of `values` [M] by errors of the measurement, shape [M, M], and how much rougher a profile is than stated.

        profile: the one that was measured, where it is one; cell: of the grid [m].
        """
        share, noise = noise_of(self.settings)
        if isinstance(self.observation, SampledProfile):
            assert profile is not None
            deviation, rough = deviation_of(profile, share=share, noise=noise, cell=cell)
            return self.observation.covariance(profile, deviation), rough
        return np.diag((share * values) ** 2 + noise**2), 1.0

    def chance(self, values: Values, cell: float) -> Values:
        """What each of `values` [M] is expected to scatter from flow to flow, shape [M]."""
        match self.settings.kind:
            case Measurable.PASSED:
                return np.full(len(values), CHANCE_OF_A_SHARE)
            case Measurable.IMPULSE | Measurable.PEAK_FORCE:
                return np.asarray(CHANCE_OF_A_FORCE * np.maximum(np.abs(values), 0.1 * np.abs(values).max()))
            case _:
                return np.full(len(values), CHANCE_CELLS * cell)


def prepare(problem: Problem, simulate: Callable[[Scene], Trajectory]) -> tuple[Observation, Target]:
    """What is compared in `problem`, and its target; a hidden one is made with `simulate`. Raises InputError."""
    if not problem.observations:
        observation = observation_of(problem)
        return observation, read_target(problem, observation, simulate)
    found = measurements(problem)
    hidden, truth = None, None
    if problem.target.hidden:
        scene = hidden_scene(problem)
        hidden = simulate(scene)
        truth = {name: kind(name).read(scene) for name in problem.names}
    elif problem.target.trajectory is not None:
        hidden = Trajectory.load(problem.folder / problem.target.trajectory)
    values: list[Values] = []
    chance: list[Values] = []
    covariance: list[Matrix] = []
    parts: list[Part] = []
    rough = 1.0
    for number, each in enumerate(found):
        profile = each.profile
        own = each.values
        if own is None:
            assert hidden is not None, "a problem has been checked"
            own = observed([each.observation], hidden)
            if isinstance(each.observation, SampledProfile):
                rows = each.observation.stations
                profile = MeasuredProfile(x=rows, height=each.observation.heights(hidden.positions[-1]))
        own_covariance, own_rough = each.covariance(own, profile, problem.scene.domain.cell)
        first = sum(len(before) for before in values)
        name = each.settings.name or named(each.settings, [other.settings for other in found[:number]])
        parts.append(Part(name=name, observation=each.observation, numbers=slice(first, first + len(own))))
        values.append(own)
        covariance.append(own_covariance)
        chance.append(each.chance(own, problem.scene.domain.cell))
        rough = max(rough, own_rough)
    noise, by_chance = np.concatenate([np.diag(each) for each in covariance]), np.concatenate(chance)
    scale = np.sqrt(noise + by_chance**2)
    if not np.all(scale > 0.0):
        name = next(part.name for part in parts if not np.all(scale[part.numbers] > 0.0))
        raise InputError(f"expected a noise above 0 for {name}, whose numbers are all 0", key="observations")
    combined = Combined(parts, scale, by_chance)
    whole = blocks(covariance) / np.outer(scale, scale)
    deposit = None if hidden is None else hidden.positions[-1]
    return combined, Target(
        values=np.concatenate(values) / scale,
        edge=float("nan") if deposit is None else measures.front(deposit),
        deposit=deposit,
        roughness=rough,
        noise=float(np.sqrt(np.linalg.eigvalsh(whole)[-1])),
        covariance=whole,
        truth=truth,
        combined=combined,
    )


def measurements(problem: Problem) -> list[Measurement]:
    """Every observation of `problem`. Raises InputError, which names the file or the key."""
    given = not problem.target.hidden and problem.target.trajectory is None
    found = []
    for index, settings in enumerate(problem.observations):
        try:
            found.append(measurement(problem, settings, given=given))
        except InputError as error:
            if error.where:
                raise
            key = ".".join(part for part in (f"observations[{index}]", error.key) if part)
            raise InputError(error.message, key=key) from None
    return found


def measurement(problem: Problem, settings: MeasurementSettings, *, given: bool) -> Measurement:
    """One observation of `problem`; given: with its numbers. Raises InputError, which names the key or the file."""
    scene, length = problem.scene, problem.scene.domain.size[0]
    noise_of(settings)

    def made(observation: Observation, values: Values | None, profile: MeasuredProfile | None = None) -> Measurement:
        if given and (values is None or len(values) == 0):
            raise InputError(f"expected what was measured for {settings.kind}: {SOURCES[settings.kind]}")
        if not given and values is not None:
            raise InputError("expected no numbers beside a hidden target or a trajectory")
        return Measurement(settings=settings, observation=observation, values=values, profile=profile)

    number = None if settings.value is None else np.array([settings.value])
    numbers = None if settings.values is None else np.array(settings.values)
    times = None if settings.times is None else moments(np.array(settings.times), scene)
    match settings.kind:
        case Measurable.FRONT:
            return made(Front(), number)
        case Measurable.RUNOUT:
            return made(Runout(scene), number)
        case Measurable.PASSED:
            if settings.line is None or not 0.0 < settings.line < length:
                raise InputError(f"expected a length in (0, {length:g}) m, got {settings.line}", key="line")
            return made(Passed(scene, settings.line, scene.domain.cell), number)
        case Measurable.TOE:
            return made(Toe(scene), sized(numbers, scene.dimension))
        case Measurable.PROFILE:
            if not given:
                rows = stations(scene, settings.spacing)
                return made(sampled(settings.heights)(scene, settings.spacing, rows), None)
            profile = profile_of(
                problem.folder / str(settings.csv),
                unit=settings.unit,
                datum=settings.datum,
                heights=settings.heights,
                length=length,
                released=None if problem.changes_volume else problem.released,
                ground=problem.ground,
            )
            seen = sampled(settings.heights)(scene, settings.spacing, profile.x)
            return made(seen, seen.of_heights(profile.at(seen.stations)), profile)
        case Measurable.FRONT_OVER_TIME:
            if settings.csv is not None:
                path, metres = problem.folder / settings.csv, settings.unit.metres
                when, fronts = read_columns(path, ("time", "front"))
                return made(FrontOverTime(moments(when, scene, path)), inside(fronts * metres, length, path))
            if times is None:
                raise InputError("expected the times [s] of the fronts", key="times")
            return made(FrontOverTime(times), sized(numbers, len(times)))
        case Measurable.HEIGHT:
            return made(*gauges(problem, settings, numbers, times))
        case Measurable.IMPULSE:
            taker = solid(scene, settings)
            if settings.csv is not None:
                path = problem.folder / settings.csv
                when, taken = read_columns(path, ("time", "impulse"))
                return made(Impulse(taker, settings.axis, moments(when, scene, path)), taken)
            if times is not None:
                return made(Impulse(taker, settings.axis, times), sized(numbers, len(times)))
            return made(Impulse(taker, settings.axis), number)
        case Measurable.PEAK_FORCE:
            taker = solid(scene, settings)
            if not 0.0 < settings.window <= scene.duration:
                raise InputError(f"expected a time in (0, {scene.duration:g}] s, got {settings.window}", key="window")
            return made(PeakForce(taker, settings.axis, settings.window), number)
        case Measurable.OUTLINE:
            if scene.dimension != 3:
                raise InputError("expected a scene in 3D for an outline", key="kind")
            named_deg = settings.directions_deg
            outline = Outline(scene, DIRECTIONS_DEG if named_deg is None else np.array(named_deg))
            if settings.csv is None:
                return made(outline, sized(numbers, outline.directions.shape[1]))
            path = problem.folder / settings.csv
            line = np.stack(read_columns(path, ("x", "z")), axis=1) * settings.unit.metres
            inside(line[:, 0], length, path)
            return made(outline, outline.of_line(line))


SOURCES = {
    **dict.fromkeys((Measurable.FRONT, Measurable.RUNOUT, Measurable.PASSED, Measurable.PEAK_FORCE), "value"),
    Measurable.TOE: "values",
    Measurable.PROFILE: "csv",
    Measurable.FRONT_OVER_TIME: "csv, or values at times",
    Measurable.HEIGHT: "csv, or values at x",
    Measurable.IMPULSE: "value, csv, or values at times",
    Measurable.OUTLINE: "csv, or values in directions_deg",
}
"""Where the numbers of each kind stand."""


def gauges(
    problem: Problem, settings: MeasurementSettings, numbers: Values | None, times: Values | None
) -> tuple[Gauges, Values | None]:
    """Gauges and what they read. Raises InputError."""
    scene, length = problem.scene, problem.scene.domain.size[0]
    if settings.z is not None and (scene.dimension != 3 or not 0.0 <= settings.z <= scene.domain.size[2]):
        raise InputError(f"expected a z inside a box in 3D, got {settings.z:g}", key="z")
    values: Values | None
    if settings.csv is not None:
        path, metres = problem.folder / settings.csv, settings.unit.metres
        columns = read_columns(path, ("x", "height"), optional=("time",))
        places, values = columns[0] * metres, (columns[1] - settings.datum) * metres
        inside(places, length, path)
        when = moments(columns[2], scene, path) if len(columns) > 2 else None
    else:
        if settings.x is None:
            raise InputError("expected the x [m] of the gauges", key="x")
        places = inside(np.array(settings.x), length, None)
        when = times
        if when is not None and len(when) != len(places):
            # Every gauge at every time, one gauge after the other.
            places, when = np.repeat(places, len(when)), np.tile(when, len(places))
        values = sized(numbers, len(places))
    return Gauges(scene, places, spacing=settings.spacing, z=settings.z, times=when), values


def sized(numbers: Values | None, count: int) -> Values | None:
    """`numbers`, which have to be so many. Raises InputError."""
    if numbers is not None and len(numbers) != count:
        raise InputError(f"expected {count} numbers, got {len(numbers)}", key="values")
    return numbers


def inside(x: Values, length: float, path: Path | None) -> Values:
    """`x` [m], which have to lie in the box of `length` [m]. Raises InputError."""
    try:
        check_box(x, length)
    except InputError as error:
        raise (error if path is None else error.at(str(path))) from None
    return x


def moments(times: Values, scene: Scene, path: Path | None = None) -> Values:
    """`times` [s], which the scene has to last for. Raises InputError."""
    if not np.all((times >= 0.0) & (times <= scene.duration * (1.0 + 1e-9))):
        got = times[(times < 0.0) | (times > scene.duration)][0]
        message = f"expected times in [0, {scene.duration:g}] s, which the scene lasts, got {got:g}"
        raise InputError(message, where="" if path is None else str(path), key="" if path else "times")
    return times


def solid(scene: Scene, settings: MeasurementSettings) -> int:
    """The number of the solid that took an impulse along an axis of the scene. Raises InputError."""
    names, asked = solid_names(scene), settings.solid
    number = names.index(asked) if isinstance(asked, str) and asked in names else asked
    if isinstance(number, str) or not 0 <= number < len(names):
        known = ", ".join(names) or "none, the scene has no solids"
        raise InputError(f"expected one of {known}, or its number from 0, got {asked!r}", key="solid")
    if not 0 <= settings.axis < scene.dimension:
        raise InputError(f"expected an index below {scene.dimension}, got {settings.axis}", key="axis")
    return number


def noise_of(settings: MeasurementSettings) -> tuple[float, float]:
    """The stated noise as (share of each number [-], standard deviation in the unit of the kind). Raises InputError."""
    if isinstance(settings.noise, str):
        text = settings.noise.strip()
        share = fraction(text) if text.endswith("%") else float("nan")
        if not 0.0 < share < 1.0:
            raise InputError(f"expected a number or a percentage such as 3%, got {text!r}", key="noise")
        return share, 0.0
    if settings.noise < 0.0:
        raise InputError(f"expected a standard deviation of at least 0, got {settings.noise:g}", key="noise")
    return 0.0, settings.noise


def stations(scene: Scene, spacing: float) -> Values:
    """Stations of a profile that no CSV names [m]."""
    return measures.profile_stations(scene, spacing)


def named(settings: MeasurementSettings, others: Sequence[MeasurementSettings]) -> str:
    """The name of an observation that has none: its kind, counted where there are several."""
    same = sum(other.kind is settings.kind for other in others)
    return str(settings.kind) if same == 0 else f"{settings.kind} {same + 1}"


def blocks(matrices: Sequence[Matrix]) -> Matrix:
    """The block-diagonal matrix of `matrices`."""
    size = sum(len(each) for each in matrices)
    whole, first = np.zeros((size, size)), 0
    for each in matrices:
        whole[first : first + len(each), first : first + len(each)] = each
        first += len(each)
    return whole
