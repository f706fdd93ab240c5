"""Problem: what is unknown, what was observed and how hard to look for it. Read from TOML, strictly."""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.geometry.ground import elevation
from datasets.geometry.margins import Box
from datasets.library import SCENES, find, read_scene
from datasets.particles import released_volume
from datasets.records import Record, fraction, from_mapping, read_toml
from datasets.scene import Scene
from gns.initial import Start
from inverse import checks
from inverse.parameters.initial_state import untouched
from inverse.parameters.parameters import Vector, kind, swept
from inverse.settings import (
    LoopSettings,
    MeasurementSettings,
    Method,
    Observable,
    ObservationSettings,
    OptimiserSettings,
    Sampler,
    Surrogate,
    TargetSettings,
    Unknown,
)

__all__ = [
    "LoopSettings",
    "MeasurementSettings",
    "Method",
    "Observable",
    "ObservationSettings",
    "OptimiserSettings",
    "Problem",
    "Sampler",
    "Start",
    "Surrogate",
    "TargetSettings",
    "Unknown",
    "read_problem",
]

PROBLEMS = Path(__file__).parent / "problems"


@dataclass(frozen=True, kw_only=True)
class _File(Record):
    """A problem as it stands in its file."""

    scene: str
    unknowns: tuple[Unknown, ...]
    observation: ObservationSettings | None = None
    observations: tuple[MeasurementSettings, ...] = ()
    target: TargetSettings | None = None
    optimiser: OptimiserSettings = field(default_factory=OptimiserSettings)
    loop: LoopSettings = field(default_factory=LoopSettings)
    surrogate: Surrogate = Surrogate.AUTO


@dataclass(frozen=True, kw_only=True)
class Problem:
    """An inverse problem, checked."""

    name: str
    """Stem of its file."""
    folder: Path
    """Relative paths in it start here."""
    scene: Scene
    """The flow; its own values of the unknowns are never shown to the inversion."""
    unknowns: tuple[Unknown, ...]
    """What to find, in the order of every vector of unknowns."""
    observation: ObservationSettings
    target: TargetSettings
    optimiser: OptimiserSettings = field(default_factory=OptimiserSettings)
    loop: LoopSettings = field(default_factory=LoopSettings)
    surrogate: Surrogate = Surrogate.AUTO
    observations: tuple[MeasurementSettings, ...] = ()
    """Where `observation` is several: what they are."""

    def __post_init__(self) -> None:
        checks.check_unknowns(self.scene, self.unknowns)
        checks.check_observation(self.scene, self.observation)
        if self.observations:
            checks.check_several(self.scene, self.names, self.observation, self.target)
        else:
            checks.check_target(self.scene, self.names, self.observation, self.target)
        checks.check_search(self.unknowns, self.observation, self.optimiser, self.loop)

    @property
    def names(self) -> list[str]:
        """The unknowns, by name."""
        return [unknown.name for unknown in self.unknowns]

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """(lower, upper) of each unknown."""
        return [(unknown.lower, unknown.upper) for unknown in self.unknowns]

    @property
    def initial(self) -> Vector:
        """Where the search starts, shape [U]."""
        return np.array([unknown.initial for unknown in self.unknowns])

    @property
    def steps(self) -> Vector:
        """Step of a finite difference in each unknown, shape [U]."""
        return np.array([unknown.step or kind(unknown.name).step for unknown in self.unknowns])

    @property
    def released(self) -> float:
        """Volume of the scene's masses over its width [m^2]; in 2D their area."""
        return released_volume(self.scene) / math.prod(self.scene.domain.size[2:])

    def ground(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Elevation of the highest terrain, or of the floor, at `x` [m], both of shape [R]. Raises InputError in 3D."""
        if self.scene.dimension != 2:
            raise InputError("expected heights above the ground in 3D, got elevations", key="heights")
        box = Box(size=self.scene.domain.size, cell=self.scene.domain.cell)
        return elevation(self.scene.solids, box, x[:, None])

    @property
    def changes_volume(self) -> bool:
        """Whether how much is released is itself unknown."""
        return any(kind(name).changes_volume for name in self.names)

    @cached_property
    def start(self) -> Start:
        """Where the surrogate begins: after the MPM's first frames, which it knows best how to go on from.

        Unless those depend on the unknowns: on a velocity, or on a baffle that the flow may reach so soon.
        """
        if self.optimiser.start is not None:
            return self.optimiser.start
        boxes = swept(self.scene, self.names, self.bounds).values()
        moved = any(kind(name).moves_the_start for name in self.names)
        return Start.FROM_REST if moved or not untouched(self.scene, boxes) else Start.FROM_MPM_FRAMES


def read_problem(name: str) -> Problem:
    """Read the problem at a path or of a shipped name. Raises InputError, which names the file and the key."""
    path = find(name, PROBLEMS, "problem")
    try:
        file = from_mapping(_File, with_noise_share(read_toml(path)))
        # A scene named by path lies beside the problem; a shipped one goes by its name.
        beside = path.parent / file.scene
        scene = read_scene(str(beside) if file.scene.endswith(".toml") else str(find(file.scene, SCENES, "scene")))
        parts: dict[str, Any] = {part.name: getattr(file, part.name) for part in dataclasses.fields(file)}
        observed = one_or_several(file)
        return Problem(name=path.stem, folder=path.parent, **(parts | observed | {"scene": scene}))
    except InputError as error:
        raise error if error.where else error.at(str(path)) from None


def one_or_several(file: _File) -> dict[str, Any]:
    """Observation and target of a file that has one of both, or several observations. Raises InputError."""
    if file.observations:
        if file.observation is not None:
            raise InputError("expected one [observation] or several [[observations]], got both", key="observation")
        target = file.target or TargetSettings()
        return {"observation": ObservationSettings(kind=Observable.SEVERAL), "target": target}
    for key in ("observation", "target"):
        if getattr(file, key) is None:
            raise InputError("expected a value, the key is missing", key=key)
    assert file.observation is not None
    if file.observation.kind is Observable.SEVERAL:
        raise InputError("expected [[observations]] for several", key="observation.kind")
    return {"observation": file.observation, "target": file.target}


def with_noise_share(data: Mapping[str, Any]) -> dict[str, Any]:
    """`data` of a file, its `target.noise` as the share that a percentage such as "3%" means. Raises InputError."""
    target = data.get("target")
    if not isinstance(target, dict) or not isinstance(target.get("noise"), str):
        return dict(data)
    text = target["noise"].strip()
    share = fraction(text) if text.endswith("%") else math.nan
    if not 0.0 < share < 1.0:
        raise InputError(f"expected a number or a percentage such as 3%, got {text!r}", key="target.noise")
    return {**data, "target": {**target, "noise": 0.0, "noise_share": share}}
