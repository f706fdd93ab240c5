"""From a problem with fields to what was found: noise, search, posterior, and a run of the solver that confirms."""

import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from inverse.fields import FoundField
from inverse.found import Answer, MpmRun, Purpose, judge
from inverse.laplace import Gaussian, Objective
from inverse.noise import Scatter, fit, shrunk
from inverse.parameters.field import BAND
from inverse.problem import Problem
from inverse.result import Result
from inverse.target import read_target
from inverse.white import WhiteFlow
from mpm import simulate, simulate_many

FIRST_SEEDS, FIRST_CONVERGED = 2, 2.0
"""Jitter seeds of the first search, and how far from its minimum it ends."""
DRAWS = 100
"""Samples of a field that are kept."""
LEFT = 2.0
"""Promised decrease of the objective beyond which the report says so: two standard deviations along one direction."""


def of_fields(problem: Problem) -> Result:
    """The most probable fields and numbers by the MPM's adjoint, their posterior, and a run of the solver there."""
    began, used = time.perf_counter(), time.process_time()
    target = read_target(problem, simulate)
    flow = WhiteFlow(problem, target.observation)
    measured = target.errors_of(np.eye(len(target.values)))
    iterations, seed = problem.optimiser.max_iterations, problem.scene.seed
    rng, start = np.random.default_rng(seed), np.zeros(flow.size)
    runs = scattered(flow, start)
    draws = flow.observe(list(rng.standard_normal((problem.optimiser.ensemble, flow.size))), [seed] * len(runs))

    def objective(runs: NDArray[np.float64], seeds: Sequence[int]) -> Objective:
        return Objective(flow, target.values, measured + (1.0 + 1.0 / len(seeds)) * shrunk(runs), draws, seeds)

    first = objective(runs, problem.seeds[:FIRST_SEEDS])
    nearest = first.minimise(start, iterations, FIRST_CONVERGED)
    # Again with the scatter of the fields that were found, and more seeds.
    runs = scattered(flow, nearest.posterior.mean)
    second = objective(runs, problem.seeds)
    minimum = second.minimise(nearest.posterior.mean, iterations)
    posterior = minimum.posterior
    scene = flow.scene_at(posterior.mean, problem.scatter_seeds[-1] + 1)
    (shown,) = simulate_many([scene])
    values = flow.values(posterior.mean)
    check = MpmRun(purpose=Purpose.CHECK, parameters=values, trajectory=shown, target=target, file="check.npz")
    expected = target.observation.prior_scatter(target.values)
    scatter = Scatter(deviations=runs - runs.mean(axis=0), freedom=len(runs) - 1, expected=expected)
    answer = Answer(
        parameters=values,
        half_widths=half_widths(flow, posterior),
        checks=(check,),
        fit=fit(target, check.observation[None], scatter, parameters=posterior.informative),
    )
    flow.bar.close()
    fields = found_fields(flow, posterior)
    unknowns = sum(int(each.unknown.inside.sum()) for each in fields) + len(problem.numbers)
    notes = [
        f"{unknowns} values from {len(target.values)} numbers: {posterior.informative} directions in which the "
        "observation tells more than the prior, by the Gaussian approximation about the most probable values."
    ]
    if minimum.promised > LEFT:
        notes.append(
            f"**The search ended where its derivatives promise {minimum.promised:.1f} more of the objective, which no "
            "step brought: the fields are known less well than their widths say. More `optimiser.seeds` make "
            "derivatives smoother.**"
        )
    total = time.perf_counter() - began
    cost = {"flows": flow.runs + 1 + int(problem.target.twin), "reverse_passes": flow.reverses}
    return Result(
        problem=problem,
        target=target,
        verdict=judge(problem, (answer,)),
        answers=(answer,),
        forward="MPM",
        predicted=check.observation,
        deposit=shown.positions[-1],
        iterations=[*first.iterates, *second.iterates],
        mpm_runs=(check,),
        fields=tuple(fields),
        notes=tuple(notes),
        seconds={"total": total, "processors": time.process_time() - used},
        record=cost | {"combinations": len(posterior.jacobian), "eigenvalues": posterior.decomposition[0].tolist()},
        command="python -m inverse",
    )


def scattered(flow: WhiteFlow, white: NDArray[np.float64]) -> NDArray[np.float64]:
    """Numbers [n, M] of runs at `white` [W] that differ in their jitter seed."""
    seeds = flow.problem.scatter_seeds
    return flow.observe([white] * len(seeds), seeds)


def half_widths(flow: WhiteFlow, posterior: Gaussian) -> NDArray[np.float64]:
    """Of the numbers at 95 %, shape [U]."""
    own, box = flow.own, flow.problem.box
    width = np.sqrt(np.maximum(1.0 - (posterior.removed[own] ** 2).sum(axis=1), 0.0))
    ends = [ndtr(posterior.mean[own] + sign * BAND * width) for sign in (1.0, -1.0)]
    return np.asarray(0.5 * box.range * (ends[0] - ends[1]))


def found_fields(flow: WhiteFlow, posterior: Gaussian) -> list[FoundField]:
    """Each field with its widths at the nodes."""
    problem, draws = flow.problem, posterior.draws(DRAWS)
    truths = [None] * len(problem.fields) if not problem.target.twin else problem.true_fields
    found = []
    for unknown, part, latent, truth in zip(
        problem.fields, flow.parts, flow.latents(posterior.mean), truths, strict=True
    ):
        removed = (unknown.prior.field(posterior.removed[part]) ** 2).sum(axis=1)
        found.append(
            FoundField(
                unknown=unknown,
                latent=latent,
                width=np.sqrt(np.maximum(unknown.prior.deviation**2 - removed, 0.0)),
                draws=unknown.values(unknown.prior.field(draws[:, part].T).T),
                truth=None if truth is None else truth.at(unknown.grid.positions),
            )
        )
    return found
