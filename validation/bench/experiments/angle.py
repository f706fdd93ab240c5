"""Backward: the angle of friction at which the MPM comes as far as the measurement.

The front falls with the angle. Each round makes one more run of every search, by regula falsi where two runs enclose
the target, else by the secant, until a run is within a fifth of the measurement's spread. The half-width is the spread
over the slope of the front there: the uncertainty of the measurement, without the discrepancy of the model.
"""

import itertools
import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

BOUNDS_DEG = (8.0, 50.0)
"""Angles that are tried [deg]."""
FIRST_DEG = (22.0, 30.0)
"""Where a search begins whose material has no angle of its own [deg]."""
CLOSE = 0.2
"""A run this near to the target ends a search, in spreads."""
ROUNDS = 4
SECOND_DEG = 3.0
"""From the first angle to the second [deg]."""
LARGEST_DEG = 8.0
"""Largest step beyond the angles that were tried [deg]."""
INSIDE = 0.1
"""Share of a bracket that a new angle keeps from its ends."""
SMALLEST_DEG = 0.5
"""The same, the smallest."""
APART_DEG = 2.0
"""Least distance of the runs that a slope is taken from [deg]: closer, scatter would be much of the difference."""

K = TypeVar("K", bound=Hashable)


@dataclass(kw_only=True)
class AngleSearch:
    """The search for the angle that gives one measured extent."""

    target: float
    """Measured extent [m]."""
    spread: float
    """[m]."""
    known: dict[float, float] = field(default_factory=dict)
    """Angle [deg]: extent [m] of every run."""

    @property
    def done(self) -> bool:
        """Whether a run is close enough and another gives the slope, or the target is out of bounds."""
        close = any(abs(found - self.target) <= CLOSE * self.spread for found in self.known.values())
        return (close and len(self.known) > 1) or self.exhausted

    @property
    def exhausted(self) -> bool:
        """Whether the target is beyond the extents at the bounds."""
        low, high = BOUNDS_DEG
        return self.known.get(low, math.inf) < self.target or self.known.get(high, -math.inf) > self.target

    def next_deg(self) -> float:
        """The angle to try next [deg]."""
        low, high = BOUNDS_DEG
        if not self.known:
            return FIRST_DEG[0]
        if len(self.known) == 1:
            ((angle, found),) = self.known.items()
            return min(max(angle + math.copysign(SECOND_DEG, found - self.target), low), high)
        below, above = self.neighbours()
        line = below + (self.target - self.known[below]) * (above - below) / (self.known[above] - self.known[below])
        if self.known[below] >= self.target >= self.known[above]:
            margin = INSIDE * (above - below)
            return min(max(line, below + margin), above - margin)
        steeper = self.known[above] > self.target
        nearest = max(self.known) if steeper else min(self.known)
        step = min(max(abs(line - nearest), SMALLEST_DEG), LARGEST_DEG) if math.isfinite(line) else LARGEST_DEG
        return min(max(nearest + math.copysign(step, 1.0 if steeper else -1.0), low), high)

    def neighbours(self) -> tuple[float, float]:
        """The two angles [deg] that enclose the target most closely, else the two at that end; ascending."""
        angles = sorted(self.known)
        for below, above in itertools.pairwise(angles):
            if self.known[below] >= self.target >= self.known[above]:
                return below, above
        if self.known[angles[-1]] > self.target:
            return angles[-2], angles[-1]
        return angles[0], angles[1]

    def slope(self, near: float) -> float:
        """Change of the extent with the angle [m/deg], from the run at `near` [deg] to the next apart enough."""
        others = sorted((angle for angle in self.known if angle != near), key=lambda angle: abs(angle - near))
        if not others:
            return math.nan
        other = next((angle for angle in others if abs(angle - near) >= APART_DEG), others[-1])
        return (self.known[other] - self.known[near]) / (other - near)

    def inferred(self) -> "InferredAngle":
        """The angle by the runs so far."""
        nearest = min(self.known, key=lambda angle: abs(self.known[angle] - self.target))
        if self.exhausted:
            return InferredAngle(deg=math.nan, half_width_deg=math.nan, runs=len(self.known), miss=math.nan)
        slope = self.slope(nearest)
        miss = (self.known[nearest] - self.target) / self.spread
        if not slope < 0.0:
            return InferredAngle(deg=nearest, half_width_deg=math.inf, runs=len(self.known), miss=miss)
        shift = (self.target - self.known[nearest]) / slope
        return InferredAngle(deg=nearest + shift, half_width_deg=-self.spread / slope, runs=len(self.known), miss=miss)


@dataclass(frozen=True, kw_only=True)
class InferredAngle:
    """The angle at which the computation agrees with a measured extent."""

    deg: float
    """[deg]; nan where none within the bounds gives what was measured."""
    half_width_deg: float
    """By the measurement's spread [deg]; inf where the runs show no fall of the extent."""
    runs: int
    """Runs that were made for it, or forward."""
    miss: float
    """Of the closest run, in spreads [-]."""


def search_all(
    searches: Mapping[K, AngleSearch],
    extents: Callable[[Sequence[tuple[K, float]]], Sequence[float]],
    rounds: int = ROUNDS,
) -> None:
    """Run all searches, in rounds: `extents` gives the extent [m] of each (key of a search, angle [deg])."""
    for _ in range(rounds):
        requested = [(key, search.next_deg()) for key, search in searches.items() if not search.done]
        if not requested:
            return
        for (key, angle), found in zip(requested, extents(requested), strict=True):
            searches[key].known[angle] = found
