"""`python -m validation.friction --out DIR`: the paper's friction problem, by every method we have, in one document."""

import os
import platform
import sys
from pathlib import Path

from datasets import files
from datasets.command_line import run
from gns import checkpoint
from gns.rollout import SHIPPED
from gns.simulator import Simulator
from inverse import observations
from inverse.gns_forward import GnsSource
from inverse.problem import Problem, read_problem
from inverse.report import table
from inverse.result import Purpose
from inverse.target import read_target
from mpm.simulate import simulate_many
from validation import loop_report
from validation.gradients import COMPARED, comparison
from validation.loop import solve
from validation.paper import Paper, read_paper
from validation.runs import KeptRuns
from validation.solved import Solved

NAME = "friction_deg"


def main(*, out: Path, model: Path = SHIPPED, problems: tuple[str, ...] = (), compare: bool = True) -> None:
    """Solve the paper's four columns by front and by profile, and compare the gradients; leaves OUT/friction.md.

    Parameters
    ----------
    out
        Folder for the results, one more for each problem.
    model
        Weights of the surrogate.
    problems
        Shipped problems or paths; the eight friction problems unless given.
    compare
        Whether to compare the gradients on the tall column at 42 degrees as well.
    """
    paper = read_paper()
    simulator = checkpoint.load(model).simulator
    names = problems or tuple(
        f"friction-{scenario.name}{kind}" for kind in ("", "-profile") for scenario in paper.scenarios
    )
    asked = [read_problem(name) for name in names]
    rows = [loop_row(problem, out / problem.name, simulator, paper) for problem in asked]
    lines = [
        "# The friction angle of four columns",
        "",
        "Target and check come from our own MPM, with different initial jitters. Errors are relative; the paper's",
        "front is the largest x, ours the x that 99.5 % of the points are behind.",
        "",
        f"`python -m validation.friction`, {os.cpu_count()} cores ({platform.machine()}).",
        "",
        *table(HEAD, rows),
        "",
        "The paper's angles are its surrogate's alone; nothing corrects them there.",
        "",
    ]
    if compare:
        lines += comparison(read_problem(f"friction-{COMPARED}"), simulator, paper)
    files.write_text(out / "friction.md", "\n".join(lines) + "\n")
    print("\n".join(lines))


HEAD = [
    "problem",
    "truth",
    "paper: angle",
    "paper: error of angle, front",
    "surrogate alone",
    "its error of angle, of the front in the MPM",
    "after the loop",
    "error of angle, front",
    "certain to (95 %)",
    "truth inside",
    "MPM runs (and ensemble)",
    "gradients",
    "seconds",
    "verdict",
]


def loop_row(problem: Problem, out: Path, simulator: Simulator, paper: Paper) -> list[str]:
    """Run the loop on one problem and tell it in a line."""
    observation = observations.build(problem.observation, problem.scene)
    source = GnsSource(simulator, problem, observation)
    hidden = KeptRuns(out / "mpm", simulate_many, prefix="target-", deposit_only=True)
    target = read_target(problem, observation, lambda scene: hidden([scene])[0])
    solved = solve(problem, target, observation, out, source, simulate_many)
    solved.result.write(out)
    loop_report.write(solved, out)
    print(loop_report.summary(solved.result), flush=True)
    return cells(solved, paper)


def cells(solved: Solved, paper: Paper) -> list[str]:
    """A line of the table of problems."""
    result = solved.result
    truth = result.target.truth[NAME] if result.target.truth else float("nan")
    stated = [scenario for scenario in paper.scenarios if result.problem.name == f"friction-{scenario.name}"]
    alone = float(solved.alone.unknowns[0])
    found = result.unknowns[NAME]
    width = result.certainty[NAME] if result.certainty else float("nan")
    checks = sum(run.purpose is Purpose.CHECK for run in result.mpm_runs)
    return [
        result.problem.name,
        f"{truth:.2f}",
        f"{stated[0].phi_estimated:.2f}" if stated else "-",
        f"{stated[0].phi_error_pct:.2f} %, {stated[0].front_error_pct:.2f} %" if stated else "-",
        f"{alone:.2f}",
        f"{percent(alone, truth)}, {100.0 * abs(solved.alone.front_error):.2f} %",
        f"{found:.2f}",
        f"{percent(found, truth)}, {abs(result.front_error_pct or 0.0):.2f} %",
        f"± {width:.2f}",
        "yes" if abs(found - truth) <= width else "no",
        f"{checks} (+ {len(result.mpm_runs) - checks})",
        str(len(result.evaluations)),
        f"{result.total_seconds:.0f}",
        str(result.verdict),
    ]


def percent(value: float, truth: float) -> str:
    """Relative error."""
    return f"{100.0 * abs(value - truth) / truth:.2f} %"


if __name__ == "__main__":
    sys.exit(run(main, "python -m validation.friction"))
