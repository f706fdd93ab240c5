"""The loop: runs of the MPM narrow the posterior over the whole box, confirm its answers, and give the verdict."""

import math
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from datasets.errors import WorkFailed
from datasets.flow import measures
from datasets.flow.trajectory import Trajectory
from inverse.adaptation import deposits as adapted_runs
from inverse.answer import MpmRun, Purpose, Verdict
from inverse.forward import Simulate
from inverse.forward.mpm import MpmForward
from inverse.observations.observation import recording
from inverse.parameters import Vector
from inverse.posterior.emulator import linear
from inverse.posterior.information import information, measurements
from inverse.posterior.settings import CONSTANTS
from inverse.problem import Problem, read_problem
from inverse.report import summary
from inverse.result import Result
from inverse.saving import save
from inverse.search.descent import ROUGH, inverted
from inverse.search.inference import Inversion, begun, left_out, searched
from inverse.target import read_target
from mpm import simulate_many
from validation.loop import surrogate
from validation.loop.task import Loop, Task
from validation.loop.verdict import Conclusion, concluded, judged, nearer
from validation.run_store import RunStore, kept

Known = tuple[Vector, Trajectory]  # parameters [U], and the MPM's flow with them
RUNS = "mpm"  # folder of the MPM runs beside the result
SUGGESTED = 6  # further measurements that `result.json` suggests


def solve(
    problem: Problem | Path | str,
    out: Path | str | None = None,
    *,
    model: Path | None = None,
    simulate: Simulate = simulate_many,
    known: Sequence[Known] = (),
) -> Result:
    """Find all parameters that `problem` allows; the MPM confirms or refuses each answer.

    >>> from inverse import plot
    >>> from validation import solve
    >>> result = solve("friction-tall-42", "out/loop")
    >>> print(result.verdict, result.unknowns, result.interval)
    >>> plot(result).savefig("found.png")

    problem: one built in Python, the path of a TOML file or a shipped name. out: folder for `result.json`,
    `posterior.npz`, `report.md`, pictures and every MPM run; an interrupted call resumes there. Without it nothing is
    written (`inverse.save` can write the result later). model: weights of the surrogate, by default the shipped ones;
    with a folder of `inverse.adapt`, its MPM runs are reused too. simulate: replaces the MPM. known: MPM runs for other
    targets, which inform the emulator and do not count towards the budget. Raises InputError for a problem that cannot
    be solved as it stands, and WorkFailed if an MPM run blows up or another process writes into `out`.
    """
    asked = problem if isinstance(problem, Problem) else read_problem(problem)
    with kept(out) as folder:
        if asked.fields:
            # Fields have too many values for an emulator; the MPM inverts them itself, by its adjoint.
            from inverse.inversion import invert

            result = invert(asked, model=model)
        else:
            store = RunStore(folder / RUNS, simulate, label="target-")
            target = read_target(asked, lambda scene: store([scene], record=recording(asked.operators))[0])
            made = [] if model is None or target.observation.over_time else adapted_runs(model, asked)
            task = Task(problem=asked, target=target, folder=folder / RUNS, simulate=simulate)
            result = run(task, model=model, known=(*made, *known))
        if out is not None:
            save(result, out)
    return result


def print_outcome(result: Result, out: Path) -> None:
    """Print the outcome. Raises WorkFailed if the MPM did not confirm it."""
    print(summary(result))
    if not result.verdict.confirms:
        raise WorkFailed(f"the answer is {result.verdict}; the nearest that was found is in {out}/report.md")


def run(task: Task, *, model: Path | None = None, known: Sequence[Known] = ()) -> Result:
    """Search, check the answers and judge them; known: runs for other targets."""
    began, used = time.perf_counter(), time.process_time()
    before = tuple(task.run(*pair) for pair in known)
    led, outcome, cells = None, None, tuple[MpmRun, ...]()
    forward, reason = surrogate.choose(task, model)
    if forward is not None:
        print(f"the surrogate leads the search: {reason}", file=sys.stderr)
        rough = 1.0 if isinstance(forward, MpmForward) else ROUGH
        led = inverted(forward, task.problem, task.target, task.scatter, rough=rough)
        state, confirmed = surrogate.guided(task.search(before), led)
        # Runs are expensive here, and the surrogate's answers have been checked.
        outcome = concluded(task, state, moves=0) if confirmed else judged(state)
    elif model is not None:
        print(f"the surrogate is not used: {reason}", file=sys.stderr)
    if outcome is None:
        outcome = concluded(task, searched(begun(task.search(before))))
    elif not outcome.verdict.confirms:
        # If the MPM does not confirm where the surrogate leads, the surrogate must not exclude any parameters.
        tried = tuple(replace(mpm_run, purpose=Purpose.WAVE) for mpm_run in outcome.search.runs)
        cells = outcome.cells
        outcome = nearer(outcome.search, concluded(task, searched(begun(task.search(before, tried)))))
    state, answer = outcome.search, outcome.answers[0]
    files = {mpm_run.file for mpm_run in outcome.cells}
    runs = (*state.runs, *outcome.cells, *(mpm_run for mpm_run in cells if mpm_run.file not in files))
    asked = {"asked": led is not None, "reason": reason}
    coarse = {"coarse_runs": len(led.runs)} if led is not None and isinstance(forward, MpmForward) else {}
    return Result(
        problem=task.problem,
        target=task.target,
        verdict=outcome.verdict,
        answers=outcome.answers,
        forward="MPM",
        predicted=answer.observation,
        deposit=answer.checks[0].trajectory.positions[-1],
        iterations=waves(state),
        mpm_runs=runs,
        posterior=state.knowledge.posterior,
        remark=outcome.remark,
        further=further(outcome),
        without=left_out(state),
        notes=(statement(state),),
        surrogate=asked | ({} if led is None else of_surrogate(task, led, state)),
        seconds={
            "mpm": sum(mpm_run.seconds for mpm_run in runs),
            "total": time.perf_counter() - began,
            "processors": time.process_time() - used,
        },
        record=coarse,
    )


def waves(state: Loop) -> list[dict[str, Any]]:
    """The posterior after each wave, in the form of `result.json`."""
    problem, box = state.knowledge.problem, state.knowledge.box
    return [
        {
            "mpm_runs": len(belief.near) - len(state.known),
            "mean": problem.named(box.at(belief.samples.mean)),
            "deviation": problem.named(box.range * np.sqrt(np.diag(belief.samples.covariance))),
            "emulator_share": belief.emulator_share,
            "with_surrogate": belief.emulator.trend is not linear,
        }
        for belief in (wave.posterior for wave in state.waves)
    ]


def of_surrogate(task: Task, led: Inversion, state: Loop) -> dict[str, Any]:
    """The surrogate's answers, heaviest first, and their MPM misfit, in the form of `result.json`. The misfit is that
    of the MPM runs at the answer; if none were necessary, the emulator's, from the runs around it."""
    named, box, answers = task.problem.named, task.problem.box, []
    for part, parameters in zip(led.answers, task.at(np.stack([part.point for part in led.answers])), strict=True):
        checks = [mpm_run for mpm_run in state.runs if np.array_equal(mpm_run.parameters, parameters)]
        seen = [check.numbers for check in checks] or state.knowledge.posterior.expected(part.point[None])
        shown = np.mean(seen, axis=0)
        error = {"misfit": task.target.misfit(shown)}
        if checks and math.isfinite(task.target.front):
            error["front_pct"] = 100.0 * float(np.mean([task.target.front_error(check.trajectory) for check in checks]))
        interval = dict(zip(task.problem.names, box.at(part.interval).T.tolist(), strict=True))
        answer = {"unknowns": named(parameters), "interval": interval, "weight": part.weight, "mpm_error": error}
        answers.append(answer | {"half_widths": named(box.range * part.half_widths)})
    return {**answers[0], "answers": answers, "seconds": led.seconds, "predictions": len(led.runs)}


def statement(state: Loop) -> str:
    """How the posterior was obtained, in sentences."""
    belief, led = state.knowledge.posterior, state.knowledge.guide is not None
    enough = CONSTANTS.converged_around if state.known or led else CONSTANTS.converged
    more = " **More runs of the MPM (`mpm_runs`) would narrow these.**" if belief.emulator_share > enough else ""
    before = f" ({len(state.known)} of them made before)" if state.known else ""
    return (
        f"An emulator of {int(belief.near.sum())} of the {len(state.every)} MPM runs{before}, each with its own jitter "
        "seed, gives the posterior over the whole box. The uncertainty of the emulator is "
        f"{100.0 * belief.emulator_share:.2g} % of the variance; the 95 % intervals include it.{more} Two "
        f"independent populations of samples differ by {belief.samples.difference:.2g} standard deviations."
    )


def further(outcome: Conclusion) -> dict[str, float]:
    """If the answer is ambiguous: the measurements of a deposit that carry the most information on it."""
    if outcome.verdict is not Verdict.AMBIGUOUS:
        return {}
    state, knowledge = outcome.search, outcome.search.knowledge
    scene, near = knowledge.problem.scene, knowledge.posterior.near
    flows = [run.trajectory for run, is_near in zip(state.every, near, strict=True) if is_near]
    extent = max(measures.front(flow.positions[-1], flow.volumes) for flow in flows)
    shown = [measurements(scene, flow.positions[-1], extent) for flow in flows]
    # If the target's front is known, measuring it again decides nothing.
    observed = {"the front"} if math.isfinite(knowledge.target.front) else set()
    by_name = {name: np.array([measured[name] for measured in shown]) for name in shown[0] if name not in observed}
    points, samples, cell = state.points[near], knowledge.posterior.samples, scene.domain.cell
    gains = information(points, by_name, samples, cell=cell, rng=state.generator())
    return dict([*gains.items()][:SUGGESTED])
