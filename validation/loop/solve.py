"""The loop: the surrogate proposes, the MPM checks and corrects it, and gives the verdict on the answer."""

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from inverse.forward.gns import MEMORY_GIB
from inverse.forward.interface import Simulate
from inverse.observations.reading import read_target
from inverse.parameters import Vector
from inverse.problem import Problem, read_problem
from inverse.result import Purpose, Verdict
from mpm import ALL, LAST, simulate_many
from validation.loop import propose
from validation.loop.check import DIFFERENCES, TWIN, History, Task
from validation.loop.result import Result, record
from validation.loop.source import choose
from validation.loop.verdict import judge, refine
from validation.runs import RunStore

RESERVED = 0.375
"""Share of the checks that is kept for the answer that the ensemble points to."""
SETTLED = 0.005
"""A proposal this close to the best check, as a fraction of the range, is left to the ensemble."""
STUCK = 0.0025
"""The same for a design."""
PATIENCE = 2
"""Proposals in a row that improve a design by no more than the scatter, after which it is done."""
RUNS = "mpm"
"""Folder of the MPM runs beside the result."""


def solve(
    problem: Problem | str,
    out: Path | str | None = None,
    *,
    model: Path | None = None,
    memory_gib: float = MEMORY_GIB,
    simulate: Simulate = simulate_many,
) -> Result:
    """Find the parameters of `problem`, confirmed or refused by the MPM.

    >>> from validation import solve
    >>> result = solve("friction-tall-42", "out/loop")
    >>> print(result.verdict, result.unknowns, result.certainty)
    >>> result.plot().savefig("found.png")

    problem: one built in Python, the path of a TOML file or the name of a shipped one. out: folder for `result.json`,
    `report.md`, pictures and every MPM run, where an interrupted command goes on; without it nothing is written
    (`Result.save` does so later). model: weights of the surrogate, those that ship where absent. memory_gib:
    activations that the backward pass may find ready. simulate: in place of the MPM. Raises InputError for a problem
    that cannot be solved as it stands, WorkFailed where a run of the MPM blows up.
    """
    if out is None:
        with tempfile.TemporaryDirectory() as folder:
            return _solve(problem, Path(folder), model, memory_gib, simulate)
    result = _solve(problem, Path(out), model, memory_gib, simulate)
    result.save(out)
    return result


def _solve(problem: Problem | str, out: Path, model: Path | None, memory_gib: float, simulate: Simulate) -> Result:
    asked = read_problem(problem) if isinstance(problem, str) else problem
    folder = out / RUNS
    recorded = ALL if asked.observations else LAST
    target = read_target(asked, lambda scene: RunStore(folder, simulate, label=TWIN)([scene], record=recorded)[0])
    differences = RunStore(folder, simulate, label=DIFFERENCES)
    source, reason = choose(asked, target, differences, model=model, memory_gib=memory_gib)
    if reason is not None:
        print(f"the MPM runs without the surrogate: {reason}", file=sys.stderr)
    task = Task(problem=asked, target=target, source=source, folder=folder, simulate=simulate)
    return run(task, without_surrogate=reason)


def run(task: Task, *, without_surrogate: str | None = None) -> Result:
    """Propose, check, correct, and judge; without_surrogate: the reason why the source is no learned surrogate."""
    began = time.perf_counter()
    problem, target = task.problem, task.target
    proposal, history = propose.first(task, task.source.start(None))
    history = (improve if problem.target.minimise else search)(task, history, proposal)
    answer, uncertainty, history = refine(task, history)
    verdict = judge(task, history, answer, uncertainty)
    widths = problem.named(uncertainty.widths(answer.parameters, task.bounds.range))
    reached = verdict is not Verdict.UNREACHABLE
    surrogate = task.source.start(answer.checks[0].trajectory)
    (predicted,) = surrogate.observe([answer.parameters])
    purposes = [(Purpose.CHECK, each, ALL) for each in history.checks]
    purposes += [(Purpose.ENSEMBLE, each, task.deposit_or_all) for each in history.members]
    store = task.store()
    records = [
        record(problem, purpose, each, f"{task.folder.name}/{store.file(each.trajectory, recorded).name}")
        for purpose, each, recorded in purposes
    ]
    return Result(
        problem=problem,
        target=target,
        verdict=verdict,
        answer=answer.parameters,
        certainty=widths if reached else None,
        surrogate=predicted,
        mpm=answer.observation,
        front_error_pct=100.0 * answer.front_error,
        loss_surrogate=task.observation.misfit(predicted, surrogate.select(target.values)),
        loss_mpm=target.misfit(answer.observation),
        rounds=history.rounds,
        other_starts=history.other_starts,
        other_minima=history.other_minima,
        identifiability=uncertainty.identifiability if reached else None,
        discrepancy=uncertainty.factor if reached and uncertainty.discrepancy else None,
        mpm_runs=records,
        mpm_seconds=sum(each.seconds for each in records),
        total_seconds=time.perf_counter() - began,
        found=answer,
        history=history,
        uncertainty=uncertainty if reached else None,
        surrogate_deposit=surrogate.deposit(answer.parameters),
        without_surrogate=without_surrogate,
    )


def search(task: Task, history: History, proposal: Vector) -> History:
    """Check proposals of the surrogate, corrected by all checks so far, until one confirms or nothing is nearer."""
    radius = task.problem.loop.trust * task.bounds.range
    reserved = int(RESERVED * task.problem.loop.mpm_runs)
    while True:
        before = history.nearest if history.checks else None
        history = history.checked(task.check(proposal))
        anchor = history.nearest
        if task.is_confirmed(anchor) or history.budget(task.problem) <= reserved:
            return history
        if anchor is before:
            radius = radius / 2.0  # The step made it worse.
        proposal, history = propose.step(task, history, radius)
        if task.distance(proposal, anchor.parameters) <= SETTLED:
            return history


def improve(task: Task, history: History, proposal: Vector) -> History:
    """Improve a design from `proposal` or the problem's start, whichever is better, until the scatter hides it."""
    history = history.checked(task.check(proposal)).checked(task.check(task.problem.initial))
    radius, idle = task.problem.loop.trust * task.bounds.range, 0
    while history.budget(task.problem) > 0 and idle < PATIENCE:
        before = history.nearest
        proposal, history = propose.step(task, history, radius)
        if task.distance(proposal, before.parameters) <= STUCK:
            return history
        check = task.check(proposal)
        history = history.checked(check)
        if float(np.subtract(before.observation, check.observation)[0]) > task.prior_scatter:
            idle = 0
        else:
            idle, radius = idle + 1, radius / 2.0
    return history
