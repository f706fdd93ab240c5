"""How far the deposits at a resolution are from the reference's, scene by scene."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datasets import measures
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from inverse.observations.profile import Profile
from mpm.resolution import Resolution, characteristic_length

STATIONS = 10.0
"""Of a profile across the smallest side of the body."""


@dataclass(frozen=True, kw_only=True)
class Truth:
    """What deposits of a scene are held against: the mean of its reference runs."""

    front: float
    """[m]."""
    shares: NDArray[np.float64]
    """Where equal shares of the deposit lie along x [m], shape [20]."""
    scatter: float
    """Standard deviation of the front over the reference runs [m]; nan of one."""
    reach: float
    """From the rear of the masses at the start to the front [m]: what errors are fractions of."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """A resolution on one scene; errors over the reach [-]."""

    bias: float
    """Mean over the seeds of the front, less the reference's."""
    scatter: float
    """Standard deviation of the front over the seeds; nan of one."""
    errors: tuple[float, ...]
    """Of each run: the larger of its front's and of the transport distance between the deposits, one per seed."""
    profile_error: float
    """Root mean square over the seeds of that distance, the rms distance along x of equal shares."""
    particle_steps: float

    @property
    def error(self) -> float:
        """Root mean square over the seeds."""
        return float(np.sqrt(np.mean(np.square(self.errors))))

    @property
    def largest(self) -> float:
        """Of the worst seed."""
        return max(self.errors)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """A resolution on all scenes of a study."""

    resolution: Resolution
    scores: Mapping[str, Score]

    @property
    def error(self) -> float:
        """Root mean square over scenes and seeds."""
        return float(np.sqrt(np.mean([score.error**2 for score in self.scores.values()])))

    @property
    def largest(self) -> float:
        """Of the worst scene and seed."""
        return max(score.largest for score in self.scores.values())

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
        shares=np.mean([equal_shares(scene, flow) for flow in flows], axis=0),
        scatter=float(np.std(fronts, ddof=1)) if len(flows) > 1 else math.nan,
        reach=front - min(mass.lower[0] for mass in scene.masses),
    )


def score(flows: Sequence[Trajectory], reference: Truth) -> Score:
    """Runs of one scene at one resolution, one per seed, against the reference."""
    fronts = np.array([measures.front(flow.positions[-1]) for flow in flows])
    off = (fronts - reference.front) / reference.reach
    distances = np.array(
        [np.sqrt(np.mean((equal_shares(flow.scene, flow) - reference.shares) ** 2)) / reference.reach for flow in flows]
    )
    first = flows[0].summary
    return Score(
        bias=float(off.mean()),
        scatter=float(off.std(ddof=1)) if len(flows) > 1 else math.nan,
        errors=tuple(np.maximum(np.abs(off), distances).tolist()),
        profile_error=float(np.sqrt(np.mean(distances**2))),
        particle_steps=first["steps"] * first["particles"],
    )


def equal_shares(scene: Scene, flow: Trajectory) -> NDArray[np.float64]:
    """The x [m] of twenty equal shares of a deposit, shape [20]."""
    # The last one is the front, which is judged by itself.
    return Profile(scene, characteristic_length(scene) / STATIONS).exact(flow.positions[-1])[:-1]
