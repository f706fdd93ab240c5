"""A rollout, or a coarse run of the MPM, against the fine reference of the same scene."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datasets import measures
from datasets.records import Record
from datasets.scene import Scene
from datasets.training.thinning import thin
from datasets.trajectory import Floats, Trajectory
from gns.initial import resampled
from validation.bench.surrogate.held_out import core_seconds

AT_WALL = 0.99
"""A front beyond this fraction of the box leans on the far wall, which then bounds everyone's."""
Series = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Deposit(Record):
    """Errors of a deposit over the extent of the reference's [-]."""

    front: float
    """Of the x that 99.5 % of the particles are behind, with its sign."""
    transport: float
    """Rms distance along x of equal shares of the two deposits (`datasets.measures.transport_distance`)."""

    @property
    def error(self) -> float:
        """The larger of the two."""
        return max(abs(self.front), self.transport)


@dataclass(frozen=True, kw_only=True)
class Score(Record):
    """One rollout from the start of a scene beside the fine reference."""

    deposit: Deposit
    kinetic: float
    """Largest difference of the kinetic energies over all energy at the start [-]."""
    potential: float
    """The same of the potential energies [-]."""
    runout: float
    """Error of the largest x over the extent, of as many particles as the model has [-]."""
    depth: float | None
    """Mean difference over time of the depths upstream of the baffles over the reference's largest [-]; None without."""
    at_wall: bool
    """Whether the reference's front leans on the far wall."""
    front: float
    """The reference's [m]."""
    extent: float
    """From the rear at the start to the reference's front [m]."""
    nodes: int
    """Of the model."""
    seconds: float
    """Of the rollout [s]."""
    mpm_seconds: float
    """Of the reference on one core [s]."""


def extent(truth: Trajectory) -> float:
    """From the rear of a flow at the start to the front of its deposit [m]."""
    return measures.front(truth.positions[-1]) - float(truth.positions[0, :, 0].min())


def at_wall(truth: Trajectory) -> bool:
    """Whether the front leans on the far wall."""
    return measures.front(truth.positions[-1]) > AT_WALL * truth.scene.domain.size[0]


def deposit(positions: Floats, volume: Series, truth: Trajectory) -> Deposit:
    """The errors of a deposit [m], shape [n, D], of particles of these volumes [m^D], shape [n]."""
    target, length = truth.positions[-1], extent(truth)
    apart = measures.transport_distance(positions, volume, target, truth.volumes)
    return Deposit(
        front=(measures.front(positions) - measures.front(target)) / length,
        transport=apart / length,
    )


def compare(rollout: Trajectory, truth: Trajectory, cell: float) -> Score:
    """A rollout against the reference; cell: by which the model thins, in the scene [m]."""
    step = rollout.frame_dt
    same = resampled(truth, step)[: len(rollout.positions)]
    ours = rollout.positions[: len(same)]
    predicted, target = (
        energies(positions, flow.velocity0, flow.volumes, step, truth.scene)
        for positions, flow in ((ours, rollout), (same, truth))
    )
    start = float(target[:, 0].sum()) - lowest(truth) * truth.volumes.sum()
    largest = np.abs(predicted - target).max(axis=1) / start
    few = thin(truth.positions[0], truth.volumes, cell=cell, kept=1, rng=np.random.default_rng(0)).indices
    length = extent(truth)
    return Score(
        deposit=deposit(rollout.positions[-1], rollout.volumes, truth),
        kinetic=float(largest[0]),
        potential=float(largest[1]),
        runout=(measures.runout(ours[-1]) - measures.runout(truth.positions[-1, few])) / length,
        depth=depth_error(depths(ours, rollout.volumes, truth.scene), depths(same, truth.volumes, truth.scene)),
        at_wall=at_wall(truth),
        front=measures.front(truth.positions[-1]),
        extent=length,
        nodes=len(rollout.volumes),
        seconds=float(rollout.summary["wall_s"]),
        mpm_seconds=core_seconds(truth),
    )


def energies(positions: Floats, velocity0: Floats, volume: Series, step: float, scene: Scene) -> Series:
    """Kinetic and potential energy over the density at each time [J m^D / kg], shape [2, T].

    positions: `step` [s] apart [m], shape [T, n, D]. Velocities are central differences, the first is `velocity0`. On a
    slope gravity has a component along x, and so has the potential energy.
    """
    velocities = np.gradient(positions, step, axis=0)
    velocities[0] = velocity0
    potential = -(positions.astype(np.float64) @ np.array(scene.gravity_vector)) @ volume
    return np.stack((measures.kinetic_energy(velocities, volume), potential))


def lowest(truth: Trajectory) -> float:
    """Potential energy over the mass of the lowest point that a flow comes to [J/kg]."""
    return float(-(truth.positions @ np.array(truth.scene.gravity_vector)).max())


def depths(positions: Floats, volume: Series, scene: Scene) -> Series:
    """Depth upstream of the first baffles at each time [m], shape [T]; empty where there are none."""
    return np.array([measures.upstream_depth(each, volume, scene) for each in positions if scene.baffles])


def depth_error(found: Series, expected: Series) -> float | None:
    """Mean difference over the largest expected depth [-]; None where the flow never comes so far."""
    if len(expected) == 0 or expected.max() == 0.0:
        return None
    return float(np.abs(found - expected).mean() / expected.max())


def mean(values: Sequence[float]) -> float:
    """Mean of the absolute values; nan of none."""
    return float(np.mean(np.abs(values))) if values else float("nan")


def rms(values: Sequence[float]) -> float:
    """Root mean square; nan of none."""
    return float(np.sqrt(np.mean(np.square(values)))) if values else float("nan")


def worst(values: Sequence[float]) -> float:
    """The value of the largest amount, with its sign; nan of none."""
    return max(values, key=abs) if values else float("nan")
