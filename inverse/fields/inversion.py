"""From a problem to its fields: noise, search, posterior, and a run of the solver that confirms."""

import dataclasses
import math
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from datasets.files import make_folder
from inverse.fields import report
from inverse.fields.flow import Flow
from inverse.fields.noise import Noise, shrunk
from inverse.fields.posterior import Posterior
from inverse.fields.problem import FieldProblem
from inverse.fields.result import FieldResult, FoundField, Price
from inverse.fields.search import combinations, minimise
from inverse.fields.unknown import BAND
from inverse.observations import Target
from inverse.observations.joint import CONFIDENCE, Joint
from inverse.observations.reading import joint, read_joined, read_run
from inverse.result import Verdict
from mpm import simulate

Floats = NDArray[np.float64]

FIRST_SEEDS = 2
"""Jitter seeds of the first search, which ends `FIRST_CONVERGED` from its minimum."""
FIRST_CONVERGED = 2.0


def invert(problem: FieldProblem, *, out: Path | str | None = None) -> FieldResult:
    """The posterior of the fields of `problem`, its most probable fields checked by runs with other jitter seeds.

    out: folder for `result.json`, `field.npz`, `scene.toml`, `report.md`, pictures and a `.vti` of each field. Raises
    InputError for files that are none of the problem's and for a scene that the adjoint does not know, WorkFailed where
    a run blows up or its gradient grows without bound.
    """
    began, used = time.perf_counter(), time.process_time()
    if out is not None:
        make_folder(Path(out))
    target, numbers = observed(problem)
    flow = Flow(problem, target.observation)
    assert target.covariance is not None, "several observations have one"
    start, few = np.zeros(flow.size), problem.seeds[:FIRST_SEEDS]
    noise = Noise(measured=target.covariance, scatter=scatter(flow, start), seeds=len(few))
    draws = drawn(flow)
    first = minimise(
        flow, numbers, noise, combinations(draws, noise), start, problem.search.iterations, few, FIRST_CONVERGED
    )
    # Again with the scatter of the fields that were found, and more seeds.
    noise = Noise(measured=target.covariance, scatter=scatter(flow, first.white), seeds=len(problem.seeds))
    minimum = minimise(
        flow, numbers, noise, combinations(draws, noise), first.white, problem.search.iterations, problem.seeds
    )
    posterior = Posterior(mean=minimum.white, jacobian=minimum.jacobian)
    seed = problem.scatter_seeds[-1] + 1
    (shown,) = flow.observe([minimum.white], [seed])
    deviations = (shown - numbers) / noise.deviation
    distance = float(np.sqrt(np.mean(deviations**2)))
    tolerance = allowed(target.observation)
    flow.bar.close()
    result = FieldResult(
        problem=problem,
        target=dataclasses.replace(target, values=numbers),
        fields=found_fields(problem, flow, posterior),
        posterior=posterior,
        noise=noise,
        predicted=minimum.numbers,
        shown=shown,
        seed=seed,
        verdict=Verdict.CONFIRMED if distance <= tolerance else Verdict.UNCONFIRMED,
        distance=distance,
        tolerance=tolerance,
        iterates=[*first.iterates, *minimum.iterates],
        promised=minimum.promised,
        price=Price(
            seconds=time.perf_counter() - began,
            processor_s=time.process_time() - used,
            runs=flow.runs + int(problem.target.twin),
            reverses=flow.reverses,
            combinations=len(minimum.jacobian),
        ),
    )
    if out is not None:
        report.write(result, Path(out))
    return result


def observed(problem: FieldProblem) -> tuple[Target, Floats]:
    """The target, and its numbers [M] with the noise of a twin drawn on them. Raises InputError."""
    measurements, run = read_joined(problem), None
    if problem.truth is not None:
        run = simulate(problem.with_fields(problem.truth, problem.target.seed))
    elif problem.target.trajectory is not None:
        run = read_run(problem, measurements)
    target = joint(problem, measurements, run)
    if problem.truth is None:
        return target, target.values
    assert target.covariance is not None
    variances, axes = np.linalg.eigh(target.covariance)
    drawn = np.random.default_rng(problem.target.seed).standard_normal(len(variances))
    return target, target.values + axes @ (np.sqrt(np.maximum(variances, 0.0)) * drawn)


def scatter(flow: Flow, white: Floats) -> Floats:
    """Covariance [M, M] of the numbers of runs at `white` [W] that differ in their jitter seed."""
    seeds = flow.problem.scatter_seeds
    return shrunk(flow.observe([white] * len(seeds), seeds))


def drawn(flow: Flow) -> Floats:
    """Numbers [n, M] of runs of one jitter seed at draws of the prior."""
    count = flow.problem.search.ensemble
    white = np.random.default_rng(flow.problem.scene.seed).standard_normal((count, flow.size))
    return flow.observe(list(white), [flow.problem.scene.seed] * count)


def allowed(observation: object) -> float:
    """Root mean square, in standard deviations, that chance exceeds once in twenty times.

    The errors of one observation's numbers are dependent: each counts as one number.
    """
    count = len(observation.parts) if isinstance(observation, Joint) else 1
    return math.sqrt(float(chi2.ppf(CONFIDENCE, count)) / count)


def found_fields(problem: FieldProblem, flow: Flow, posterior: Posterior) -> list[FoundField]:
    """Each field with its widths at the nodes."""
    latents = flow.latents(posterior.mean)
    truths = [None] * len(latents) if problem.truth is None else problem.truth
    found = []
    for unknown, part, latent, truth in zip(problem.unknowns, flow.parts, latents, truths, strict=True):
        before = unknown.prior.deviation
        removed = (unknown.prior.field(posterior.removed[part]) ** 2).sum(axis=1)
        after = np.sqrt(np.maximum(before**2 - removed, 0.0))
        found.append(
            FoundField(
                unknown=unknown,
                part=part,
                latent=latent,
                mean=unknown.values(latent),
                lower=unknown.values(latent - BAND * after),
                upper=unknown.values(latent + BAND * after),
                deviation=unknown.deviation(latent, after),
                prior_deviation=unknown.deviation(np.zeros_like(latent), before),
                removed=removed / before**2,
                truth=None if truth is None else truth.at(unknown.grid.positions),
            )
        )
    return found
