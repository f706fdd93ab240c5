"""What is known of the particles of a flow: at a frame, between two frames, and in which colours it is shown."""

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.flow import measures
from datasets.flow.trajectory import Trajectory, brackets
from datasets.scene.material import Material
from datasets.scene.particles import initial_particles

Values = dict[str, NDArray[Any]]
"""Of the particles by name, shape [N] or [N, D] each."""
RECORDED = ("stress", "pressure", "plastic_strain", "pore_pressure")  # fields that a run may have recorded
CONSTANT = ("material", "friction_deg")  # fields that do not change
RANGE_QUANTILE = 0.995  # a colour bar ends at this quantile of the particles of its frames: no single particle decides


class Colour(StrEnum):
    """What the colour of a particle shows."""

    VELOCITY = "velocity"
    DISPLACEMENT = "displacement"
    PRESSURE = "pressure"
    PLASTIC_STRAIN = "plastic_strain"
    PORE_PRESSURE = "pore_pressure"
    MATERIAL = "material"


@dataclass(frozen=True, kw_only=True)
class ColourScale:
    """How a field becomes colours."""

    title: str
    """Name and unit at the colour bar."""
    unit: float = 1.0
    """One of that unit in SI units."""
    colours: str
    """Colour map of matplotlib."""

    def scaled(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values [N], or the amounts of vectors [N, D], in SI units, in that unit, shape [N]."""
        return np.asarray((np.linalg.norm(values, axis=1) if values.ndim == 2 else values) / self.unit)


SCALES = {
    Colour.VELOCITY: ColourScale(title="speed [m/s]", colours="viridis"),
    Colour.DISPLACEMENT: ColourScale(title="displacement [m]", colours="viridis"),
    Colour.PRESSURE: ColourScale(title="pressure [kPa]", unit=1000.0, colours="plasma"),
    Colour.PLASTIC_STRAIN: ColourScale(title="plastic strain [-]", colours="inferno"),
    Colour.PORE_PRESSURE: ColourScale(title="pore pressure [kPa]", unit=1000.0, colours="plasma"),
    Colour.MATERIAL: ColourScale(title="friction angle", colours="Set2"),
}


class FlowFields:
    """The fields of the particles of a trajectory, those recorded and those that follow from the positions."""

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory, scene = trajectory, trajectory.scene
        self.materials: list[Material] = list(dict.fromkeys(map(scene.material_of, scene.masses)))
        """The different ones of the scene, in the order of `datasets.scene.particles.initial_particles`."""

    @cached_property
    def start(self) -> NDArray[np.float64]:
        """Positions at the start [m], shape [N, D]; the first frame's where the start was not kept and is not known."""
        first = np.asarray(self.trajectory.positions[0], np.float64)
        initial = first if self.trajectory.time[0] == 0.0 else initial_particles(self.trajectory.scene).positions
        return initial if initial.shape == first.shape else first

    @cached_property
    def material(self) -> NDArray[np.int32]:
        """Index into `materials` of each particle, shape [N]. Where the trajectory does not say its mass, that of the
        nearest of the scene's own particles at the start."""
        from scipy.spatial import cKDTree

        scene = self.trajectory.scene
        if self.trajectory.mass is not None:
            of_masses = [self.materials.index(scene.material_of(mass)) for mass in scene.masses]
            return np.array(of_masses, np.int32)[self.trajectory.mass]
        if len(self.materials) == 1:
            return np.zeros(len(self.start), np.int32)
        particles = initial_particles(scene)
        return np.asarray(particles.material[cKDTree(particles.positions).query(self.start)[1]])

    @property
    def spacing(self) -> float:
        """Distance between neighbouring particles at the start [m]."""
        return measures.particle_spacing(self.trajectory.volumes, self.trajectory.scene.dimension)

    def velocity(self, frame: int) -> NDArray[np.float32] | None:
        """Velocities at `frame` [m/s], shape [N, D]: as recorded, or else finite differences of the frames, central, at
        the last frame backward. At the start, and of a particle that entered after the frame before, the initial ones;
        None at a first frame that is not the start."""
        trajectory = self.trajectory
        if trajectory.velocities is not None:
            return np.asarray(trajectory.velocities[frame])
        if frame == 0:
            return trajectory.velocity0 if trajectory.time[0] == 0.0 else None
        after, before = min(frame + 1, len(trajectory.time) - 1), frame - 1
        elapsed = trajectory.time[after] - trajectory.time[before]
        differences = np.asarray((trajectory.positions[after] - trajectory.positions[before]) / elapsed, np.float32)
        return np.where(trajectory.entered(float(trajectory.time[before]))[:, None], differences, trajectory.velocity0)

    def at_frame(self, frame: int) -> Values:
        """All that is known of the particles at `frame` besides their positions."""
        trajectory = self.trajectory
        recorded = {key: getattr(trajectory, key) for key in RECORDED}
        values = {
            "velocity": self.velocity(frame),
            "displacement": trajectory.positions[frame] - self.start.astype(np.float32),
            **{key: None if series is None else series[frame] for key, series in recorded.items()},
            "material": self.material,
            "friction_deg": np.degrees(np.arctan(trajectory.friction)).astype(np.float32),
        }
        return {key: array for key, array in values.items() if array is not None}

    def at_time(self, time: float) -> Values:
        """The `position` and all that is known of the particles at a time [s], and which have `entered`. Linear between
        frames; beyond them the first one's or the last one's."""
        flow = self.trajectory
        (before,), (share,) = (bracket.tolist() for bracket in brackets(flow.time, np.array([time])))
        first, second = (
            {"position": np.asarray(flow.positions[frame])} | self.at_frame(frame) if weight > 0.0 else {}
            for frame, weight in ((before, 1.0 - share), (before + 1, share))
        )
        entered = {"entered": flow.entered(float(np.clip(time, flow.time[0], flow.time[-1])))}
        if not first or not second:
            return entered | (first or second)
        return entered | {
            key: first[key] if key in CONSTANT else (1.0 - share) * first[key] + share * second[key]
            for key in first.keys() & second.keys()
        }


def pairs(one: FlowFields, other: FlowFields) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Indices into both flows of the particles that began at the same place: all of the one that has fewer; None where
    some have no partner. Of as many those of a number, no farther apart than neighbours are: so is another jitter."""
    from scipy.spatial import cKDTree

    few, many = sorted((one, other), key=lambda flow: len(flow.start))
    indices = nearest = np.arange(len(few.start))
    if len(few.start) == len(many.start):
        apart = float(np.linalg.norm(few.start - many.start, axis=1).max())
    else:
        distance, nearest = cKDTree(many.start).query(few.start)
        apart = 2.0 * float(distance.max()) if len(np.unique(nearest)) == len(indices) else np.inf
    if not apart <= many.spacing:
        return None
    return (indices, nearest) if few is one else (nearest, indices)
