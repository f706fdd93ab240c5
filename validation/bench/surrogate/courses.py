"""How a flow went, from the surrogate and from the MPM on the same points, and how far the two are apart."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datasets import measures
from datasets.scene import Scene
from datasets.training.samples import frames_per_step
from datasets.trajectory import Floats, Trajectory
from gns.score import SPACING
from validation.bench.surrogate.rollouts import Rollout, Start

Series = NDArray[np.float64]
MOMENTS = (0.25, 0.5, 1.0)
"""Shares of a flow's time at which the points are compared."""
AT_WALL = 0.99
"""Points beyond this part of the box stand at the far wall."""


@dataclass(frozen=True, kw_only=True)
class Course:
    """How a flow went, seen on some of its points, K steps from its start to its end."""

    front: Series
    """[m], shape [K + 1]."""
    runout: Series
    """[m], shape [K + 1]."""
    kinetic: Series
    """Kinetic energy from the mean velocities over each step, over all energy at the start [-], shape [K]."""
    potential: Series
    """Potential energy above the floor over the same [-], shape [K + 1]."""
    depth: Series | None
    """Right before the first baffles [m], shape [K + 1]; where there are baffles."""
    profile: Series
    """Of the deposit, volume over x per length, in 2D a height [m^(D-1)], shape [S]."""
    deposit: Floats
    """The last positions [m], shape [n, D]."""


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """One rollout beside the MPM."""

    model: str
    start: Start
    scene: Scene
    step: float
    """[s]."""
    volume: Floats
    """Of the points [m^D], shape [n]."""
    surrogate: Course
    mpm: Course
    """On the surrogate's points."""
    front: float
    """Of the MPM's deposit, all points [m]."""
    runout: float
    """The same of the largest x [m]."""
    scatter: float
    """Standard deviation of the MPM's front over jitter seeds, over the front [-]; nan of one seed."""
    mpm_mse: float
    """Mean squared distance of the points of deposits of the MPM that differ in the jitter [m^2]; nan of one seed."""
    rmse: tuple[float, ...]
    """Root mean square distance of the points at `MOMENTS` [m]."""
    seconds: float
    """Of the rollout [s]."""

    @property
    def at_wall(self) -> bool:
        """Whether the MPM's flow reaches the far wall, which then holds the furthest points of anyone's."""
        return self.runout > AT_WALL * self.scene.domain.size[0]

    @property
    def front_error(self) -> float:
        """Front of the deposit, less that of all the MPM's points, over it [-]."""
        return float(self.surrogate.front[-1] / self.front - 1.0)

    @property
    def thinned_front_error(self) -> float:
        """The same with the MPM's front on the surrogate's points [-]."""
        return float(self.surrogate.front[-1] / self.mpm.front[-1] - 1.0)

    @property
    def runout_error(self) -> float:
        """Largest x, less that of all the MPM's points, over it [-]."""
        return float(self.surrogate.runout[-1] / self.runout - 1.0)

    @property
    def thinned_runout_error(self) -> float:
        """The same with the MPM's on the surrogate's points [-]."""
        return float(self.surrogate.runout[-1] / self.mpm.runout[-1] - 1.0)

    @property
    def profile_error(self) -> float:
        """Area between the height profiles of the deposits over that under the MPM's [-]."""
        return measures.profile_error(self.surrogate.profile, self.mpm.profile)

    @property
    def mse(self) -> float:
        """Mean squared distance of the points at the end [m^2]."""
        return self.rmse[-1] ** 2

    @property
    def kinetic_error(self) -> float:
        """Largest difference over time, over all energy at the start [-]."""
        return float(np.abs(self.surrogate.kinetic - self.mpm.kinetic).max())

    @property
    def potential_error(self) -> float:
        """Largest difference over time, over all energy at the start [-]."""
        return float(np.abs(self.surrogate.potential - self.mpm.potential).max())

    @property
    def energy_error(self) -> float:
        """The larger of the two."""
        return max(self.kinetic_error, self.potential_error)

    @property
    def depth_error(self) -> float:
        """Largest difference of the depths before the baffles over the MPM's greatest depth [-]."""
        assert self.surrogate.depth is not None
        assert self.mpm.depth is not None
        return float(np.abs(self.surrogate.depth - self.mpm.depth).max() / self.mpm.depth.max())

    @property
    def mean_depth_error(self) -> float:
        """Mean over time of the same [-]."""
        assert self.surrogate.depth is not None
        assert self.mpm.depth is not None
        return float(np.abs(self.surrogate.depth - self.mpm.depth).mean() / self.mpm.depth.max())


@dataclass(frozen=True, kw_only=True)
class Truth:
    """The MPM's runs of a scene."""

    flow: Trajectory
    """That of the scene itself."""
    fronts: tuple[float, ...]
    """Of the deposits over jitter seeds, the scene's own first [m]."""
    mse: float
    """Mean squared distance of the points of the other seeds' deposits from its own [m^2]; nan of one seed."""


def compare(model: str, start: Start, rollout: Rollout, truth: Truth) -> Comparison:
    """Hold a rollout against the MPM's runs of the same scene."""
    flow, fronts = truth.flow, truth.fronts
    wanted = same_points(rollout, flow)
    apart = np.square(rollout.positions - wanted).sum(axis=2).mean(axis=1) ** 0.5
    last = len(wanted) - 1
    front = measures.front(flow.positions[-1])
    return Comparison(
        model=model,
        start=start,
        scene=flow.scene,
        step=rollout.step,
        volume=rollout.volume,
        surrogate=course(rollout.positions, rollout, flow.scene),
        mpm=course(wanted, rollout, flow.scene),
        front=front,
        runout=measures.runout(flow.positions[-1]),
        scatter=float(np.std(fronts, ddof=1)) / front if len(fronts) > 1 else float("nan"),
        mpm_mse=truth.mse,
        rmse=tuple(float(apart[round(share * last)]) for share in MOMENTS),
        seconds=rollout.seconds,
    )


def same_points(rollout: Rollout, flow: Trajectory) -> Floats:
    """The MPM's positions of a rollout's points at its times [m], shape [K + 1, n, D]."""
    stride = frames_per_step(flow.scene.frame_dt, rollout.step, "MPM")
    return flow.positions[::stride][: len(rollout.positions), rollout.indices]


def course(positions: Floats, rollout: Rollout, scene: Scene) -> Course:
    """The course of `positions` [m], shape [K + 1, n, D], of the points of `rollout`."""
    volume = rollout.volume.astype(np.float64)
    mass = scene.material.density * volume
    potential = measures.potential_energy(positions, mass, scene.gravity)
    energy = float(potential[0] + measures.kinetic_energy(rollout.velocity0, mass))
    velocities = np.diff(positions.astype(np.float64), axis=0) / rollout.step
    depth = None
    if scene.baffles:
        depth = np.array([measures.upstream_depth(each, volume, scene) for each in positions])
    return Course(
        front=np.array([measures.front(each) for each in positions]),
        runout=np.array([measures.runout(each) for each in positions]),
        kinetic=measures.kinetic_energy(velocities, mass) / energy,
        potential=potential / energy,
        depth=depth,
        profile=measures.height_profile(positions[-1], volume, measures.profile_stations(scene, SPACING)),
        deposit=positions[-1],
    )
