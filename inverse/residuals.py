"""The fit, number by number: a table of observations and of the posterior's predictions.

    e_i = (y_i - median_i) / s_i,    s_i^2 = p_i^2 + n_i^2

p is the standard deviation of predicted further flows without measurement errors, n is the stated standard deviation of
the measurement. Under robust noise the band includes the larger noise of a misread number, but e still uses the stated
noise, so that the number is reported as an outlier.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from datasets.flow.measures import rms
from inverse.inference_data import predictive
from inverse.observations import Values
from inverse.observations.observation import JointPart
from inverse.posterior import Matrix
from inverse.posterior.posterior import Posterior
from inverse.result import Result

OUTLIER = 3.0  # standardised residual beyond which a number is an outlier
LISTED, WORST = 40, 10  # an observation of more numbers than `LISTED` lists only the `WORST`
FACTOR = 30.0  # ratio of an observation to those of all runs beyond which the report asks for its unit
NORMAL = 1.96  # half of a 95 % interval over the standard deviation


@dataclass(frozen=True)
class Residuals:
    """The residuals of one observation; each array of shape [m], in the observation's unit."""

    part: JointPart
    observed: Values
    noise: Values  # stated standard deviation
    median: Values
    lower: Values  # quantile of 2.5 %
    upper: Values  # quantile of 97.5 %
    standardised: Values  # e [-]

    @property
    def outliers(self) -> list[str]:
        """The numbers whose standardised residual exceeds `OUTLIER`, in words."""
        every = zip(places_of(self.part), self.standardised, strict=True)
        return [f"{place} ({off:+.1f})" for place, off in every if abs(off) > OUTLIER]

    @property
    def rows(self) -> list[dict[str, str]]:
        """The rows of a table: all numbers, or the worst ones."""
        order = np.arange(len(self.observed))
        if len(order) > LISTED:
            order = np.sort(np.argsort(-np.abs(self.standardised))[:WORST])
        (label, places), unit, rows = self.part.observation.places, self.part.observation.unit, []
        for n in order:
            row = {"observation": self.part.name, "at": f"{label.split(' [')[0]} {places[n]:.4g}"}
            for name, values in (("observed", self.observed), ("predicted (median)", self.median)):
                row[name] = f"{values[n]:.4g} {unit}".rstrip()
            row["95 % band"] = f"{self.lower[n]:.4g} to {self.upper[n]:.4g}"
            rows.append(row | {"standardised residual": f"{self.standardised[n]:+.2f}"})
        return rows


def places_of(part: JointPart) -> list[str]:
    """The numbers of an observation, in words."""
    label, places = part.observation.places
    name, _, unit = label.rstrip("]").partition(" [")
    at = "" if name == "number" else f" at {name}"
    return [f"{part.name}{at} {place:.4g} {unit}".rstrip(" -") for place in places]


def residuals(result: Result) -> list[Residuals]:
    """The residuals of every observation; none without a posterior, or if it is of single particles of a deposit."""
    posterior, target = result.posterior, result.target
    if posterior is None or len(posterior.reduction.mean) != len(target.values) or target.observation.every_particle:
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
    """p^2, the variance of further flows at points [S, U] without measurement errors, shape [M]."""
    reduction, (_, variance) = posterior.reduction, posterior.emulator.predict(points)
    inside = posterior.unmeasured + np.diag(variance.mean(axis=0)) + np.cov(posterior.emulator.mean(points).T)
    within = np.einsum("ir,rs,is->i", reduction.basis, inside, reduction.basis)
    return np.asarray(within / reduction.weights**2 + reduction.remainder**2)


def outlying(fits: Sequence[Residuals], found: int = 0) -> str:
    """A sentence on the numbers that are far off; found: the number of outliers whose noise counts more already."""
    named = [name for fit in fits for name in fit.outliers]
    which = f"off by more than {OUTLIER:g} standard deviations of noise and prediction together"
    if found and not named:
        return f"With the errors that the outlier{'s' if found > 1 else ''} enlarged, no number is {which}."
    return f"Outliers, {which}: {'; '.join(named)}." if named else f"No number is {which}."


def other_units(result: Result) -> list[str]:
    """Observations that are far smaller, or far larger, than in any run. Shares have no unit, and distances of an
    outline are 0 where they are observed."""
    said = []
    for part in result.target.observation.parts if result.mpm_runs else ():
        observed = rms(result.target.values[part.numbers])
        shown = [rms(run.numbers[part.numbers]) for run in result.mpm_runs]
        far = observed * FACTOR < min(shown) or observed > FACTOR * max(shown)
        if far and part.observation.unit and min(observed, np.median(shown)) > 0.0:
            times = observed / np.median(shown)
            said.append(f"check the unit of {part.name}: it is {times:.1g} times that of the MPM runs")
    return said
