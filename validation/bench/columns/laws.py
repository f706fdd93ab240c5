"""Power laws of runout and height over the aspect ratio, ours and published ones, for low and for tall columns."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from datasets.records import Record, from_mapping, read_toml
from validation.bench.columns.collapse import Deposit
from validation.report.plots import GREEN, GREY, INK, ORANGE
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
    def formula(self) -> str:
        """Such as 1.2 a^1."""
        return f"{'' if self.prefactor is None else f'{self.prefactor:g} '}a^{self.exponent:.2g}"

    @property
    def range(self) -> str:
        """Such as 1.8 < a."""
        low, high = f"{self.above:g} < " if self.above else "", f" < {self.below:g}" if self.below < math.inf else ""
        return f"{low}a{high}"

    def holds(self, aspect: float) -> bool:
        """Whether it has a value at an aspect ratio."""
        return self.prefactor is not None and self.above <= aspect <= self.below

    def at(self, aspect: float) -> float:
        """Its value; nan without a prefactor."""
        return math.nan if self.prefactor is None else self.prefactor * aspect**self.exponent


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


def draw_laws(axis: Axes, laws: Sequence[Law]) -> None:
    """Published laws that have a prefactor, a colour per source."""
    drawn = [law for law in laws if law.prefactor is not None]
    colours = dict(zip(dict.fromkeys(law.source for law in drawn), (INK, ORANGE, GREEN, GREY), strict=False))
    labelled = set[str]()
    for law in drawn:
        ends = np.array([max(law.above, SMALLEST), min(law.below, LARGEST)])
        label = None if law.source in labelled else law.source
        labelled.add(law.source)
        axis.plot(ends, [law.at(end) for end in ends], "--", color=colours[law.source], linewidth=1.3, label=label)


def aspect_axis(axis: Axes, ticks: Sequence[float]) -> None:
    """Logarithmic axes over the aspect ratio, `ticks` on the other one, and a legend."""
    axis.set(xscale="log", yscale="log", xlabel="aspect ratio a = H / L")
    axis.set_xticks([0.5, 1, 2, 4, 8], ["0.5", "1", "2", "4", "8"])
    axis.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.minorticks_off()
    axis.legend()
