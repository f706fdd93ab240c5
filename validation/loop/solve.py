"""The loop: runs of the MPM narrow the posterior over the whole box, confirm its answers, and give the verdict."""

import sys
import tempfile
import time
from pathlib import Path

from datasets.lock import locked
from inverse.forward.interface import Simulate
from inverse.observations.reading import read_target
from inverse.problem import Problem, read_problem
from mpm import ALL, LAST, simulate_many
from validation.loop import surrogate
from validation.loop.check import TWIN, Task
from validation.loop.result import Result, record
from validation.loop.search import first, searched
from validation.loop.verdict import concluded
from validation.runs import RunStore

RUNS = "mpm"
"""Folder of the MPM runs beside the result."""


def solve(
    problem: Problem | str,
    out: Path | str | None = None,
    *,
    model: Path | None = None,
    simulate: Simulate = simulate_many,
) -> Result:
    """Find all parameters that `problem` allows, each answer confirmed or refused by the MPM.

    >>> from validation import solve
    >>> result = solve("friction-tall-42", "out/loop")
    >>> print(result.verdict, result.unknowns, result.certainty)
    >>> result.plot().savefig("found.png")

    problem: one built in Python, the path of a TOML file or the name of a shipped one. out: folder for `result.json`,
    `posterior.npz`, `report.md`, pictures and every MPM run, where an interrupted command goes on; without it nothing
    is written (`Result.save` does so later). model: weights of the surrogate, those that ship where absent. simulate:
    in place of the MPM. Raises InputError for a problem that cannot be solved as it stands, WorkFailed where a run of
    the MPM blows up or another process writes into `out`.
    """
    if out is None:
        with tempfile.TemporaryDirectory() as folder:
            return _solve(problem, Path(folder), model, simulate)
    with locked(Path(out)):
        result = _solve(problem, Path(out), model, simulate)
        result.save(out)
    return result


def _solve(problem: Problem | str, out: Path, model: Path | None, simulate: Simulate) -> Result:
    asked = read_problem(problem) if isinstance(problem, str) else problem
    folder = out / RUNS
    recorded = ALL if asked.observations else LAST
    target = read_target(asked, lambda scene: RunStore(folder, simulate, label=TWIN)([scene], record=recorded)[0])
    return run(Task(problem=asked, target=target, folder=folder, simulate=simulate), model=model)


def run(task: Task, *, model: Path | None = None, load: surrogate.Load = surrogate.learned) -> Result:
    """Search, check the answers, judge; load: in place of the learned surrogate."""
    began = time.perf_counter()
    state = first(task)
    predictions, reason = surrogate.choose(task, state.price, model=model, load=load)
    if predictions is not None:
        print(f"the surrogate is in the emulator's trend: {reason}", file=sys.stderr)
    outcome = concluded(searched(state, predictions))
    store = RunStore(task.folder, task.simulate)
    records = [
        record(task.problem, each, f"{task.folder.name}/{store.file(each.trajectory, task.recorded).name}")
        for each in (*outcome.state.runs, *outcome.state.coarse)
    ]
    return Result(
        problem=task.problem,
        target=task.target,
        verdict=outcome.verdict,
        answer=outcome.answers[0].parameters,
        certainty=task.problem.named(outcome.answers[0].half_widths),
        front_error_pct=100.0 * outcome.answers[0].front_error,
        outcome=outcome,
        surrogate=reason,
        mpm_runs=records,
        mpm_seconds=sum(each.seconds for each in records),
        total_seconds=time.perf_counter() - began,
    )
