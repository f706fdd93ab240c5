"""Measured against computed, in units of the measurement's spread."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from validation.bench.experiments.angle import InferredAngle
from validation.experiments.experiment import Angle, Measured, MeasuredScene, TimeSeries, Variant

CLOSE = 2.0
"""Spreads within which a number agrees."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """A measured number beside the computed one, forward, with an angle that was measured independently."""

    experiment: str
    case: MeasuredScene
    measured: Measured
    angle: Angle
    coarse: float
    """Computed on the coarse cells [m]."""
    fine: float
    """On the fine cells [m]."""

    @property
    def label(self) -> str:
        """Experiment, case and quantity."""
        return f"{self.experiment}, {self.case.name}, {self.measured.quantity}"

    @property
    def error(self) -> float:
        """Computed on the fine cells less measured, in spreads [-]."""
        return error(self.fine, self.measured)

    @property
    def agrees(self) -> bool:
        """Whether it is within twice the spread on the fine cells."""
        return abs(self.error) <= CLOSE


@dataclass(frozen=True, kw_only=True)
class AngleScore:
    """The angle that is inferred from a measured extent, beside the material's own."""

    experiment: str
    case: MeasuredScene
    angles: tuple[Angle, ...]
    """The material's own; empty where none was measured."""
    coarse: InferredAngle
    fine: InferredAngle

    @property
    def label(self) -> str:
        """Experiment and case."""
        return f"{self.experiment}, {self.case.name}"

    @property
    def difference_deg(self) -> float:
        """Inferred on the fine cells less measured [deg]; nan where either is missing."""
        return self.fine.deg - self.angles[0].deg if self.angles else math.nan

    @property
    def agrees(self) -> bool:
        """Whether the two ranges overlap; False where either is missing."""
        if not self.angles:
            return False
        return abs(self.difference_deg) <= self.fine.half_width_deg + self.angles[0].half_width_deg


@dataclass(frozen=True, kw_only=True)
class VariantScore:
    """The extent of a scene that differs in one respect, beside the one that it differs from."""

    experiment: str
    variant: Variant
    measured: Measured
    found: float
    """Extent of the variant [m]."""
    usual: float
    """Extent of the case itself, on the same cells at the same angle [m]."""
    cell: float
    """[m]."""


@dataclass(frozen=True, kw_only=True)
class SeriesScore:
    """An extent over time at the angle that was inferred from its end, beside the measured one."""

    label: str
    series: TimeSeries
    deg: float
    """Angle of friction [deg]."""
    found: tuple[float, ...]
    """Extents [m] at the times of the series."""

    @property
    def errors(self) -> list[float]:
        """In spreads, by row [-]; 0 in the first row by definition."""
        rows = zip(self.found, self.series.values, self.series.spreads, strict=True)
        return [0.0, *[(found - value) / spread for found, value, spread in rows][1:]]


def error(found: float, measured: Measured) -> float:
    """`found` [m] less measured, in units of the measurement's spread [-]."""
    return (found - measured.value) / measured.spread


def rms(values: Iterable[float]) -> float:
    """Root mean square; nan of nothing."""
    squares = [value**2 for value in values]
    return math.sqrt(sum(squares) / len(squares)) if squares else math.nan
