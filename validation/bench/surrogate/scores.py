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
from gns.inference import energies
from gns.initial import resampled
from validation.bench.surrogate.held_out import core_seconds

AT_WALL = 0.01
"""A front within this fraction of the box's length of the wall ahead leans on it, which then bounds everyone's."""
Series = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Deposit(Record):
    """Errors of a deposit over the extent of the reference's [-]."""

    front: float
    """Of the end that the reference's flow has moved farther, which 99.5 % of the particles are behind; positive where
    it is farther than the reference's."""
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
    """Mean difference over time of the depths before the baffles over the reference's largest [-]; None without."""
    at_wall: bool
    """Whether the reference's front leans on the wall ahead."""
    rightwards: bool
    """Whether the front is the one at larger x."""
    front: float
    """The reference's [m]."""
    extent: float
    """Of the reference's deposit from its rear to its front [m]."""
    nodes: int
    """Of the model."""
    seconds: float
    """Of the rollout [s]."""
    mpm_seconds: float
    """Of the reference on one core [s]."""


@dataclass(frozen=True, kw_only=True)
class Ends:
    """Where the deposit of a reference ends, rear and front."""

    x: tuple[float, float]
    """Of the end at smaller and of that at larger x [m]."""
    side: int
    """Which of them has moved farther and so is the front."""

    @staticmethod
    def of_flow(truth: Trajectory) -> "Ends":
        """Those of a reference."""
        start, end = measures.ends(truth.positions[0]), measures.ends(truth.positions[-1])
        moved = (start[0] - end[0], end[1] - start[1])
        return Ends(x=end, side=int(moved[1] >= moved[0]))

    @property
    def extent(self) -> float:
        """Distance of the two [m]."""
        return self.x[1] - self.x[0]

    @property
    def front(self) -> float:
        """The x of the front [m]."""
        return self.x[self.side]

    def at_wall(self, length: float) -> bool:
        """Whether the front leans on the wall ahead; length: of the box [m]."""
        ahead = length - self.front if self.side == 1 else self.front
        return ahead < AT_WALL * length


def deposit(positions: Floats, volume: Series, truth: Trajectory) -> Deposit:
    """The errors of a deposit [m], shape [n, D], of particles of these volumes [m^D], shape [n]."""
    ends = Ends.of_flow(truth)
    beyond = measures.ends(positions)[ends.side] - ends.front
    apart = measures.transport_distance(positions, volume, truth.positions[-1], truth.volumes)
    return Deposit(front=(beyond if ends.side == 1 else -beyond) / ends.extent, transport=apart / ends.extent)


def compare(rollout: Trajectory, truth: Trajectory, cell: float) -> Score:
    """A rollout against the reference; cell: by which the model thins, in the scene [m]."""
    step = rollout.frame_dt
    same = resampled(truth, step)[: len(rollout.positions)]
    ours = rollout.positions[: len(same)]
    gravity = truth.scene.gravity_vector
    # Over the density: volumes are the masses.
    predicted, target = (
        np.array([*energies(positions, flow.velocity0, flow.volumes, step=step, gravity=gravity).values()])
        for positions, flow in ((ours, rollout), (same, truth))
    )
    start = float(target[:, 0].sum()) - lowest(truth) * truth.volumes.sum()
    largest = np.abs(predicted - target).max(axis=1) / start
    few = thin(truth.positions[0], truth.volumes, cell=cell, kept=1, rng=np.random.default_rng(0)).indices
    ends = Ends.of_flow(truth)
    return Score(
        deposit=deposit(rollout.positions[-1], rollout.volumes, truth),
        kinetic=float(largest[0]),
        potential=float(largest[1]),
        runout=(measures.runout(ours[-1]) - measures.runout(truth.positions[-1, few])) / ends.extent,
        depth=depth_error(depths(ours, rollout.volumes, truth.scene), depths(same, truth.volumes, truth.scene)),
        at_wall=ends.at_wall(truth.scene.domain.size[0]),
        rightwards=ends.side == 1,
        front=ends.front,
        extent=ends.extent,
        nodes=len(rollout.volumes),
        seconds=float(rollout.summary["wall_s"]),
        mpm_seconds=core_seconds(truth),
    )


def lowest(truth: Trajectory) -> float:
    """Potential energy over the mass of the lowest point that a flow comes to [J/kg]; on a slope it falls along x."""
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
