"""`python -m validation.bench coverage`: how often the truth is within the half-widths that the loop states.

The same twin experiment over and over, each with another jitter seed of its target and, if asked, other noise on the
observation; the whole loop solves each.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from datasets.errors import InputError
from inverse.observations import Target
from inverse.observations.reading import read_target
from inverse.problem import Problem, read_problem
from mpm import LAST, simulate_many
from validation.loop.check import DIFFERENCES, TWIN, Task
from validation.loop.result import Result
from validation.loop.solve import RUNS, run
from validation.loop.source import choose
from validation.report.machine import GNS, MPM
from validation.report.page import Page
from validation.runs import RunStore

FIRST_SEED = 1001
"""Jitter seed of the first target, then upwards; no shipped problem has such a one."""


def bench(
    out: Path,
    *,
    quick: bool,
    keep: Path,
    problem: str = "friction-tall-21",
    experiments: int = 10,
    noise: float = 0.0,
    model: Path | None = None,
) -> str:
    """Solve a twin experiment with `experiments` targets; write OUT/coverage.md and return its conclusion.

    problem: of a `twin` target; noise: standard deviation on each observed number, as a fraction of the true front, of
    a share as a fraction of the share, stated in the problem; model: weights of the surrogate, those that ship where
    absent. quick: two targets. Raises InputError.
    """
    asked = read_problem(problem)
    if not asked.target.twin:
        raise InputError("expected twin = true, the truth must be known", where=problem, key="target")
    if asked.observations:
        raise InputError("expected one [observation]", where=problem, key="observations")
    if experiments < 1 or noise < 0.0:
        raise InputError(f"expected one experiment or more and no negative noise, got {experiments} and {noise:g}")
    results = []
    for number in range(2 if quick else experiments):
        folder = keep / f"{asked.name}-{noise:g}-{number + 1:02d}"
        twin = dataclasses.replace(asked, target=dataclasses.replace(asked.target, seed=FIRST_SEED + number))
        noisy, target = with_noise(twin, noise, folder / RUNS)
        source, _ = choose(noisy, target, RunStore(folder / RUNS, simulate_many, label=DIFFERENCES), model=model)
        result = run(Task(problem=noisy, target=target, source=source, folder=folder / RUNS, simulate=simulate_many))
        result.save(folder)
        results.append(result)
    return page(asked, results, noise, quick=quick).write(out / "coverage.md")


def with_noise(problem: Problem, noise: float, folder: Path) -> tuple[Problem, Target]:
    """`problem` with its noise stated, and its target: the observation of its twin with that noise on it.

    Of the twin's deposit the target keeps nothing: a verdict that used it would use what was not observed.
    """
    store = RunStore(folder, simulate_many, label=TWIN)
    target = read_target(problem, lambda scene: store([scene], record=LAST)[0])
    observation = target.observation
    sigma = noise * float(target.front if observation.unit == "m" else target.values[0])
    errors = np.random.default_rng([problem.target.seed, 2]).normal(size=len(target.values))
    values = target.values + sigma * errors
    stated = dataclasses.replace(problem, target=dataclasses.replace(problem.target, noise=sigma))
    front = observation.front(values)
    return stated, Target(observation=observation, values=values, front=front, truth=target.truth, noise=sigma)


def page(problem: Problem, results: Sequence[Result], noise: float, *, quick: bool) -> Page:
    """The table and its conclusion."""
    known = {each.name: each.kind for each in problem.parameters}
    inside = [name for result in results for name in result.inside]
    verdicts = [str(result.verdict) for result in results]
    by_name = ", ".join(f"`{name}` {inside.count(name)}" for name in known)
    counted = ", ".join(f"{verdicts.count(each)} {each}" for each in dict.fromkeys(verdicts))
    made = Page(
        f"Coverage of the half-widths: {problem.name}",
        command=f"python -m validation.bench coverage --problem {problem.name} --noise {noise:g}",
        conclusion=[
            f"{len(inside)} of {len(known) * len(results)} true values are within the stated 95 % half-widths.",
            f"By parameter, of {len(results)} experiments: {by_name}.",
            f"Verdicts: {counted}.",
        ],
        packages=MPM | GNS,
        quick=quick,
    )
    made.text(
        f"{len(results)} targets that differ in their jitter seed; noise of {100.0 * noise:g} % on the observation."
    )
    rows = []
    for result in results:
        truth, widths = result.target.truth or {}, result.certainty or {}
        row: dict[str, object] = {"seed": result.problem.target.seed}
        for name, kind in known.items():
            width = f" ± {kind.text(widths[name])}" if widths else ""
            row[f"`{name}`"] = f"{kind.text(result.unknowns[name])}{width} (truth {kind.text(truth[name])})"
        checks = len(result.checks)
        row |= {
            "truth inside": f"{len(result.inside)} of {len(known)}",
            "MPM runs (and in ensembles)": f"{checks} (+ {len(result.mpm_runs) - checks})",
            "seconds": f"{result.total_seconds:.0f}",
            "verdict": str(result.verdict),
        }
        rows.append(row)
    made.table(rows)
    return made
