"""Problem: what is unknown, what was observed and how hard to look for it. Read from TOML or built in Python."""

import dataclasses
import math
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from datasets.errors import InputError
from datasets.library import SCENES, find, read_scene
from datasets.particles import released_volume
from datasets.records import Record, from_mapping, read_toml
from datasets.scene import Scene
from inverse import checks
from inverse.observations import KINDS, Observation
from inverse.parameters import Kind, Vector, with_kinds, with_parameters
from inverse.settings import (
    LoopSettings,
    ObservationSettings,
    OptimiserSettings,
    Parameter,
    Surrogate,
    TargetSettings,
)

PROBLEMS = Path(__file__).parent / "problems"


@dataclass(frozen=True, kw_only=True)
class _File(Record):
    """A problem as it stands in its file."""

    scene: str
    unknowns: tuple[Parameter, ...]
    observation: ObservationSettings | None = None
    observations: tuple[ObservationSettings, ...] = ()
    target: TargetSettings | None = None
    optimiser: OptimiserSettings = field(default_factory=OptimiserSettings)
    loop: LoopSettings = field(default_factory=LoopSettings)
    surrogate: Surrogate = Surrogate.AUTO


@dataclass(frozen=True, kw_only=True)
class Problem:
    """An inverse problem, checked. Raises InputError, which names the key, for one that has no answer.

    >>> Problem(
    ...     name="my column",
    ...     scene=read_scene("column-tall-42"),
    ...     parameters=(Parameter(name="friction_deg", initial=30.0, lower=12.0, upper=52.0),),
    ...     observation=ObservationSettings(kind="front"),
    ...     target=TargetSettings(value=0.55, noise=0.005),
    ... )
    """

    name: str
    """Stem of its file."""
    folder: Path = Path()
    """Relative paths in it start here."""
    scene: Scene
    """The flow; its own values of the parameters are not used by the inversion."""
    parameters: tuple[Parameter, ...]
    """What to find (`[[unknowns]]`), in the order of every vector of parameters."""
    observation: ObservationSettings = field(default_factory=lambda: ObservationSettings(kind="joint"))
    """What was observed, where it is one thing."""
    target: TargetSettings = field(default_factory=TargetSettings)
    """What came out."""
    optimiser: OptimiserSettings = field(default_factory=OptimiserSettings)
    loop: LoopSettings = field(default_factory=LoopSettings)
    surrogate: Surrogate = Surrogate.AUTO
    observations: tuple[ObservationSettings, ...] = ()
    """In place of `observation`: multiple ones, compared together."""

    def __post_init__(self) -> None:
        checks.check_parameters(self.scene, self.parameters)
        if self.observations:
            checks.check_observations(self.observations, self.target)
        else:
            checks.check_observation(self.scene, self.observation)
            checks.check_target(self.scene, self.observation, self.target)
        checks.check_twin(self.scene, self.parameters, self.target)
        checks.check_search(self.parameters, self.observation, self.optimiser, self.loop)

    @property
    def observed(self) -> type[Observation]:
        """The class of what was observed."""
        return KINDS[self.observation.kind]

    @property
    def names(self) -> list[str]:
        """The names of the parameters."""
        return [each.name for each in self.parameters]

    @property
    def kinds(self) -> list[Kind]:
        """What the parameters are."""
        return [each.kind for each in self.parameters]

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """(lower, upper) of each parameter."""
        return [(each.lower, each.upper) for each in self.parameters]

    @property
    def initial(self) -> Vector:
        """Where the search starts, shape [U]."""
        return np.array([each.initial for each in self.parameters])

    @property
    def steps(self) -> Vector:
        """Step of a finite difference in each parameter, shape [U]."""
        return np.array([each.step or each.kind.step for each in self.parameters])

    def scene_at(self, values: Vector, seed: int | None = None) -> Scene:
        """The scene at parameters `values` [U], with another jitter `seed` if so asked. Raises InputError."""
        scene = with_kinds(self.scene, self.kinds, values)
        return scene if seed is None else dataclasses.replace(scene, seed=seed)

    def named(self, values: Vector) -> dict[str, float]:
        """The entries of a vector of parameters [U] by name."""
        return {name: float(value) for name, value in zip(self.names, values, strict=True)}

    def text(self, name: str, value: float) -> str:
        """A value of the parameter `name` with its unit."""
        return next(each.kind for each in self.parameters if each.name == name).text(value)

    @property
    def twin_scene(self) -> Scene:
        """The scene of a twin experiment: the true parameters and a jitter of its own."""
        truth = self.target.truth
        scene = with_parameters(self.scene, list(truth), list(truth.values()))
        return dataclasses.replace(scene, seed=self.target.seed)

    @property
    def released(self) -> float | None:
        """Volume of the masses over the width [m^2], in 2D their area; None where that is itself a parameter."""
        if any(kind.changes_volume for kind in self.kinds):
            return None
        return released_volume(self.scene) / math.prod(self.scene.domain.size[2:])


def read_problem(name: str) -> Problem:
    """Read the problem at a path or of a shipped name. Raises InputError, which names the file and the key.

    >>> problem = read_problem("friction-tall-42")
    """
    path = find(name, PROBLEMS, "problem")
    try:
        file = from_mapping(_File, _without_unused(read_toml(path)))
        observation, target = _observed(file)
        # A scene named by path lies beside the problem; a shipped one goes by its name.
        beside = path.parent / file.scene
        scene = read_scene(str(beside) if file.scene.endswith(".toml") else str(find(file.scene, SCENES, "scene")))
        return Problem(
            name=path.stem,
            folder=path.parent,
            scene=scene,
            parameters=file.unknowns,
            observation=observation,
            observations=file.observations,
            target=target,
            optimiser=file.optimiser,
            loop=file.loop,
            surrogate=file.surrogate,
        )
    except InputError as error:
        raise error if error.where else error.at(str(path)) from None


_UNUSED = (
    ("optimiser", "start", "the surrogate begins at rest"),
    ("optimiser", "starts", "the loop looks over the whole box"),
    ("loop", "seeds", "every MPM run has a jitter seed of its own"),
    ("loop", "trust", "MPM runs fill the box"),
)
"""Keys of older files, which are read and not used: table, key, why."""


def _without_unused(data: dict[str, Any]) -> dict[str, Any]:
    """A file's data without keys that are no longer used, with a warning for each."""
    for table, key, why in _UNUSED:
        if isinstance(data.get(table), dict) and key in data[table]:
            warnings.warn(f"{table}.{key} is no longer used, {why}", FutureWarning, stacklevel=3)
            data = data | {table: {name: value for name, value in data[table].items() if name != key}}
    return data


def _observed(file: _File) -> tuple[ObservationSettings, TargetSettings]:
    """Observation and target of a file that has one of both, or multiple observations. Raises InputError."""
    if file.observations:
        if file.observation is not None:
            raise InputError("expected one [observation] or multiple [[observations]], got both", key="observation")
        return ObservationSettings(kind="joint"), file.target or TargetSettings()
    for key in ("observation", "target"):
        if getattr(file, key) is None:
            raise InputError("expected a value, the key is missing", key=key)
    assert file.observation is not None
    assert file.target is not None
    return file.observation, file.target
