"""How far the deposits at a resolution are from the reference's, scene by scene."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datasets import measures
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from inverse.observations import Profile
from mpm.resolution import Resolution

SPACING = 0.01
"""Of the stations of a profile [m]."""


@dataclass(frozen=True, kw_only=True)
class Truth:
    """What deposits of a scene are held against: the mean of its reference runs."""

    front: float
    """[m]."""
    runout: float
    """[m]."""
    shares: NDArray[np.float64]
    """Where equal shares of the deposit lie along x [m], shape [20]."""
    scatter: float
    """Standard deviation of the front over the reference runs [m]; nan of one."""
    reach: float
    """From the rear of the masses at the start to the front [m]: what errors are fractions of."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """A resolution on one scene; all but the last three over the reach [-]."""

    bias: float
    """Mean over the seeds of the front, less the reference's."""
    runout_bias: float
    """The same of the largest x."""
    scatter: float
    """Standard deviation of the front over the seeds."""
    front_error: float
    """Of one run: root mean square over the seeds."""
    profile_error: float
    """The same of the transport distance between the deposits, the rms distance of equal shares."""
    seconds: float
    """Of a run alone on one thread [s]."""
    particle_steps: float
    fronts: tuple[float, ...]
    """[m], one per seed."""

    @property
    def error(self) -> float:
        """What a tolerance is compared with."""
        return max(self.front_error, self.profile_error)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """A resolution on all scenes of a study."""

    resolution: Resolution
    scores: Mapping[str, Score]

    @property
    def error(self) -> float:
        """Root mean square over the scenes: what to expect of a scene like them."""
        return float(np.sqrt(np.mean([score.error**2 for score in self.scores.values()])))

    @property
    def worst(self) -> float:
        """Of the worst scene."""
        return max(score.error for score in self.scores.values())

    @property
    def scatter(self) -> float:
        """Of the worst scene."""
        return max(score.scatter for score in self.scores.values())

    @property
    def seconds(self) -> float:
        """Mean over the scenes [s]."""
        return float(np.mean([score.seconds for score in self.scores.values()]))

    @property
    def particle_steps(self) -> float:
        """Mean over the scenes."""
        return float(np.mean([score.particle_steps for score in self.scores.values()]))


def truth(flows: Sequence[Trajectory]) -> Truth:
    """The reference that runs of one scene, at several seeds, come to."""
    scene = flows[0].scene
    fronts = [measures.front(flow.positions[-1]) for flow in flows]
    front = float(np.mean(fronts))
    return Truth(
        front=front,
        runout=float(np.mean([measures.runout(flow.positions[-1]) for flow in flows])),
        shares=np.mean([equal_shares(scene, flow) for flow in flows], axis=0),
        scatter=float(np.std(fronts, ddof=1)) if len(flows) > 1 else math.nan,
        reach=front - min(mass.lower[0] for mass in scene.masses),
    )


def score(flows: Sequence[Trajectory], reference: Truth) -> Score:
    """Runs of one scene at one resolution, one per seed, the first of them timed, against the reference."""
    fronts = np.array([measures.front(flow.positions[-1]) for flow in flows])
    runouts = np.array([measures.runout(flow.positions[-1]) for flow in flows])
    distances = [
        np.sqrt(np.mean((equal_shares(flow.scene, flow) - reference.shares) ** 2)) / reference.reach for flow in flows
    ]
    off = (fronts - reference.front) / reference.reach
    first = flows[0].summary
    return Score(
        bias=float(off.mean()),
        runout_bias=float(runouts.mean() - reference.runout) / reference.reach,
        scatter=float(off.std(ddof=1)) if len(flows) > 1 else math.nan,
        front_error=float(np.sqrt(np.mean(off**2))),
        profile_error=float(np.sqrt(np.mean(np.square(distances)))),
        seconds=first["wall_s"],
        particle_steps=first["steps"] * first["particles"],
        fronts=tuple(fronts.tolist()),
    )


def equal_shares(scene: Scene, flow: Trajectory) -> NDArray[np.float64]:
    """The x [m] of twenty equal shares of a deposit, shape [20]."""
    # The last one is the front, which is judged by itself.
    return Profile(scene, SPACING).exact(flow.positions[-1])[:-1]
