"""Power laws of runout and height over the aspect ratio, ours and published ones, for low and for tall columns."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from datasets.records import Record, from_mapping, read_toml
from validation.bench.columns.collapse import Deposit
from validation.report.power_law import PowerLaw, fit, prefactor

Quantity = Literal["runout", "height"]
Numbers = NDArray[np.float64]

PUBLISHED = Path(__file__).with_suffix(".toml")
LOW, HIGH = 1.7, 2.5
"""Low columns have aspect ratios up to the one, tall ones from the other; the sources put the break at 1.5 to 3."""
SMALLEST, LARGEST = 0.5, 8.0
"""Aspect ratios that are drawn."""


@dataclass(frozen=True, kw_only=True)
class Law(Record):
    """A published law prefactor a^exponent, in some range of the aspect ratio a."""

    source: str
    dimension: int
    quantity: Quantity
    exponent: float
    prefactor: float | None = None
    above: float = 0.0
    below: float = math.inf

    @property
    def high(self) -> bool:
        """Whether it is of tall columns."""
        return self.below > HIGH + 1.0

    @property
    def range(self) -> str:
        """Such as 1.8 < a."""
        low, high = f"{self.above:g} < " if self.above else "", f" < {self.below:g}" if self.below < math.inf else ""
        return f"{low}a{high}"


@dataclass(frozen=True, kw_only=True)
class Laws(Record):
    """The contents of `laws.toml`."""

    laws: tuple[Law, ...]


def read_laws() -> tuple[Law, ...]:
    """The published laws."""
    return from_mapping(Laws, read_toml(PUBLISHED)).laws


@dataclass(frozen=True, kw_only=True)
class Series:
    """The deposits of columns that differ in their aspect ratio and jitter alone."""

    dimension: int
    cells: int
    """Across the smaller of length and height."""
    friction_deg: float
    deposits: tuple[Deposit, ...]
    volume_error: float = 0.0
    """Of the staircase of slabs in 3D, the largest by its amount [-]."""

    def values(self, quantity: str) -> tuple[Numbers, Numbers]:
        """Aspect ratios and `quantity`, shape [n] each."""
        return (
            np.array([each.aspect for each in self.deposits]),
            np.array([getattr(each, quantity) for each in self.deposits]),
        )

    def branch(self, quantity: str, *, high: bool) -> tuple[Numbers, Numbers]:
        """The same of tall or of low columns alone."""
        aspects, values = self.values(quantity)
        some = aspects >= HIGH if high else aspects <= LOW
        return aspects[some], values[some]

    def fit(self, quantity: str, *, high: bool) -> PowerLaw:
        """The power law of `quantity` of tall or of low columns."""
        return fit(*self.branch(quantity, high=high))

    def prefactor(self, quantity: str, law: Law) -> float:
        """The prefactor of `quantity` with the exponent of a published law."""
        return prefactor(*self.branch(quantity, high=law.high), law.exponent)
