"""The most probable parameters, including fields, and their posterior by Laplace's approximation.

    2 J(w) = |L^-1 (F(w) - y)|^2 + |w|^2,    R = N + (1 + 1/n) C = L L^T
    G = L^-1 dF/dw = U S V^T,    covariance of w = I - V diag(s^2 / (1 + s^2)) V^T

| symbol | variable | meaning |
|---|---|---|
| w | `white` | independent normal numbers of the prior, which determine fields and numbers |
| F | `numbers` | results of MPM runs, mean over n jitter seeds |
| N, C | `noise` | covariance of the measurement; of flows that differ only in their jitter seed |

A field is u = S A w (`inverse.parameters.field`), a number lower + (upper - lower) Phi(w), Phi the normal distribution:
uniform between its bounds. Observations are exact; derivatives come from the adjoint, through the smooth operator: one
reverse pass for each combination of the numbers, one replay of the run for all. Both are averaged over jitter seeds.

Gauss-Newton steps solve the problem linearised about w; a step is halved until runs show that J has fallen.
Derivatives are taken only of combinations of the numbers that the prior moves by more than their errors. The
posterior is a low-rank update of the prior by the eigenpairs of the Hessian of the misfit, preconditioned by the prior
(Bui-Thanh, Ghattas, Martin & Stadler, A computational framework for infinite-dimensional Bayesian inverse problems,
SIAM J. Sci. Comput. 35 (2013) A2494-A2523): along V_k the observation carries s_k^2 times the prior's information.

If a surrogate leads, it searches first; then MPM runs continue with the surrogate's derivatives
(`led`).
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtr

from datasets.scene.grid_field import Floats
from inverse.answer import Answer, MpmRun, Purpose, judge
from inverse.fields.flow import WhiteFlow
from inverse.fields.posterior import FieldPosterior
from inverse.fields.search import Gaussian, Objective, doubted
from inverse.fields.surrogate import SurrogateFlow, leading
from inverse.noise import Scatter, fit
from inverse.observations.target import Target
from inverse.parameters.field import BAND
from inverse.problem import Problem
from inverse.result import Result
from inverse.settings import Derivatives
from inverse.target import read_target
from mpm import simulate
from mpm.adjoint.tape import check
from mpm.arrays.features import features_of

FIRST_SEEDS, FIRST_CONVERGED = 2, 2.0  # jitter seeds of the first search, and how far from its minimum it ends
DRAWS = 100  # stored samples of a field
LEFT = 2.0  # promised decrease of the objective that the report mentions: two standard deviations along one direction
LED_RUNS, LED_CHECKS = 8, 3  # MPM runs if a surrogate leads, and how many of them check the answer, by other jitters


@dataclass(frozen=True)
class Found:
    """The result of a search for fields."""

    posterior: Gaussian
    runs: Floats  # results of runs near the answer that differ in their jitter seed, shape [n, M]
    draws: Floats | None  # results of runs at draws from the prior, shape [n, M], if derivatives are of combinations
    iterates: Sequence[dict[str, float]]
    checks: int  # number of MPM runs that check the answer
    surrogate: dict[str, Any]


def of_fields(problem: Problem, model: Path | None = None) -> Result:
    """The most probable fields and numbers, their posterior, and MPM runs with them. The search uses the MPM's adjoint,
    or a surrogate leads it; model: its weights (`leading`). Raises InputError."""
    began, used = time.perf_counter(), time.process_time()
    target = read_target(problem, simulate)
    flow = WhiteFlow(problem, target.observation)
    lead, reason = leading(problem, target, model)
    if lead is None:
        outcome = alone(flow, target, np.zeros(flow.size))
    else:
        print(f"the surrogate leads the search: {reason}", file=sys.stderr)
        outcome = led(flow, lead, target)
    answer = checked(flow, target, outcome)
    if lead is not None and not answer.confirmed:
        print("the MPM does not confirm its answer and searches on by itself", file=sys.stderr)
        said = outcome.surrogate | {"confirmed": False}
        outcome = replace(alone(flow, target, outcome.posterior.mean), surrogate=said)
        answer = checked(flow, target, outcome)
    posterior, shown = outcome.posterior, answer.checks[0].trajectory
    flow.bar.close()
    fields = field_posteriors(flow, posterior)
    unknowns = sum(int(field.unknown.inside.sum()) for field in fields) + len(problem.numbers)
    notes = [
        f"{unknowns} values from {len(target.values)} numbers: in {posterior.informative} directions the observation "
        "is more informative than the prior, in the Gaussian approximation about the most probable values."
    ]
    if lead is not None:
        said, objective = outcome.surrogate, outcome.surrogate["objective"]
        word = "" if "confirmed" not in said else " The MPM did not confirm it and searched by itself."
        more = f"{said['more_predictions']} more predictions, {said['reverse_passes']} reverse passes"
        notes += [
            f"The surrogate found its answer by {said['predictions']} predictions in {said['seconds']:.0f} s. With its "
            f"derivatives ({more}) runs of the MPM went on: the objective changed from {objective[0]:.4g} to "
            f"{min(objective):.4g}.{word}"
        ]
    decrease = f"decrease of the objective by {posterior.promised:.1f}"
    if posterior.promised > LEFT and "confirmed" not in outcome.surrogate and lead is not None:
        ended = f"The MPM runs ended where derivatives promise a further {decrease}"
        notes.append(f"{ended}; the widths include the errors of the derivatives.")
    elif posterior.cut:
        ended = f"The search ended after `optimiser.max_iterations` = {problem.optimiser.max_iterations}"
        notes.append(f"**{ended}, where its derivatives promise a further {decrease}: give it more iterations.**")
    elif posterior.promised > LEFT:
        ended = f"The search ended where its derivatives promise a {decrease} that no step achieved"
        doubt = "the fields are less certain than their widths show. More `optimiser.seeds` make derivatives smoother."
        notes.append(f"**{ended}: {doubt}**")
    total = time.perf_counter() - began
    counts = {"flows": flow.runs + problem.target.twin, "reverse_passes": flow.reverses}
    return Result(
        problem=problem,
        target=target,
        verdict=judge(problem, (answer,)),
        answers=(answer,),
        forward="MPM",
        predicted=answer.observation,
        deposit=shown.positions[-1],
        iterations=outcome.iterates,
        mpm_runs=answer.checks,
        fields=tuple(fields),
        notes=tuple(notes),
        surrogate={"asked": lead is not None, "reason": reason} | outcome.surrogate,
        seconds={"total": total, "processors": time.process_time() - used},
        record=counts | {"combinations": len(posterior.jacobian), "eigenvalues": posterior.decomposition[0].tolist()},
    )


def checked(flow: WhiteFlow, target: Target, outcome: Found) -> Answer:
    """The answer, with MPM runs at it."""
    problem, posterior, values = flow.problem, outcome.posterior, flow.values(outcome.posterior.mean)
    seeds = range(problem.scatter_seeds[-1] + 1, problem.scatter_seeds[-1] + 1 + outcome.checks)
    spread = np.sqrt(np.maximum(1.0 - (posterior.removed[flow.of_numbers] ** 2).sum(axis=1), 0.0))
    ends = [ndtr(posterior.mean[flow.of_numbers] + sign * BAND * spread) for sign in (1.0, -1.0)]
    checks = tuple(
        MpmRun.of(run, values, problem, target, purpose=Purpose.CHECK, file=f"check{number or ''}.npz")
        for number, run in enumerate(flow.simulated([posterior.mean] * len(seeds), seeds))
    )
    numbers = np.stack([run.numbers for run in checks])
    scatter = scatter_of(outcome.runs if len(checks) == 1 else numbers, target)
    return Answer(
        parameters=values,
        interval=problem.box.at(np.stack(ends[::-1])),
        checks=checks,
        fit=fit(target, numbers, scatter, parameters=posterior.informative),
    )


def first_search(flow: WhiteFlow, target: Target, errors: Floats, start: Floats) -> Found:
    """Search from `start` [W] with the derivatives of `flow`, with few seeds and the scatter at the start.
    errors: covariance of the numbers without the scatter [M, M]."""
    problem, draws = flow.problem, None
    seed, seeds = problem.scene.seed, problem.scatter_seeds
    runs = flow.observe([start] * len(seeds), seeds)
    if flow.reverses_combinations:
        points = np.random.default_rng(seed).standard_normal((len(runs), flow.size))
        draws = flow.observe(list(points), [seed] * len(runs))
    objective = objective_of(flow, target, errors, runs, problem.seeds[:FIRST_SEEDS], draws)
    posterior = objective.minimise(start, problem.optimiser.max_iterations, FIRST_CONVERGED)
    runs = flow.observe([posterior.mean] * len(seeds), seeds)
    return Found(posterior, runs, draws, objective.iterates, 1, {})


def objective_of(
    flow: WhiteFlow, target: Target, errors: Floats, runs: Floats, seeds: Sequence[int], draws: Floats | None
) -> Objective:
    """J with the scatter of `runs` [n, M], which differ only in their jitter seed; errors: as above."""
    scatter = (1.0 + 1.0 / len(seeds)) * scatter_of(runs, target).covariance
    return Objective(flow, target.values, errors + scatter, seeds, draws=draws)


def scatter_of(runs: Floats, target: Target) -> Scatter:
    """The scatter of runs [n, M] at one point, which differ in their jitter seed."""
    expected = target.observation.prior_scatter(target.values)
    return Scatter(deviations=runs - runs.mean(axis=0), freedom=len(runs) - 1, expected=expected)


def alone(flow: WhiteFlow, target: Target, start: Floats) -> Found:
    """Search with the MPM's derivatives from white numbers `start` [W]. Raises InputError without an adjoint."""
    if flow.problem.optimiser.derivatives is Derivatives.ADJOINT:
        check(features_of([flow.problem.scene], "f32"))
    first = first_search(flow, target, errors := target.errors.matrix, start)
    # Repeat with the scatter at the found fields, and all seeds.
    objective = objective_of(flow, target, errors, first.runs, flow.problem.seeds, first.draws)
    posterior = objective.minimise(first.posterior.mean, flow.problem.optimiser.max_iterations)
    return replace(first, posterior=posterior, iterates=[*first.iterates, *objective.iterates])


def led(flow: WhiteFlow, lead: WhiteFlow, target: Target) -> Found:
    """Search with a surrogate, then with its derivatives and MPM runs, the last of which check the answer."""
    began, start = time.perf_counter(), np.zeros(flow.size)
    error = lead.errors(start) if isinstance(lead, SurrogateFlow) else np.zeros((0, len(target.values)))
    outcome = first_search(lead, target, target.errors.matrix + error.T @ error, start)
    posterior, said = outcome.posterior, {"seconds": time.perf_counter() - began, "predictions": lead.runs}
    # Two MPM flows at the answer give the size of the MPM's scatter; the surrogate's scatter gives its shape.
    seeds, shape = [flow.problem.scene.seed, flow.problem.scatter_seeds[0]], scatter_of(outcome.runs, target).covariance
    pair = flow.observe([posterior.mean] * 2, seeds)
    scatter = 0.5 * float(((pair[0] - pair[1]) ** 2).sum()) / float(np.trace(shape)) * shape
    # The MPM does not have the error of the surrogate.
    combinations = posterior.combinations if lead.reverses_combinations else None
    covariance = target.errors.matrix + 2.0 * scatter
    leads = lead, lead.problem.seeds
    objective = Objective(flow, target.values, covariance, seeds[:1], lead=leads, combinations=combinations)
    runs = LED_RUNS - LED_CHECKS - len(pair)
    nearest = objective.minimise(posterior.mean, runs, numbers=pair[0], runs=runs)
    found = zip(lead.problem.fields, lead.fields(posterior.mean), strict=True)
    unknowns = {unknown.settings.name: float(values[unknown.inside].mean()) for unknown, values in found}
    shown = [iterate["objective"] for iterate in objective.iterates]
    more = {"more_predictions": lead.runs - said["predictions"], "reverse_passes": lead.reverses}
    return replace(
        outcome,
        posterior=doubted(nearest, objective.doubt(scatter), flow.directions),
        iterates=[*outcome.iterates, *objective.iterates],
        checks=LED_CHECKS,
        surrogate={"unknowns": unknowns, "objective": shown} | said | more,
    )


def field_posteriors(flow: WhiteFlow, posterior: Gaussian) -> list[FieldPosterior]:
    problem, draws = flow.problem, posterior.draws(DRAWS)
    posteriors = []
    for unknown, part, latent in zip(problem.fields, flow.parts, flow.latents(posterior.mean), strict=True):
        removed = (unknown.prior.field(posterior.removed[part]) ** 2).sum(axis=1)
        width = np.sqrt(np.maximum(unknown.prior.deviation**2 - removed, 0.0))
        shown = unknown.values(unknown.prior.field(draws[:, part].T).T)
        truth = unknown.truth(problem.scene) if problem.target.twin else None
        posteriors.append(FieldPosterior(unknown=unknown, latent=latent, width=width, draws=shown, truth=truth))
    return posteriors
