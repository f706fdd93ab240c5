"""Stated priors: SciPy's own truncated distributions, a Gaussian by the closed form, correlations, TOML, errors."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy import stats

from datasets.schema import changed, from_mapping
from inverse import Correlation, Parameter, Prior, Problem, read_problem
from inverse.answer import Answer, Combination, unidentified
from inverse.parameters.prior import JointPrior
from inverse.posterior import Matrix
from inverse.posterior.posterior import posterior
from inverse.posterior.sampling import Samples, sample
from inverse.search.descent import inverted
from tests.inverse.flows import problem_of, target_of
from tests.inverse.search.test_descent import NAMES, Formula, WithGradient
from tests.refusals import refused

LOWER, UPPER = 16.0, 45.0
NORMAL = Prior(kind="normal", mean=24.0, deviation=6.0)
LOGNORMAL = Prior(kind="lognormal", mean=30.0, deviation=9.0)
TRIANGULAR = Prior(kind="triangular", mode=20.0)
SIGMA = float(np.sqrt(np.log1p(0.09)))
SCORES = [float(each) for each in (np.log([LOWER, UPPER]) - np.log(30.0) + 0.5 * SIGMA**2) / SIGMA]
EXACT: dict[str, Callable[[Matrix], Matrix]] = {
    "normal": stats.truncnorm(-8.0 / 6.0, 21.0 / 6.0, loc=24.0, scale=6.0).ppf,
    "lognormal": lambda q: np.exp(stats.truncnorm(*SCORES, loc=np.log(30.0) - 0.5 * SIGMA**2, scale=SIGMA).ppf(q)),
    "triangular": stats.triang(4.0 / 29.0, loc=LOWER, scale=29.0).ppf,
    "uniform": stats.uniform(LOWER, 29.0).ppf,
}


def number(prior: Prior | None, name: str = "friction_deg", **bounds: float) -> Parameter:
    return Parameter(name=name, prior=prior, **({"lower": LOWER, "upper": UPPER} | bounds))


def joint(first: float = 0.15, second: float = 0.2, coefficient: float = -0.5) -> JointPrior:
    """Of two normal numbers about 0.4 and 0.6 whose bounds, 0 and 1, hardly cut them off."""
    marginals = {}
    for name, mean, deviation in (("first", 0.4, first), ("second", 0.6, second)):
        prior = Prior(kind="normal", mean=mean, deviation=deviation)
        marginals[name] = number(prior, name, lower=0.0, upper=1.0).marginal
    return JointPrior(marginals, [Correlation(between=("first", "second"), coefficient=coefficient)])


@pytest.mark.parametrize("prior", [NORMAL, LOGNORMAL, TRIANGULAR, Prior(kind="uniform")], ids=lambda prior: prior.kind)
def test_a_measurement_that_says_nothing_leaves_the_prior(prior: Prior) -> None:
    stated, rng = JointPrior({"friction_deg": number(prior).marginal}), np.random.default_rng(0)
    points = rng.random((30, 1))
    numbers = 1e-3 * points + rng.standard_normal((30, 1))
    inference = posterior(points, numbers, target_of(np.zeros(1)), scatter=np.ones(1), rng=rng, prior=stated)
    shares = np.array([0.05, 0.25, 0.5, 0.75, 0.95])
    points, weights = inference.samples.points[:, 0], inference.samples.weights
    quantiles = np.quantile(points, shares, weights=weights, method="inverted_cdf")
    exact = EXACT[prior.kind](shares)
    np.testing.assert_allclose(LOWER + (UPPER - LOWER) * quantiles, exact, atol=0.8)
    # What draws of a prior are made by is exact.
    np.testing.assert_allclose(LOWER + (UPPER - LOWER) * stated.at(shares[:, None])[:, 0], exact, rtol=1e-9)
    # History matching excludes by runs alone.
    even = inference.plausible.points[:, 0]
    assert np.mean(even) == pytest.approx(0.5, abs=0.06)


def test_a_gaussian_likelihood_and_a_gaussian_prior_have_the_closed_form() -> None:
    prior, deviations = joint(), np.array([0.15, 0.2])
    before = np.linalg.inv(np.outer(deviations, deviations) * [[1.0, -0.5], [-0.5, 1.0]])
    np.testing.assert_allclose(prior.precision, before, rtol=0.15)
    measured, mean = np.diag([1.0 / 0.1**2, 1.0 / 0.3**2]), np.array([0.55, 0.3])
    covariance = np.linalg.inv(before + measured)
    centre = covariance @ (before @ [0.4, 0.6] + measured @ mean)

    def density(points: Matrix) -> Matrix:
        off = points - mean
        return np.asarray(prior(points) - 0.5 * ((off @ measured) * off).sum(axis=1))

    samples: Samples = sample(density, np.random.default_rng(0), low=np.zeros(2), high=np.ones(2))
    deviation = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(samples.mean, centre, atol=0.15 * deviation.min())
    np.testing.assert_allclose(samples.covariance, covariance, atol=0.15 * deviation.min() ** 2)
    # int p L = N(mean; m0, C0 + C) sqrt(det 2 pi C), less what is cut off.
    spread = np.linalg.inv(before) + np.linalg.inv(measured)
    exact = stats.multivariate_normal([0.4, 0.6], spread).logpdf(mean)
    exact += 0.5 * np.linalg.slogdet(2.0 * np.pi * np.linalg.inv(measured))[1]
    assert samples.evidence == pytest.approx(exact, abs=0.1)
    slopes = prior.slope(np.array([[0.5, 0.5], [0.2, 0.7]]))
    np.testing.assert_allclose(slopes, (np.array([0.4, 0.6]) - [[0.5, 0.5], [0.2, 0.7]]) @ before, rtol=0.1, atol=0.3)


@pytest.mark.parametrize("coefficient", [-0.5, 0.8])
def test_normal_scores_have_the_stated_correlation(coefficient: float) -> None:
    pair = Correlation(between=("friction_deg", "cohesion"), coefficient=coefficient)
    prior = JointPrior({"friction_deg": number(TRIANGULAR).marginal, "cohesion": number(LOGNORMAL).marginal}, [pair])
    points = prior.at(np.random.default_rng(0).random((20_000, 2)))
    values = LOWER + (UPPER - LOWER) * points
    for index, kind in enumerate(("triangular", "lognormal")):
        assert stats.kstest(EXACT[kind](np.linspace(0.0, 1.0, 2001)), values[:, index]).pvalue > 1e-3
    scores = stats.norm.ppf([stats.rankdata(column) / (len(column) + 1.0) for column in values.T])
    assert np.corrcoef(scores)[0, 1] == pytest.approx(coefficient, abs=0.03)
    # The density belongs to the draws: its mean over the box is 1, and so is that of its inverse over draws.
    middles = (np.arange(200) + 0.5) / 200.0
    grid = np.stack(np.meshgrid(middles, middles), axis=-1).reshape(-1, 2)
    density = np.exp(prior(grid))
    assert density.mean() == pytest.approx(1.0, abs=0.01)
    np.testing.assert_allclose(density @ grid / density.sum(), points.mean(axis=0), atol=0.01)
    assert np.isfinite(prior(np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 1.0]]))).all()


def test_how_wide_a_prior_is_decides_what_was_identified(tmp_path: Path) -> None:
    problem = stated(tmp_path)
    wide, narrow = problem.prior_widths
    assert wide == pytest.approx(2.0 * 1.96 * 2.0 / 0.95, rel=0.01)
    half = np.array([0.3 * wide, 0.2 * narrow])
    found = Answer(parameters=problem.initial, interval=problem.initial + np.outer((-1.0, 1.0), half))
    assert unidentified(problem, found) == ["friction_deg"]
    free = dataclasses.replace(problem, parameters=plain(problem), correlations=())
    assert unidentified(free, found) == []
    np.testing.assert_array_equal(free.prior_widths, free.box.range)
    assert Combination(weights={}, half_width=0.25).identifiable
    assert not Combination(weights={}, half_width=0.25, prior=0.3).identifiable


GOOD = """
scene = "column-tall-42"
unknowns = [
  { name = "friction_deg", lower = 16.0, upper = 45.0, prior = { kind = "normal", mean = 30.0, deviation = 2.0 } },
  { name = "cohesion", lower = 30.0, upper = 3000.0, prior = { kind = "lognormal", mean = 600.0, deviation = 400.0 } },
]
correlations = [{ between = ["friction_deg", "cohesion"], coefficient = -0.5 }]
observations = [{ kind = "front", value = 0.55 }]
"""


def stated(folder: Path, text: str = GOOD) -> Problem:
    (folder / "problem.toml").write_text(text)
    return read_problem(str(folder / "problem.toml"))


def plain(problem: Problem) -> tuple[Parameter, ...]:
    numbers = problem.parameters
    return tuple(dataclasses.replace(parameter, prior=None, initial=parameter.start) for parameter in numbers)


def test_a_stated_prior_is_read_and_a_uniform_one_is_none(tmp_path: Path) -> None:
    read = stated(tmp_path)
    # The search starts at the median: of a lognormal number exp(mu), all but what the bounds cut off.
    np.testing.assert_allclose(read.initial, [30.0, 600.0 / np.sqrt(1.0 + (4.0 / 6.0) ** 2)], rtol=0.01)
    for parameter in read.parameters:
        assert from_mapping(Parameter, changed(parameter)) == parameter
    assert read_problem("cohesion-friction").prior is None
    uniform = tuple(dataclasses.replace(parameter, prior=Prior(kind="uniform")) for parameter in plain(read))
    assert dataclasses.replace(read, parameters=uniform, correlations=()).prior is None


def test_a_lognormal_velocity_below_0_and_pairs_that_contradict_each_other_are_refused() -> None:
    assert refused(LOGNORMAL.check, -1.0, 5.0).key == "kind"
    numbers, pairs = {name: number(None, name).marginal for name in "abc"}, (("ab", 0.9), ("bc", 0.9), ("ac", -0.9))
    stated = [Correlation(between=tuple(pair), coefficient=coefficient) for pair, coefficient in pairs]
    assert refused(JointPrior, numbers, stated).key == "correlations"


@pytest.mark.parametrize("made", [Formula, WithGradient])
def test_the_gradient_ends_at_the_most_probable_parameters(made: type[Formula]) -> None:
    """Numbers that are linear in one parameter, as precise together as its prior: the mean of both."""
    free = problem_of(2, NAMES[0])
    (parameter,), low, width = free.parameters, free.box.lower[0], free.box.range[0]
    prior = Prior(kind="normal", mean=low + 0.6 * width, deviation=0.05 * width)
    problem = dataclasses.replace(free, parameters=(dataclasses.replace(parameter, prior=prior),))
    forward = made(problem, curvature=0.0)
    (values,) = forward.observe([low + np.array([0.4]) * width])
    noise = 0.05 * 0.1 * float(torch.linalg.norm(forward.matrix))
    result = inverted(forward, problem, target_of(values, noise), np.zeros(len(values)), rough=0.01)
    (answer,) = result.answers
    assert answer.point[0] == pytest.approx(0.5, abs=0.01)
    assert answer.half_widths[0] == pytest.approx(1.96 * 0.05 / np.sqrt(2.0), rel=0.25)
