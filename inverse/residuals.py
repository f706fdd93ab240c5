"""The fit, number by number: what was observed beside what the posterior predicts, as a table.

    e_i = (y_i - median_i) / s_i,    s_i^2 = p_i^2 + n_i^2

p is the standard deviation of what further flows would show without errors of measurement, n is the stated standard
deviation of the measurement. Under robust noise the band includes the larger noise of a misread number, and e still
uses the stated one, so that the number is named.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from inverse.inference_data import predictive
from inverse.observations import Values
from inverse.observations.observation import JointPart
from inverse.posterior import Matrix
from inverse.posterior.posterior import Posterior
from inverse.result import Result

OUTLIER = 3.0  # standardised residual beyond which a number is named
LISTED, WORST = 40, 10  # numbers of an observation that are all listed; of more the farthest off
NORMAL = 1.96  # half of a 95 % interval over the standard deviation


@dataclass(frozen=True)
class Residuals:
    """Of one observation; each of shape [m], in its unit."""

    part: JointPart
    observed: Values
    noise: Values  # stated standard deviation
    median: Values
    lower: Values  # of 2.5 %
    upper: Values  # of 97.5 %
    standardised: Values  # e [-]

    @property
    def outliers(self) -> list[str]:
        """The numbers that are off by more than `OUTLIER`, in words."""
        label, places = self.part.observation.places
        name, _, unit = label.rstrip("]").partition(" [")
        beyond = [pair for pair in zip(places, self.standardised, strict=True) if abs(pair[1]) > OUTLIER]
        return [f"{self.part.name} at {name} {place:.4g} {unit}".rstrip() + f" ({off:+.1f})" for place, off in beyond]

    @property
    def rows(self) -> list[dict[str, str]]:
        """Those of a table: all numbers, or those farthest off."""
        order = np.arange(len(self.observed))
        if len(order) > LISTED:
            order = np.sort(np.argsort(-np.abs(self.standardised))[:WORST])
        label, places = self.part.observation.places
        return [
            {
                "observation": self.part.name,
                "at": f"{label.split(' [')[0]} {places[n]:.4g}",
                "observed": f"{self.observed[n]:.4g} {self.part.observation.unit}".rstrip(),
                "predicted (median)": f"{self.median[n]:.4g} {self.part.observation.unit}".rstrip(),
                "95 % band": f"{self.lower[n]:.4g} to {self.upper[n]:.4g}",
                "standardised residual": f"{self.standardised[n]:+.2f}",
            }
            for n in order
        ]


def residuals(result: Result) -> list[Residuals]:
    """Of every observation; none where there is no posterior, or where it is of some particles of a deposit."""
    posterior, target = result.posterior, result.target
    if posterior is None or len(posterior.reduction.mean) != len(target.values):
        return []
    if any(part.observation.every_particle for part in target.observation.parts):
        return []
    rng = np.random.default_rng(result.problem.optimiser.seed)
    points = posterior.samples.drawn(len(posterior.samples.points), rng)
    scale = np.broadcast_to(target.observation.scale, target.values.shape)
    lower, median, upper = scale * np.quantile(predictive(posterior, points, rng), (0.025, 0.5, 0.975), axis=0)
    observed, noise = scale * target.values, scale * target.deviation
    off = (observed - median) / np.maximum(np.sqrt(scale**2 * unmeasured(posterior, points) + noise**2), 1e-300)
    columns = (observed, noise, median, lower, upper, off)
    return [Residuals(part, *(values[part.numbers] for values in columns)) for part in target.observation.parts]


def unmeasured(posterior: Posterior, points: Matrix) -> Values:
    """p^2, the variance of what further flows at points [S, U] would show without errors of measurement, shape [M]."""
    reduction, (_, variance) = posterior.reduction, posterior.emulator.predict(points)
    inside = posterior.unmeasured + np.diag(variance.mean(axis=0)) + np.cov(posterior.emulator.mean(points).T)
    within = np.einsum("ir,rs,is->i", reduction.basis, inside, reduction.basis)
    return np.asarray(within / reduction.weights**2 + reduction.remainder**2)


def outlying(fits: Sequence[Residuals]) -> str:
    named = [name for fit in fits for name in fit.outliers]
    which = f"off by more than {OUTLIER:g} standard deviations of noise and prediction together"
    return f"Outliers, {which}: {'; '.join(named)}." if named else f"No number is {which}."
