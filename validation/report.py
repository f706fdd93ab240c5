"""`report.md` of a loop: what was found, what the MPM says of it, what it is worth and what it cost."""

from pathlib import Path

from datasets import files
from inverse import pictures
from inverse.optimise import best
from inverse.problem import Observable
from inverse.report import known, observed, price, quantity, question, table
from inverse.result import Purpose, Result, RunRecord, Verdict, named
from inverse.unknowns import kind
from validation.solved import Solved


def write(solved: Solved, folder: Path) -> None:
    """Write `report.md`, `deposit.png` and `iterations.png` into `folder`."""
    result = solved.result
    problem, target = result.problem, result.target
    deposits = {
        "surrogate": solved.surrogate_deposit,
        "MPM": solved.answer.runs[0].trajectory.positions[-1],
    }
    if target.deposit is not None:
        deposits = {"target": target.deposit, **deposits}
    pictures.draw_deposits(folder / "deposit.png", problem.scene, deposits, observed(target))
    checks = [(run.unknowns, run.loss) for run in result.mpm_runs if run.purpose is Purpose.CHECK]
    pictures.draw_iterations(folder / "iterations.png", problem, result.rounds, target.truth, checks)
    lines = [
        f"# {problem.name}: {result.verdict}",
        "",
        question(problem),
        "",
        *answer(solved),
        "",
        *(worth(solved) if solved.certainty else []),
        "![deposits](deposit.png)",
        "",
        "## How it was found",
        "",
        *way(solved),
        "",
        "![iterations](iterations.png)",
        "",
        *price(result),
    ]
    files.write_text(folder / "report.md", "\n".join(lines) + "\n")


def answer(solved: Solved) -> list[str]:
    """The verdict in a sentence and the unknowns in a table."""
    result, runs = solved.result, len(solved.answer.runs)
    problem = result.problem
    within = f"{100.0 * problem.loop.confirm_within:g} %"
    seeds = "run" if runs == 1 else f"mean of {runs} runs with different jitter seeds"
    front = f"the front of the MPM's {seeds} at the answer is {result.front_error_pct:+.2f} % off the target"
    sentence = {
        Verdict.CONFIRMED: f"The MPM confirms: {front}, within the {within} asked.",
        Verdict.UNCONFIRMED: f"The MPM does not confirm: {front}; {within} was asked"
        + (" of the front, and a profile as close as the MPM's own scatter." if is_profile(result) else "."),
        Verdict.UNREACHABLE: "Nothing within the bounds reaches the target, not even in the MPM. "
        f"Below is the nearest that was found; {front}.",
    }[result.verdict]
    alone = named(problem, best(list(result.rounds[0].evaluations)).unknowns)
    first = f"{100.0 * solved.alone.front_error:+.2f} %"
    rows = []
    for name, value in result.unknowns.items():
        half_width = f"± {quantity(name, result.certainty[name])}" if result.certainty else "-"
        rows.append([name, quantity(name, value), half_width, *known(result, name), quantity(name, alone[name]), first])
    truth = ["truth", "error"] if result.target.truth else []
    head = ["unknown", "found", "certain to (95 %)", *truth, "the surrogate alone", "front in the MPM there"]
    return [sentence, "", *table(head, rows)]


def is_profile(result: Result) -> bool:
    """Whether the observation is a profile."""
    return result.problem.observation.kind is Observable.PROFILE


def worth(solved: Solved) -> list[str]:
    """The certainty in plain words."""
    assert solved.certainty is not None
    lines = ["## What it is worth", ""]
    for name, calibration in solved.certainty.calibrations.items():
        what = (
            "the profile, along the direction in which it changes," if is_profile(solved.result) else "the observation"
        )
        lines += [
            f"Near the answer {what} moves by {1e3 * calibration.slope:+.1f} mm per {kind(name).unit} of `{name}`, "
            f"and scatters by {1e3 * calibration.scatter:.1f} mm between MPM runs that differ in nothing but the "
            f"initial jitter ({len(solved.certainty.runs)} extra runs). The target is one such flow as well."
        ]
        range_ = {unknown.name: unknown.upper - unknown.lower for unknown in solved.result.problem.unknowns}[name]
        if calibration.half_width >= range_:
            lines += [f"The slope drowns in the scatter: this observation does not tell `{name}` within its bounds."]
        else:
            lines += [
                f"So the truth lies within {quantity(name, calibration.half_width)} of the estimate, 95 times in 100."
            ]
    return [*lines, ""]


def way(solved: Solved) -> list[str]:
    """Every MPM run."""
    result = solved.result
    names = list(result.unknowns)
    checks = [run for run in result.mpm_runs if run.purpose is Purpose.CHECK]
    members = [run for run in result.mpm_runs if run.purpose is Purpose.ENSEMBLE]
    lines = [
        f"The surrogate proposes, the MPM answers; {len(checks)} of {result.problem.loop.mpm_runs} MPM runs were "
        f"spent, and {len(members)} on the certainty.",
        "",
        *table(["run", *names, "front [m]", "off", "loss [m^2]", "seconds", "file"], [row(run) for run in checks]),
    ]
    if members:
        head = ["ensemble", *names, "front [m]", "off", "loss [m^2]", "seconds", "file"]
        lines += ["", *table(head, [row(run) for run in members])]
    return lines


def row(run: RunRecord) -> list[str]:
    """A line of the table of MPM runs."""
    return [
        run.purpose,
        *(f"{value:.3f}" for value in run.unknowns.values()),
        f"{run.front:.4f}",
        f"{run.front_error_pct:+.2f} %",
        f"{run.loss:.2e}",
        f"{run.seconds:.2f}",
        f"`{run.file}`",
    ]


def summary(result: Result) -> str:
    """The outcome as the terminal shows it."""
    lines = [f"{result.problem.name}: {result.verdict}"]
    for name, value in result.unknowns.items():
        line = f"  {name:<14} {quantity(name, value)}"
        if result.certainty:
            line += f" ± {quantity(name, result.certainty[name])}"
        if result.target.truth:
            line += ", truth {}, error {}".format(*known(result, name))
        lines.append(line)
    checks = sum(run.purpose is Purpose.CHECK for run in result.mpm_runs)
    lines.append(f"  front          {result.front_error_pct:+.2f} % off in the MPM, {checks} MPM runs")
    lines.append(
        f"  time           {result.seconds['total']:.0f} s, {result.seconds['per_iteration']:.1f} s per gradient"
    )
    return "\n".join(lines)
