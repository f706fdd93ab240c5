"""Figures of tables: what is beyond its bar is bold."""

import math
from collections.abc import Sequence

import numpy as np

from validation.bench.accuracy.page import signed


def mean(values: Sequence[float]) -> float:
    """Mean of the absolute values."""
    return float(np.mean(np.abs(values)))


def rms(values: Sequence[float]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def worst(values: Sequence[float]) -> float:
    """The value that is furthest from zero, with its sign."""
    return max(values, key=abs)


def per_cent(fraction: float, bar: float = math.inf) -> str:
    """0.0213 as 2.1 %, bold where it is beyond `bar`; a dash where there is none."""
    return "-" if math.isnan(fraction) else bold(f"{100.0 * fraction:.1f} %", abs(fraction) > bar)


def off(fraction: float, bar: float = math.inf) -> str:
    """The same with its sign."""
    return bold(signed(fraction), abs(fraction) > bar)


def bold(text: str, whether: bool) -> str:
    """In Markdown."""
    return f"**{text}**" if whether else text


def holds(value: float, bar: float) -> str:
    """Whether a bar holds."""
    return "holds" if value <= bar else "**does not hold**"
