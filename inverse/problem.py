"""Problem: the unknowns, the observations and the search settings. Read from TOML or built in Python."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from datasets.errors import InputError, keyed, naming, require
from datasets.files import read_toml
from datasets.flow.trajectory import Trajectory
from datasets.scene import INFLOW, Scene
from datasets.scene.checks import warn_if_unlikely
from datasets.scene.grid_field import FRICTION, THICKNESS, Floats
from datasets.scene.library import find, read_scene
from datasets.scene.particles import released_volume
from datasets.schema import Record, from_mapping, one_of
from inverse.observations import KINDS, Observation, ObservationSettings
from inverse.observations.errors import Student
from inverse.observations.observation import Between
from inverse.observations.settings import FILES
from inverse.observations.target import Target
from inverse.parameters import Kind, Parameter, Vector, check_parameters, check_scene, with_kinds, with_parameters
from inverse.parameters.field import UnknownField
from inverse.parameters.kind import Clock
from inverse.parameters.prior import Correlation, JointPrior
from inverse.settings import LoopSettings, OptimiserSettings, Surrogate, TargetSettings

PROBLEMS = Path(__file__).parent / "problems"
FEWEST_RUNS = 5  # MPM runs in addition to one for each unknown: for a trend, its error and a check of the answer


@dataclass(frozen=True, kw_only=True)
class ProblemKeys(Record):
    """The keys that a problem and its file have in common."""

    observations: tuple[Annotated[ObservationSettings, one_of(KINDS)], ...]
    """The observations, which are compared together."""
    correlations: tuple[Correlation, ...] = ()
    """Correlations of the priors of pairs of numbers."""
    target: TargetSettings = field(default_factory=TargetSettings)
    """The source of the observed numbers."""
    optimiser: OptimiserSettings = field(default_factory=OptimiserSettings)
    loop: LoopSettings = field(default_factory=LoopSettings)
    surrogate: Surrogate = Surrogate.AUTO


@dataclass(frozen=True, kw_only=True)
class _File(ProblemKeys):
    """A problem as its file states it."""

    scene: str
    unknowns: tuple[Parameter, ...]


@dataclass(frozen=True)
class Box:
    """The box of the prior bounds of U numbers."""

    lower: Vector
    upper: Vector

    @property
    def range(self) -> Vector:
        """Width of the box, shape [U]."""
        return self.upper - self.lower

    def at(self, shares: Vector) -> Vector:
        """Parameters [..., U] at `shares` of the ranges, shape [..., U]."""
        return np.asarray(self.lower + self.range * shares)

    def shares(self, parameters: Vector) -> Vector:
        """Parameters [..., U] in fractions of the ranges, shape [..., U]."""
        return np.asarray((parameters - self.lower) / self.range)


@dataclass(frozen=True, kw_only=True)
class Problem(ProblemKeys):
    """An inverse problem, checked. Raises InputError, which names the key, for one that cannot be solved.

    >>> Problem(
    ...     name="my column",
    ...     scene=read_scene("column-tall-42"),
    ...     parameters=(Parameter(name="friction_deg", initial=30.0, lower=12.0, upper=52.0),),
    ...     observations=(FrontSettings(value=0.55, noise=0.005),),
    ... )
    """

    name: str
    """Stem of its file."""
    folder: Path = Path()
    """Folder to which paths in the problem are relative."""
    scene: Scene
    """The flow; its own values of the parameters serve only as the truth of a twin."""
    parameters: tuple[Parameter, ...]
    """The unknowns (`[[unknowns]]`): numbers, in the order of every parameter vector, and fields."""

    def __post_init__(self) -> None:
        require(len(self.parameters) > 0, "unknowns", "at least one unknown", "none")
        by_key = {f"unknowns[{index}]": parameter for index, parameter in enumerate(self.parameters)}
        for key, parameter in by_key.items():
            started = parameter.is_field or parameter.prior is not None or parameter.initial is not None
            require(started, f"{key}.initial", "a value", "none, the key is missing")
        check_parameters(self.scene, by_key, "unknowns")
        # The prior refuses invalid correlations.
        _ = self.prior
        self._check_observations()
        for key, parameter in by_key.items():
            # Observations with files are exempt: the files contain times.
            timeless = parameter.name == "time_offset" and not any(
                "csv" in settings.given or settings.operator(self.scene).over_time for settings in self.observations
            )
            require(not timeless, f"{key}.name", "an observation over time for a clock", "none")
        self._check_target()
        budget, fewest = self.loop.budget(len(self.parameters)), len(self.parameters) + FEWEST_RUNS
        require(budget >= fewest, "loop.mpm_runs", f"an integer of at least {fewest}", budget)
        if any(parameter.is_field for parameter in self.parameters):
            self._check_fields()

    @property
    def numbers(self) -> list[Parameter]:
        return [parameter for parameter in self.parameters if not parameter.is_field]

    @cached_property
    def fields(self) -> list[UnknownField]:
        """The unknown fields, with their nodes and priors. Raises InputError, which names the key."""
        fields = []
        for index, parameter in enumerate(self.parameters):
            if parameter.is_field:
                with keyed(f"unknowns[{index}]"):
                    fields.append(UnknownField(parameter, self.scene, self.folder))
        return fields

    @property
    def names(self) -> list[str]:
        return [number.name for number in self.numbers]

    @property
    def kinds(self) -> list[Kind]:
        return [number.kind for number in self.numbers]

    @property
    def box(self) -> Box:
        """The prior bounds of the numbers."""
        return Box(*np.array([number.bounds for number in self.numbers]).reshape(-1, 2).T)

    @cached_property
    def prior(self) -> JointPrior | None:
        """The stated prior of the numbers; None if it is uniform between the bounds. Raises InputError."""
        stated = [number for number in self.numbers if number.prior is not None and number.prior.kind != "uniform"]
        if not stated and not self.correlations:
            return None
        return JointPrior({number.name: number.marginal for number in self.numbers}, self.correlations)

    @property
    def prior_widths(self) -> Vector:
        """Width of a uniform prior equivalent to the prior of each number, shape [U]."""
        return self.box.range if self.prior is None else np.array([marginal.width for marginal in self.prior.marginals])

    @property
    def initial(self) -> Vector:
        """Start of the search, shape [U]."""
        return np.array([number.start for number in self.numbers])

    def scene_at(self, values: Vector, seed: int | None = None, fields: Sequence[Floats] = ()) -> Scene:
        """The scene with numbers `values` [U] and, if given, another jitter `seed`. Raises InputError.
        fields: values [K] of each unknown field; default: the medians of their priors."""
        scene = with_kinds(self.scene, self.kinds, values)
        given = fields or [unknown.median for unknown in self.fields]
        for unknown, field_values in zip(self.fields, given, strict=True):
            scene = unknown.put(scene, field_values)
        return scene if seed is None else replace(scene, seed=seed)

    def clocked(self, run: Trajectory, values: Vector) -> Trajectory:
        """A run with numbers `values` [U] in the observations' time, which starts `time_offset` after the flow."""
        late = sum(float(values[n]) for n, kind in enumerate(self.kinds) if isinstance(kind, Clock))
        return replace(run, time=run.time - late) if late else run

    def named(self, values: Vector) -> dict[str, Any]:
        """The entries of a vector of numbers [U], or the rows of many such columns [U, ...], by name."""
        return dict(zip(self.names, values.tolist(), strict=True))

    @cached_property
    def measured(self) -> list[Target]:
        """Targets from the observations' own numbers, each table read once. Raises InputError with key or table."""
        targets = []
        for index, settings in enumerate(self.observations):
            with keyed(f"observations[{index}]"):
                targets.append(settings.read(self.scene, self.folder, self.released))
        return targets

    @cached_property
    def operators(self) -> list[Observation]:
        """The operator of each observation. Raises InputError, which names key or table."""
        measured = [target.observation for target in self.measured] if self.target.measured else None
        observed = [settings.operator(self.scene) for settings in self.observations] if measured is None else measured
        for index, operator in enumerate(observed if any(mass.kind == INFLOW for mass in self.scene.masses) else ()):
            # Positions over time would include particles that have not entered yet.
            ends = not (operator.over_time and (operator.of_positions or operator.dense))
            require(ends, f"observations[{index}]", "the deposit or forces, where material flows in", operator.kind)
        return observed

    @property
    def twin_scene(self) -> Scene:
        """The twin's scene: truth, jitter seed and cells of its own. Raises InputError for cells that do not fit."""
        truth, cell = self.target.truth, self.target.cell
        scene = with_parameters(self.scene, list(truth), list(truth.values()))
        values = np.array([number.kind.read(scene) for number in self.numbers])
        # The twin keeps the fields of the scene.
        twin = replace(with_kinds(self.scene, self.kinds, values), seed=self.target.seed)
        return twin if cell is None else twin.with_cell(cell)

    @property
    def seeds(self) -> range:
        """Jitter seeds of a search for fields, before the seeds that measure the scatter."""
        return range(self.scene.seed, self.scene.seed + self.optimiser.seeds)

    @property
    def scatter_seeds(self) -> range:
        """Jitter seeds of the runs that measure the scatter, different from those of the search and the twin."""
        first = max(self.seeds[-1], self.target.seed) + 1
        return range(first, first + self.optimiser.ensemble)

    @cached_property
    def released(self) -> Between:
        """Least and greatest volume of the masses over the width [m^2], in 2D their area, within the bounds."""
        if any(parameter.is_field and parameter.quantity == THICKNESS for parameter in self.parameters):
            return 0.0, math.inf
        scenes = [self.scene] * 2
        if any(kind.changes_volume for kind in self.kinds):
            scenes = [with_kinds(self.scene, self.kinds, ends) for ends in (self.box.lower, self.box.upper)]
        least, most = (released_volume(scene) / math.prod(scene.domain.size[2:]) for scene in scenes)
        return least, most

    def _check_observations(self) -> None:
        """Raise InputError for observations that a flow of the scene does not have, or that cannot be combined."""
        require(len(self.observations) > 0, "observations", "at least one observation", "none")
        for index, settings in enumerate(self.observations):
            with keyed(f"observations[{index}]"):
                alone = len(self.observations) == 1 or not settings.operator_type.every_particle
                require(alone, "kind", "an observation of few numbers beside others", repr(settings.kind))
                given = settings.given
                if not given.keys() & {*FILES}:
                    operator = settings.operator(self.scene)
                    if given:
                        settings.stated(operator)
                if self.target.measured and not given:
                    stands = " or ".join(settings.sources) or "a trajectory"
                    message = f"expected what was measured for {settings.kind}: {stands}"
                    raise InputError(f"{message}; or twin or a trajectory in [target]")
                other = self.target.measured or not given
                require(other, "", "no numbers beside those of [target]", " and ".join(given))
        kind = self.observations[0].kind
        if self.observations[0].operator_type.every_particle:
            for number in self.numbers:
                expected = f"another kind: with {number.name} the number of particles changes"
                require(not number.kind.changes_volume, "observations[0].kind", expected, kind)
            other = self.target.cell is None
            require(other, "target.cell", "an observation other than of every particle", kind)

    def _check_target(self) -> None:
        with keyed("target"):
            self.target.check(self.scene)
        numbers, truth = {number.name: number for number in self.numbers}, self.target.truth
        for name in truth:
            require(name in numbers, f"target.truth.{name}", f"one of the unknowns {', '.join(numbers)}", name)
        if truth:
            check_scene(self.scene, [numbers[name] for name in truth], list(truth.values()), "target.truth")

    def _check_fields(self) -> None:
        """Raise InputError for fields that the adjoint cannot find, or a twin without their truth."""
        indices = [index for index, parameter in enumerate(self.parameters) if parameter.is_field]
        for index, unknown in zip(indices, self.fields, strict=True):
            with keyed(f"unknowns[{index}]"):
                unknown.check_bounds(self.scene)
                true = not self.target.twin or unknown.truth(self.scene) is not None
                require(true, "name", f"a scene with a field of {unknown.settings.name} as the truth", "none")
            if unknown.settings.quantity == FRICTION:
                expected = "a body without initial stress, whose yield depends on an unknown friction"
                for number, mass in enumerate(self.scene.masses):
                    require(mass.k0 is None, f"scene.masses[{number}].k0", expected, mass.k0)
        for index, parameter in enumerate(self.parameters):
            with keyed(f"unknowns[{index}]"):
                require(parameter.name != "time_offset", "name", "no clock beside a field", parameter.name)
                require(parameter.prior is None, "prior", "none beside a field", "one")
        require(not self.correlations, "correlations", "none beside a field", "some")
        released = any(unknown.settings.quantity == THICKNESS for unknown in self.fields)
        for index, observation in enumerate(self.observations):
            operator, noise, kind = observation.operator_type, observation.noise, observation.kind
            weighed = not released or operator.dense
            by_volume = "an observation by the volumes of a run itself (thickness, outline) beside an unknown thickness"
            jointly = (operator.of_positions or operator.dense) and not operator.every_particle
            with keyed(f"observations[{index}]"):
                require(not isinstance(noise, Student), "noise", "a normal noise beside a field", noise)
                require(weighed, "kind", by_volume, kind)
                require(jointly, "kind", "an observation of positions of few numbers", kind)
        expected = f"none of the {len(self.seeds)} seeds from {self.seeds[0]} on, which the search has"
        other = self.target.seed not in self.seeds or not self.target.twin
        require(other, "target.seed", expected, self.target.seed)


def read_problem(name: str | Path) -> Problem:
    """Read a problem from a path or by a shipped name. Raises InputError, which names the file and the key.

    >>> problem = read_problem("friction-tall-42")
    """
    path = find(name, PROBLEMS, "problem")
    with naming(path):
        data = read_toml(path)
        if "domain" in data:
            raise InputError("expected a problem, got a scene: python -m mpm.run takes it", key="domain")
        file = from_mapping(_File, data)
        # The path of a scene is relative to the problem's file; a shipped scene is given by its name.
        scene = read_scene(path.parent / file.scene if file.scene.endswith(".toml") else file.scene)
        observations = []
        for index, settings in enumerate(file.observations):
            with keyed(f"observations[{index}]"):
                observations.append(settings if scene.domain.origin is None else settings.in_box(scene.domain.corner))
        keys = vars(file) | {"name": path.stem, "folder": path.parent, "scene": scene}
        keys |= {"observations": tuple(observations), "parameters": keys.pop("unknowns")}
        try:
            problem = Problem(**keys)
        except InputError as error:
            seen = re.fullmatch(r"observations\[(\d+)\]\.?(.*)", error.key)
            of_place = seen is not None and seen[2] in ("", *file.observations[int(seen[1])].places)
            if scene.domain.origin is None or not of_place:
                raise
            place = ", ".join(f"{coordinate:.10g}" for coordinate in scene.domain.origin)
            message = f"{error.message}; lengths count from the corner of the box here, {place} on the map"
            raise InputError(message, key=error.key) from None
        # A UserWarning for each number whose bounds look like another unit's.
        warn_if_unlikely(problem.scene_at(problem.box.upper))
        return problem
