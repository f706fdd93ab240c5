"""The laws of runout and height, ours and others', on both sides of the break between low and tall columns."""

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

PUBLISHED = Path(__file__).with_name("scaling.toml")
LOW, HIGH = 1.7, 2.5
"""Aspect ratios up to the one and from the other lie clear of the break, which the sources put between 1.5 and 3."""


@dataclass(frozen=True, kw_only=True)
class Law(Record):
    """A law that others found, in some range of the aspect ratio."""

    source: str
    dimension: int
    quantity: Quantity
    exponent: float
    prefactor: float | None = None
    above: float = 0.0
    below: float = math.inf

    @property
    def high(self) -> bool:
        """It speaks of tall columns."""
        return self.below > HIGH + 1.0


@dataclass(frozen=True, kw_only=True)
class Laws(Record):
    """The contents of `scaling.toml`."""

    laws: tuple[Law, ...]


@dataclass(frozen=True, kw_only=True)
class Series:
    """The deposits of columns of several aspect ratios that differ in nothing else but their jitter."""

    dimension: int
    cells: int
    """Across the smaller of length and height."""
    friction_deg: float
    deposits: tuple[Deposit, ...]
    volume_error: float = 0.0
    """Of the staircase in 3D, the worst [-]."""

    def of(self, quantity: str) -> tuple[Numbers, Numbers]:
        """Aspect ratios and `quantity`, shape [n] each."""
        return (
            np.array([each.aspect for each in self.deposits]),
            np.array([getattr(each, quantity) for each in self.deposits]),
        )


@dataclass(frozen=True, kw_only=True)
class Side:
    """One side of the break of a series."""

    law: PowerLaw
    aspects: Numbers
    values: Numbers

    def prefactor(self, exponent: float) -> float:
        """Where the exponent is held."""
        return prefactor(self.aspects, self.values, exponent)


def read_laws() -> tuple[Law, ...]:
    """What others found."""
    return from_mapping(Laws, read_toml(PUBLISHED)).laws


def side(series: Series, quantity: str, *, high: bool) -> Side:
    """The power law of `quantity` on one side of the break."""
    aspects, values = series.of(quantity)
    there = aspects >= HIGH if high else aspects <= LOW
    return Side(law=fit(aspects[there], values[there]), aspects=aspects[there], values=values[there])
