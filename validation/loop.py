"""`python -m validation.loop PROBLEM --out DIR`: an inversion that the MPM has confirmed, and what it is worth."""

import sys
import time
from pathlib import Path

import numpy as np

from datasets.command_line import WorkFailed, run
from datasets.errors import InputError
from gns import checkpoint
from gns.rollout import shipped
from inverse import observations
from inverse.forward import Simulate, SurrogateSource
from inverse.gns_forward import MEMORY_GIB, GnsSource
from inverse.observations import Observation
from inverse.optimise import Bounds
from inverse.problem import Observable, Problem, read_problem
from inverse.result import Purpose, Result, RunRecord, Verdict, named
from inverse.target import Target, read_target
from inverse.unknowns import with_unknowns
from mpm.simulate import simulate_many
from validation import report
from validation.certainty import Certainty, certainty, misfit
from validation.runs import SHARE, KeptRuns
from validation.search import Checked, Search, search
from validation.solved import Answer, Solved

JUDGED = (Observable.FRONT, Observable.RUNOUT, Observable.PROFILE)
"""Observations that the loop knows how to correct and to confirm."""


def solve(
    problem: Problem, target: Target, observation: Observation, out: Path, source: SurrogateSource, simulate: Simulate
) -> Solved:
    """Find the unknowns of `problem` from `target`; every MPM run is kept under `out`/mpm."""
    began = time.perf_counter()
    lower, upper = np.array(problem.bounds).T
    start = np.array([unknown.initial for unknown in problem.unknowns])
    names = [unknown.name for unknown in problem.unknowns]
    runs = KeptRuns(out / "mpm", simulate)
    members = KeptRuns(out / "mpm", simulate, prefix="ensemble-", deposit_only=True)
    beginnings = KeptRuns(out / "mpm", simulate, prefix="start-")
    state = Search(
        problem=problem,
        target=target,
        observation=observation,
        source=source,
        runs=runs,
        bounds=Bounds(lower=lower, upper=upper),
    )
    frames = source.first_frames(with_unknowns(problem.scene, names, start))
    search(state, source.start(None if frames is None else beginnings([frames])[0]))
    alone, worth = state.checked[0], None
    answer, verdict = Answer(unknowns=state.nearest.unknowns, runs=[state.nearest]), Verdict.UNREACHABLE
    if state.reachable:
        worth = certainty(state, state.nearest.unknowns, members)
        answer = sharpened(state, worth)
        verdict = Verdict.CONFIRMED if confirms(problem, target, answer, worth) else Verdict.UNCONFIRMED
    surrogate = source.start(answer.runs[0].trajectory)
    (seen,) = surrogate.observe([answer.unknowns])
    checks = [(Purpose.CHECK, checked, runs) for checked in state.checked]
    others = [(Purpose.ENSEMBLE, member, members) for member in worth.runs] if worth else []
    records = [record(problem, purpose, checked, kept, out) for purpose, checked, kept in checks + others]
    result = Result(
        problem=problem,
        target=target,
        verdict=verdict,
        answer=answer.unknowns,
        certainty=half_widths(state, answer, worth) if worth else None,
        surrogate=seen,
        mpm=answer.observation,
        front_error_pct=100.0 * answer.front_error,
        loss_surrogate=observations.loss(seen, target.values),
        loss_mpm=observations.loss(answer.observation, target.values),
        rounds=state.rounds,
        mpm_runs=records,
        mpm_seconds=sum(record.seconds for record in records),
        total_seconds=time.perf_counter() - began,
    )
    return Solved(
        result=result,
        answer=answer,
        alone=alone,
        certainty=worth,
        surrogate_deposit=surrogate.deposit(answer.unknowns),
    )


def sharpened(state: Search, worth: Certainty) -> Answer:
    """The unknowns that all runs together point to, and the MPM there.

    A run scatters with its jitter seed, the line through all of them much less. Where a run at the answer misses by
    its own scatter, other seeds join it while the budget lasts, and their mean counts.
    """
    estimate = np.array([calibration.estimate for calibration in worth.calibrations.values()])
    if state.budget < 1 or not np.all(np.isfinite(estimate)):
        return Answer(unknowns=state.nearest.unknowns, runs=[state.nearest])
    unknowns = state.bounds.clip(estimate)
    answer = Answer(unknowns=unknowns, runs=[state.check(unknowns)])
    for seed in np.random.SeedSequence([state.problem.scene.seed, 1]).generate_state(state.budget):
        if confirms(state.problem, state.target, answer, worth):
            break
        answer = Answer(unknowns=unknowns, runs=[*answer.runs, state.check(unknowns, int(seed))])
    return answer


def confirms(problem: Problem, target: Target, answer: Answer, worth: Certainty) -> bool:
    """The verdict: the front, and for a profile the whole of it, within what was asked or the MPM's own scatter."""
    tolerance = max(problem.loop.profile_within, 2.0 * worth.misfit)
    fits = len(target.values) == 1 or misfit(answer.observation, target.values) <= tolerance
    return abs(answer.front_error) <= problem.loop.confirm_within and fits


def half_widths(state: Search, answer: Answer, worth: Certainty) -> dict[str, float]:
    """Half-width of each unknown around the answer; no wider than the bounds, which were known before."""
    return {
        name: float(min(calibration.half_width + abs(calibration.estimate - value), width))
        for (name, calibration), value, width in zip(
            worth.calibrations.items(), answer.unknowns, state.bounds.range, strict=True
        )
    }


def record(problem: Problem, purpose: Purpose, checked: Checked, kept: KeptRuns, out: Path) -> RunRecord:
    """An MPM run as `result.json` tells it."""
    trajectory = checked.trajectory
    return RunRecord(
        purpose=purpose,
        unknowns=named(problem, checked.unknowns),
        observation=checked.observation,
        front=checked.front,
        front_error_pct=100.0 * checked.front_error,
        loss=checked.loss,
        seconds=float(trajectory.summary[SHARE]),
        file=str(kept.file(trajectory.scene).relative_to(out)),
    )


def main(problem: str, /, *, out: Path, model: Path | None = None, memory_gib: float = MEMORY_GIB) -> None:
    """Find the unknowns of PROBLEM, confirmed by the MPM; leaves OUT/result.json, OUT/report.md, pictures and OUT/mpm.

    Running the same command again after a kill uses the MPM runs that are there. Exit status 1 where the MPM did not
    confirm.

    Parameters
    ----------
    problem
        Path of a problem in TOML, or the name of a shipped one.
    out
        Folder for the results.
    model
        Weights of the surrogate; unless given, those that ship for 2D or for 3D.
    memory_gib
        Activations that the backward pass may find ready, instead of computing them again.
    """
    asked = read_problem(problem)
    if asked.observation.kind not in JUDGED:
        expected = f"expected {', '.join(JUDGED)}: nothing else is confirmed here yet, `python -m inverse` solves it"
        raise InputError(f"{expected}, got {asked.observation.kind}", where=problem, key="observation.kind")
    observation = observations.build(asked.observation, asked.scene)
    source = GnsSource(
        checkpoint.load(model or shipped(asked.scene.dimension)).simulator, asked, observation, memory_gib
    )
    hidden = KeptRuns(out / "mpm", simulate_many, prefix="target-", deposit_only=True)
    target = read_target(asked, observation, lambda scene: hidden([scene])[0])
    solved = solve(asked, target, observation, out, source, simulate_many)
    finish(solved, out)


def finish(solved: Solved, out: Path) -> None:
    """Write result, report and pictures, tell the outcome; WorkFailed where the MPM did not confirm."""
    solved.result.write(out)
    report.write(solved, out)
    print(report.summary(solved.result))
    if solved.result.verdict is not Verdict.CONFIRMED:
        raise WorkFailed(f"the answer is {solved.result.verdict}; the nearest that was found is in {out}/report.md")


if __name__ == "__main__":
    sys.exit(run(main, "python -m validation.loop"))
