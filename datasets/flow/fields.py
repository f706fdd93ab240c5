"""Fields of the particles of a flow: at a frame, between two frames, and their colour scales."""

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
"""Name -> values of the particles, shape [N] or [N, D] each."""
RECORDED = ("stress", "pressure", "plastic_strain", "pore_pressure")  # fields that a run may have recorded
CONSTANT = ("material", "friction_deg")  # fields that do not change
RANGE_QUANTILE = 0.995  # quantile of its frames' particles at which a colour bar ends, so that no single one decides


class Colour(StrEnum):
    """The quantity that the colour of a particle shows."""

    VELOCITY = "velocity"
    DISPLACEMENT = "displacement"
    PRESSURE = "pressure"
    PLASTIC_STRAIN = "plastic_strain"
    PORE_PRESSURE = "pore_pressure"
    MATERIAL = "material"


@dataclass(frozen=True, kw_only=True)
class ColourScale:
    """The colour scale of a field."""

    title: str
    """Name and unit on the colour bar."""
    unit: float = 1.0
    """That unit in SI units."""
    colours: str
    """Matplotlib colour map."""

    def scaled(self, values: NDArray[Any]) -> NDArray[Any]:
        """SI values [N], or the magnitudes of vectors [N, D], converted to that unit, shape [N]."""
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
    """The fields of the particles of a trajectory: recorded ones and those that follow from the positions."""

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory, scene = trajectory, trajectory.scene
        self.materials: list[Material] = list(dict.fromkeys(map(scene.material_of, scene.masses)))
        """The different materials of the scene, in the order of `datasets.scene.particles.initial_particles`."""

    @cached_property
    def start(self) -> NDArray[np.float64]:
        """Positions at the start [m], shape [N, D]; those of the first frame if the start is not known."""
        first = np.asarray(self.trajectory.positions[0], np.float64)
        initial = first if self.trajectory.time[0] == 0.0 else initial_particles(self.trajectory.scene).positions
        return initial if initial.shape == first.shape else first

    @cached_property
    def material(self) -> NDArray[np.int32]:
        """Index into `materials` of each particle, shape [N]. If the trajectory does not give its mass, the material of
        the nearest of the scene's own particles at the start."""
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
        """Velocities at `frame` [m/s], shape [N, D]: as recorded, or else central differences of the frames, backward
        at the last frame. At the start, and for a particle that entered after the previous frame, the initial velocity;
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
        """All known fields of the particles at `frame`, without their positions."""
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
        """The `position` and all known fields of the particles at a time [s], and which have `entered`. Linear between
        frames; beyond them as in the first or the last frame."""
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
    """Indices into both flows of particles that started at the same place: all of the flow with fewer; None if some
    have no partner. Flows of equal size are paired by index if all starts are within the spacing: another jitter."""
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
