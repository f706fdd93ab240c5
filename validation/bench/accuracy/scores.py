"""Errors of the deposits at a resolution against a reference, scene by scene."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datasets import measures
from datasets.trajectory import Trajectory
from inverse.observations.profile import Profile
from mpm.resolution import Resolution, characteristic_length

STATIONS = 10.0
"""Of a profile across the smallest side of the mass."""


@dataclass(frozen=True, kw_only=True)
class Reference:
    """The deposit of a scene on a much finer grid."""

    front: float
    """[m]."""
    shares: NDArray[np.float64]
    """x of equal shares of the deposit [m], shape [20]."""
    extent: float
    """From the rear of the masses at the start to the front [m]; errors are fractions of it."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """A resolution on one scene; errors over the extent [-]."""

    bias: float
    """Mean over the seeds of the front, less the reference's."""
    scatter: float
    """Standard deviation of the front over the seeds; nan of one."""
    errors: tuple[float, ...]
    """Of each run: the larger of its front's and its profile's, the rms distance along x of equal shares; per seed."""
    particle_steps: float

    @property
    def error(self) -> float:
        """Root mean square over the seeds."""
        return float(np.sqrt(np.mean(np.square(self.errors))))

    @property
    def largest(self) -> float:
        """The largest over the seeds."""
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
    def particle_steps(self) -> float:
        """Mean over the scenes."""
        return float(np.mean([score.particle_steps for score in self.scores.values()]))


def reference(flow: Trajectory) -> Reference:
    """The reference from its run."""
    front = measures.front(flow.positions[-1])
    rear = min(mass.lower[0] for mass in flow.scene.masses)
    return Reference(front=front, shares=equal_shares(flow), extent=front - rear)


def score(flows: Sequence[Trajectory], exact: Reference) -> Score:
    """Runs of one scene at one resolution, one per seed, against the reference."""
    off = (np.array([measures.front(flow.positions[-1]) for flow in flows]) - exact.front) / exact.extent
    profiles = [np.sqrt(np.mean((equal_shares(flow) - exact.shares) ** 2)) / exact.extent for flow in flows]
    summary = flows[0].summary
    return Score(
        bias=float(off.mean()),
        scatter=float(off.std(ddof=1)) if len(flows) > 1 else math.nan,
        errors=tuple(np.maximum(np.abs(off), profiles).tolist()),
        particle_steps=summary["steps"] * summary["particles"],
    )


def equal_shares(flow: Trajectory) -> NDArray[np.float64]:
    """The x [m] of twenty equal shares of a deposit, shape [20]."""
    # The last value of a profile is the front, whose error is counted by itself.
    return Profile(flow.scene, characteristic_length(flow.scene) / STATIONS).exact(flow.positions[-1])[:-1]
