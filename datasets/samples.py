"""Trajectories in memory at a model's time step, and samples drawn from them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from datasets.errors import InputError
from datasets.thinning import thin
from datasets.trajectory import Floats, Trajectory

MOVING = 0.02
"""Root mean square speed [m/s] above which a flow counts as moving."""


@dataclass(frozen=True, kw_only=True)
class Flow:
    """One trajectory, every so many frames; all of its points."""

    name: str
    """The file it came from."""
    positions: Floats
    """Positions one step apart [m], shape [T, N, D]."""
    velocity0: Floats
    """Initial velocities [m/s], shape [N, D]."""
    friction: Floats
    """tan(phi) of each point [-], shape [N]."""
    volume: float
    """Initial volume of one point [m^D]."""
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

    def moving(self) -> NDArray[np.int64]:
        """Indices of the times from which it still moves."""
        displacements = np.diff(self.positions, axis=0)
        speed = np.sqrt(np.square(displacements).sum(axis=2).mean(axis=1)) / self.step
        return np.flatnonzero(speed > MOVING)

    @staticmethod
    def of(trajectory: Trajectory, step: float, name: str) -> "Flow":
        """Every so many frames of `trajectory` that they are `step` [s] apart. Raises InputError if none are."""
        scene = trajectory.scene
        stride = frames_per_step(scene.frame_dt, step, name)
        return Flow(
            name=name,
            positions=np.ascontiguousarray(trajectory.positions[::stride], dtype=np.float32),
            velocity0=trajectory.velocity0,
            friction=trajectory.friction,
            volume=scene.point_volume,
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


def load_flows(dataset: Path, split: str, *, step: float, dimension: int, progress: bool = False) -> list[Flow]:
    """All trajectories of a split (`train`, `valid`, `test`), by file name. Raises InputError."""
    files = sorted((dataset / split).glob("*.npz"))
    if not files:
        raise InputError(f"expected trajectories in {split}/*.npz, there are none", where=str(dataset))
    flows = []
    for file in tqdm(files, desc=f"{dataset.name}/{split}", unit="file", disable=not progress):
        flow = Flow.of(Trajectory.load(file), step, str(file))
        if len(flow.size) != dimension:
            raise InputError(f"expected a {dimension}D trajectory, got {len(flow.size)}D", where=str(file))
        flows.append(flow)
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
    """tan(phi) of each point [-], shape [n]."""
    volume: Floats
    """Initial volume of each point [m^D], shape [n]."""


def cut(flow: Flow, *, now: int, steps: int, history: int, cell: float, kept: int, rng: np.random.Generator) -> Sample:
    """The stretch of `flow` with `steps` after index `now` and, as far as there are, `history` displacements before.

    cell, kept, rng: which points stay, see `datasets.thinning.thin`.
    """
    thinned = thin(flow.positions[0], flow.volume, cell=cell, kept=kept, rng=rng)
    points = thinned.indices
    first = max(0, now - history)
    return Sample(
        frames=flow.positions[first : now + 1, points],
        velocity0=flow.velocity0[points],
        targets=flow.positions[now + 1 : now + 1 + steps, points],
        friction=flow.friction[points],
        volume=thinned.volumes,
    )


def mirrored(sample: Sample, length: float) -> Sample:
    """The same flow with left and right exchanged, in a domain of `length` [m]."""
    flip = np.array([-1.0] + [1.0] * (sample.velocity0.shape[1] - 1), np.float32)
    origin = np.array([length] + [0.0] * (sample.velocity0.shape[1] - 1), np.float32)
    return Sample(
        frames=origin + flip * sample.frames,
        velocity0=flip * sample.velocity0,
        targets=origin + flip * sample.targets,
        friction=sample.friction,
        volume=sample.volume,
    )
