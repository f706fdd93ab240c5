"""`python -m validation.loop PROBLEM --out DIR`: an inversion that the MPM has confirmed, and what it is worth."""

import dataclasses
import sys
import time
from pathlib import Path

import numpy as np

from datasets.command_line import WorkFailed, run
from datasets.errors import InputError
from inverse.forward.gns import MEMORY_GIB
from inverse.forward.interface import Simulate, SurrogateSource
from inverse.observations import deposit as observations
from inverse.observations.deposit import Observation
from inverse.observations.measurements import prepare
from inverse.observations.target import Target
from inverse.optimise import Bounds
from inverse.problem import Problem, Surrogate, read_problem
from inverse.result import Purpose, Result, RunRecord, Verdict, named
from mpm import simulate_many
from validation.loop import answers, starts
from validation.loop import least_squares as several
from validation.loop import report as loop_report
from validation.loop.certainty import Certainty
from validation.loop.result import Answer, Solved
from validation.loop.runs import SHARE, KeptRuns
from validation.loop.search import Checked, Search, search
from validation.loop.source import choose


def solve(
    problem: Problem,
    target: Target,
    observation: Observation,
    out: Path,
    source: SurrogateSource,
    simulate: Simulate,
    *,
    alone: str | None = None,
) -> Solved:
    """Find the unknowns of `problem` from `target`; every MPM run is kept under `out`/mpm.

    alone: why `source` is no learned surrogate, for the report.
    """
    began = time.perf_counter()
    lower, upper = np.array(problem.bounds).T
    runs = KeptRuns(out / "mpm", simulate)
    members = KeptRuns(out / "mpm", simulate, prefix="ensemble-", deposit_only=not observation.over_time)
    beginnings = KeptRuns(out / "mpm", simulate, prefix="start-")
    state = Search(
        problem=problem,
        target=target,
        observation=observation,
        source=source,
        runs=runs,
        bounds=Bounds(lower=lower, upper=upper),
    )
    frames = source.first_frames(state.scene(problem.initial))
    proposal = starts.invert(state, source.start(None if frames is None else beginnings([frames])[0]))
    if state.single:
        search(state, proposal)
    elif problem.target.least:
        several.improve(state, proposal)
    else:
        several.search(state, proposal)
    worth: Certainty | None = None
    widths: dict[str, float] | None = None
    answer, verdict = Answer(unknowns=state.nearest.unknowns, runs=[state.nearest]), Verdict.UNREACHABLE
    if state.reachable:
        answer, worth = answers.settle(state, members)
        widths = answers.half_widths(state, answer, worth)
        verdict = answers.verdict(state, answer, worth, widths)
    surrogate = source.start(answer.runs[0].trajectory)
    (seen,) = surrogate.observe([answer.unknowns])
    checks = [(Purpose.CHECK, checked, runs) for checked in state.checked]
    ensembles = [*state.surveyed, *worth.runs] if worth else []
    others = [(Purpose.ENSEMBLE, member, members) for member in ensembles]
    records = [record(problem, purpose, checked, kept, out) for purpose, checked, kept in checks + others]
    certain = worth if verdict is not Verdict.UNREACHABLE else None
    result = Result(
        problem=problem,
        target=target,
        verdict=verdict,
        answer=answer.unknowns,
        certainty=widths if certain else None,
        surrogate=seen,
        mpm=answer.observation,
        front_error_pct=100.0 * answer.front_error,
        loss_surrogate=observations.loss(seen, surrogate.wanted(target.values), observation.components),
        loss_mpm=observations.loss(answer.observation, target.values, observation.components),
        rounds=state.rounds,
        other_starts=state.other_starts,
        other_minima=state.other_minima,
        identifiability=certain.identifiability if certain else None,
        discrepancy=certain.widened if certain and certain.discrepancy else None,
        mpm_runs=records,
        mpm_seconds=sum(record.seconds for record in records),
        total_seconds=time.perf_counter() - began,
    )
    return Solved(
        result=result,
        answer=answer,
        proposed=state.checked[0],
        alone=alone,
        begun=state.checked[1] if problem.target.least else None,
        certainty=certain,
        surrogate_deposit=surrogate.deposit(answer.unknowns),
    )


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


def main(
    problem: str,
    /,
    *,
    out: Path,
    model: Path | None = None,
    memory_gib: float = MEMORY_GIB,
    surrogate: Surrogate | None = None,
    vtk: bool = False,
    movie: bool = False,
) -> None:
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
    surrogate
        "none": the MPM alone; unless given, as the problem says, by default wherever a learned one knows the flow.
    vtk
        Write the final MPM run for ParaView as well.
    movie
        Write a movie of the final MPM run as well.
    """
    asked = read_problem(problem)
    if surrogate is not None:
        asked = dataclasses.replace(asked, surrogate=surrogate)
    if memory_gib < 0.0:
        raise InputError(f"expected at least 0 GiB, got {memory_gib:g}", where="--memory-gib")
    hidden = KeptRuns(out / "mpm", simulate_many, prefix="target-", deposit_only=not asked.observations)
    observation, target = prepare(asked, lambda scene: hidden([scene])[0])
    slopes = KeptRuns(out / "mpm", simulate_many, prefix="slope-", deposit_only=not observation.over_time)
    source, alone = choose(asked, observation, slopes, model=model, memory_gib=memory_gib)
    if alone is not None:
        print(f"the MPM runs without the surrogate: {alone}", file=sys.stderr)
    solved = solve(asked, target, observation, out, source, simulate_many, alone=alone)
    finish(solved, out, vtk=vtk, movie=movie)


def finish(solved: Solved, out: Path, *, vtk: bool = False, movie: bool = False) -> None:
    """Write result, report and pictures, tell the outcome; WorkFailed where the MPM did not confirm."""
    solved.result.write(out)
    loop_report.write(solved, out, vtk=vtk, movie=movie)
    print(loop_report.summary(solved.result))
    if solved.result.verdict is not Verdict.CONFIRMED:
        raise WorkFailed(f"the answer is {solved.result.verdict}; the nearest that was found is in {out}/report.md")


if __name__ == "__main__":
    sys.exit(run(main, "python -m validation.loop"))
