"""Trajectories at a model's time step, read from disk as they are needed, and samples drawn from them."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import overload

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from datasets.errors import InputError
from datasets.geometry.plain import check_plain
from datasets.particles import mass_counts, particle_volumes
from datasets.scene import Scene
from datasets.training.memory_mapped import open_trajectory
from datasets.training.thinning import thin
from datasets.trajectory import Floats, Trajectory

MOVING = 0.02
"""Root mean square speed [m/s] above which a flow counts as moving."""


@dataclass(frozen=True, kw_only=True)
class Flow:
    """One trajectory, every so many frames; all of its particles."""

    name: str
    """The file it came from."""
    positions: Floats
    """Positions one step apart [m], shape [T, N, D]; may be a map of the file, of which only what is used is read."""
    velocity0: Floats
    """Initial velocities [m/s], shape [N, D]."""
    friction: Floats
    """tan(phi) of each particle [-], shape [N]."""
    cohesion: Floats
    """Cohesion of each particle [Pa], shape [N]."""
    baffles: Floats
    """Lower and upper corner of each baffle [m], shape [K, 2, D]; K may be 0."""
    volume: NDArray[np.float64]
    """Initial volume of each particle [m^D], shape [N]."""
    size: tuple[float, ...]
    """Extent of the domain [m], length D."""
    gravity: float
    """Gravitational acceleration [m/s^2]."""
    step: float
    """Time between two positions [s]."""

    @property
    def released(self) -> bool:
        """Whether it starts at rest."""
        return not self.velocity0.any()

    def moves(self, time: int) -> bool:
        """Whether it moves from index `time` to the next."""
        displacements = self.positions[time + 1] - self.positions[time]
        square = float(np.square(displacements).sum(axis=1).mean())
        return square > (MOVING * self.step) ** 2

    @staticmethod
    def from_trajectory(trajectory: Trajectory, step: float, name: str) -> "Flow":
        """Every so many frames of `trajectory` that they are `step` [s] apart. Raises InputError."""
        scene = trajectory.scene
        stride = frames_per_step(trajectory.frame_dt, step, name)
        check_plain(scene, "a model", name)
        if scene.slope_deg != 0.0:
            raise InputError("expected a level floor, a model knows no other", where=name, key="slope_deg")
        if any(mass.release is not None for mass in scene.masses):
            raise InputError("expected masses that are free from the start, a model knows no barriers", where=name)
        return Flow(
            name=name,
            positions=trajectory.positions[::stride],
            velocity0=trajectory.velocity0,
            friction=trajectory.friction,
            cohesion=point_cohesion(scene, len(trajectory.friction), name),
            baffles=corners(scene),
            volume=particle_volumes(scene, len(trajectory.friction)),
            size=scene.domain.size,
            gravity=scene.gravity,
            step=step,
        )


def frames_per_step(frame_dt: float, step: float, where: str) -> int:
    """Frames in a model's step. Raises InputError if it is no whole number."""
    stride = round(step / frame_dt)
    if stride < 1 or abs(stride * frame_dt - step) > 1.0e-6 * step:
        raise InputError(f"expected frames {step:g} s apart or a whole fraction of it, got {frame_dt:g}", where=where)
    return stride


def point_cohesion(scene: Scene, particles: int, where: str) -> Floats:
    """Cohesion [Pa] of each of a scene's particles, in the order of `initial_particles`; [particles].

    Raises InputError where masses differ and the number of particles is not theirs.
    """
    values = [scene.material_of(mass).cohesion for mass in scene.masses]
    if len(set(values)) == 1:
        return np.full(particles, values[0], np.float32)
    counts = mass_counts(scene)
    if sum(counts) != particles:
        message = f"expected the {sum(counts)} particles of masses that differ in cohesion, got {particles}"
        raise InputError(message, where=where, key="positions")
    return np.repeat(np.array(values, np.float32), counts)


def corners(scene: Scene) -> Floats:
    """Lower and upper corner of each baffle [m], shape [K, 2, D]."""
    lower = np.array([baffle.lower for baffle in scene.baffles], np.float32).reshape(-1, 1, scene.dimension)
    size = np.array([baffle.size for baffle in scene.baffles], np.float32).reshape(-1, 1, scene.dimension)
    return np.concatenate((lower, lower + size), axis=1)


class Flows(Sequence[Flow]):
    """Flows on disk, each opened when it is asked for: all that is held of them is the names of their files."""

    def __init__(self, files: Sequence[Path], *, step: float, dimension: int) -> None:
        self._files, self._step, self._dimension = tuple(files), step, dimension

    def __len__(self) -> int:
        return len(self._files)

    @overload
    def __getitem__(self, index: int) -> Flow: ...
    @overload
    def __getitem__(self, index: slice) -> "Flows": ...
    def __getitem__(self, index: int | slice) -> "Flow | Flows":
        if isinstance(index, slice):
            return Flows(self._files[index], step=self._step, dimension=self._dimension)
        file = self._files[index]
        flow = Flow.from_trajectory(open_trajectory(file), self._step, str(file))
        if len(flow.size) != self._dimension:
            raise InputError(f"expected a {self._dimension}D trajectory, got {len(flow.size)}D", where=str(file))
        return flow


def load_flows(dataset: Path, split: str, *, step: float, dimension: int, progress: bool = False) -> Flows:
    """All trajectories of a split (`train`, `valid`, `test`), by file name.

    Each is opened once to see that it is whole. Raises InputError.
    """
    files = sorted((dataset / split).glob("*.npz"))
    if not files:
        raise InputError(f"expected trajectories in {split}/*.npz, there are none", where=str(dataset))
    flows = Flows(files, step=step, dimension=dimension)
    for _ in tqdm(flows, desc=f"{dataset.name}/{split}", unit="file", disable=not progress):
        pass
    return flows


@dataclass(frozen=True, kw_only=True)
class Sample:
    """A thinned stretch of a flow: what a model is given and what it should say."""

    frames: Floats
    """Positions that are given [m], at most history + 1 of them, the last is now; shape [F, n, D]."""
    velocity0: Floats
    """Velocities at the first of these, where it is the flow's first [m/s], shape [n, D]."""
    targets: Floats
    """Positions in the coming steps [m], shape [K, n, D]."""
    friction: Floats
    """tan(phi) of each particle [-], shape [n]."""
    cohesion: Floats
    """Cohesion of each particle [Pa], shape [n]."""
    volume: Floats
    """Initial volume of each particle [m^D], shape [n]."""
    baffles: Floats
    """Lower and upper corner of each baffle [m], shape [K, 2, D]."""


def cut(flow: Flow, *, now: int, steps: int, history: int, cell: float, kept: int, rng: np.random.Generator) -> Sample:
    """The stretch of `flow` with `steps` after index `now` and, as far as there are, `history` displacements before.

    cell, kept, rng: which particles stay (`datasets.training.thinning`). Of a flow on disk it reads these frames alone.
    """
    thinned = thin(flow.positions[0], flow.volume, cell=cell, kept=kept, rng=rng)
    particles = thinned.indices
    first = max(0, now - history)
    return Sample(
        frames=flow.positions[first : now + 1, particles],
        velocity0=flow.velocity0[particles],
        targets=flow.positions[now + 1 : now + 1 + steps, particles],
        friction=flow.friction[particles],
        cohesion=flow.cohesion[particles],
        volume=thinned.volumes,
        baffles=flow.baffles,
    )


def mirrored(sample: Sample, axis: int, length: float) -> Sample:
    """The same flow, mirrored along a horizontal `axis`, in a domain that is `length` [m] long there."""
    flip = np.ones(sample.velocity0.shape[1], np.float32)
    origin = np.zeros_like(flip)
    flip[axis], origin[axis] = -1.0, length
    baffles = origin + flip * sample.baffles
    # What was the lower side is now the upper.
    baffles[..., axis] = baffles[:, ::-1, axis]
    return dataclasses.replace(
        sample,
        frames=origin + flip * sample.frames,
        velocity0=flip * sample.velocity0,
        targets=origin + flip * sample.targets,
        baffles=baffles,
    )


def exchanged(sample: Sample) -> Sample:
    """The same 3D flow with x and z exchanged, in a domain as wide as it is long."""
    turn = [2, 1, 0]
    return dataclasses.replace(
        sample,
        frames=sample.frames[..., turn],
        velocity0=sample.velocity0[..., turn],
        targets=sample.targets[..., turn],
        baffles=sample.baffles[..., turn],
    )
