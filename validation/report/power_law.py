"""Power laws through measured points."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

CONFIDENCE = 0.95


@dataclass(frozen=True, kw_only=True)
class PowerLaw:
    """y = prefactor x^exponent."""

    prefactor: float
    exponent: float
    half_width: float = math.nan
    """Of the exponent, at 95 % confidence; nan where it was not fitted."""

    def __call__(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(self.prefactor * x**self.exponent)


def fit(x: NDArray[np.float64], y: NDArray[np.float64]) -> PowerLaw:
    """The least-squares line through (log x, log y), three points or more, shape [n] each; width by Student's t."""
    line = stats.linregress(np.log(x), np.log(y))
    width = float(stats.t.ppf(0.5 + CONFIDENCE / 2.0, len(x) - 2)) * line.stderr
    return PowerLaw(prefactor=math.exp(line.intercept), exponent=float(line.slope), half_width=float(width))


def prefactor(x: NDArray[np.float64], y: NDArray[np.float64], exponent: float) -> float:
    """The prefactor that fits best where the exponent is held."""
    return math.exp(float(np.mean(np.log(y) - exponent * np.log(x))))
