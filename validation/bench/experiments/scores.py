"""Measured against found, in units of the measurement's spread."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from validation.bench.experiments.angle import Inferred
from validation.experiments.experiment import Angle, Case, Measured

CLOSE = 2.0
"""Spreads within which a number agrees."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """One measured number beside what was computed, forward, with an angle that was measured independently."""

    experiment: str
    case: Case
    measured: Measured
    angle: Angle
    cells: tuple[float, float]
    """The coarse and the fine one [m]."""
    found: tuple[float, float]
    """On either [m]."""

    @property
    def errors(self) -> tuple[float, float]:
        """Found less measured in spreads [-], on either cell."""
        coarse, fine = (error(found, self.measured) for found in self.found)
        return coarse, fine

    @property
    def error(self) -> float:
        """The same on the fine cells."""
        return self.errors[1]

    @property
    def agrees(self) -> bool:
        """Whether it is within twice the spread on the fine cells."""
        return abs(self.error) <= CLOSE


@dataclass(frozen=True, kw_only=True)
class AngleScore:
    """The angle that the computation infers from a measured extent, beside the material's own."""

    experiment: str
    case: Case
    measured: Measured
    angles: tuple[Angle, ...]
    """The material's own; empty where none was measured."""
    inferred: tuple[Inferred, Inferred]
    """On the coarse and the fine cells."""

    @property
    def difference_deg(self) -> float:
        """Inferred on the fine cells less measured [deg]; nan where either is missing."""
        return self.inferred[1].deg - self.angles[0].deg if self.angles else math.nan

    @property
    def agrees(self) -> bool:
        """Whether the two ranges overlap; False where either is missing."""
        if not self.angles:
            return False
        return abs(self.difference_deg) <= self.inferred[1].half_width_deg + self.angles[0].half_width_deg


def error(found: float, measured: Measured) -> float:
    """Found [m] less measured, in units of the measurement's spread [-]."""
    return (found - measured.value) / measured.spread


def rms(values: Iterable[float]) -> float:
    """Root mean square; nan of nothing."""
    squares = [value**2 for value in values]
    return math.sqrt(sum(squares) / len(squares)) if squares else math.nan
