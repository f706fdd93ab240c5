"""`report.md` of a loop: what was found, what the MPM says of it, what it is worth and what it cost."""

import math
from pathlib import Path

import numpy as np

from datasets import files
from datasets.exchange.vtk import SERIES, frames_of, write_vtk
from datasets.trajectory import Trajectory
from inverse.observations.deposit import Values, build
from inverse.optimise import best
from inverse.problem import Observable
from inverse.report import course, pictures
from inverse.report.course import Check
from inverse.report.markdown import (
    OBSERVATION,
    answer,
    away,
    code,
    found_picture,
    known,
    number,
    observation_row,
    over_target,
    price,
    quantity,
    question,
    rounds_table,
    table,
    told,
)
from inverse.result import Purpose, Result, RunRecord, Verdict, named
from validation.loop import identifiability as worth
from validation.loop.agreement import allowed, distance, of_the_front
from validation.loop.answers import undetermined
from validation.loop.result import Solved

APART = {
    Observable.FRONT: "% of the front",
    Observable.RUNOUT: "% of the runout",
    Observable.PROFILE: "% of the profile's mean x, read sideways",
    Observable.TOE: "mm",
    Observable.DEPOSIT: "mm, root mean square over the points",
    Observable.PASSED: "% of the material",
    Observable.SEVERAL: "standard deviations, root mean square over the numbers",
}
"""What a verdict is measured in (`validation.loop.agreement.distance`)."""
EVERY = 4
"""A movie shows every so many frames: a hundredth of a second each."""
RATE = 25
"""Frames of the movie a second: a quarter of the speed of life."""


def write(solved: Solved, folder: Path, *, vtk: bool = False, movie: bool = False) -> None:
    """Write `report.md` and its pictures into `folder`.

    vtk, movie: the final MPM run for ParaView and as a movie as well. Raises WorkFailed where a movie cannot be drawn.
    """
    draw(solved, folder)
    lines = [*document(solved, folder), *price(solved.result)]
    files.write_text(folder / "report.md", "\n".join(lines) + "\n")
    if vtk or movie:
        # The report stands whatever becomes of the movie.
        lines += ["", *shown(solved.answer.runs[0].trajectory, folder, vtk=vtk, movie=movie)]
        files.write_text(folder / "report.md", "\n".join(lines) + "\n")


def draw(solved: Solved, folder: Path) -> None:
    """The pictures."""
    result = solved.result
    problem, target = result.problem, result.target
    deposits = {
        "surrogate": solved.surrogate_deposit,
        "MPM": solved.answer.runs[0].trajectory.positions[-1],
    }
    if target.deposit is not None:
        deposits = {"target": target.deposit, **deposits}
    pictures.draw_deposits(folder / "deposit.png", problem, target, result.answer, deposits)
    checked = result.checks
    # The second run of a design is at its start: no round led there.
    marks = [
        Check(unknowns=run.unknowns, loss=run.loss)
        for place, run in enumerate(checked)
        if not (problem.target.least and place == 1)
    ]
    course.draw(folder / "iterations.png", problem, result.rounds, target.truth, marks)
    stages = []
    for count, run in enumerate(checked, 1):
        deposit = Trajectory.load(folder / run.file).positions[-1]
        unknowns = np.array([run.unknowns[name] for name in problem.names])
        stages.append((f"MPM run {count}: {away(problem, run.loss)} off", unknowns, deposit))
    pictures.draw_stages(folder / "stages.png", problem, target, stages, pictures.COLOURS["MPM"])


def document(solved: Solved, folder: Path) -> list[str]:
    """The report but for its price."""
    result = solved.result
    alone = alone_found(result)
    return [
        f"# {result.problem.name}: {result.verdict}",
        "",
        question(result.problem),
        "",
        sentence(solved),
        "",
        *(without_surrogate(solved.alone) if solved.alone else []),
        *answer(result, alone),
        "",
        *found_picture(result, folder, alone),
        "## Against the target",
        "",
        *against(solved),
        "",
        "![deposits](deposit.png)",
        "",
        *(worth.words(result, solved.certainty) if solved.certainty else []),
        "## How it was found",
        "",
        *way(result),
        "",
        "![iterations](iterations.png)",
        "",
        *elsewhere(result),
        f"The deposits of the MPM runs{over_target(result)}:",
        "",
        "![stages](stages.png)",
        "",
    ]


def sentence(solved: Solved) -> str:
    """The verdict in a sentence or two."""
    result, runs = solved.result, len(solved.answer.runs)
    who = "the MPM's run at the answer"
    if runs > 1:
        who = f"the mean of {runs} MPM runs at the answer, with different jitter seeds,"
    if result.problem.target.least:
        return design(solved, who)
    measured = miss(solved)
    match result.verdict:
        case Verdict.CONFIRMED:
            return f"**The MPM confirms**: {who} is {measured}.{widened(result)}"
        case Verdict.UNCONFIRMED:
            return f"**The MPM does not confirm**: {who} is {measured}.{widened(result)}"
        case Verdict.NOT_IDENTIFIABLE:
            return f"**It fits, but is not identifiable**: {who} is {measured}. {unidentified(result)}"
        case Verdict.UNREACHABLE:
            return (
                "**Nothing within the bounds reaches the target, not even in the MPM.** "
                f"Below is the nearest that was found; there {who} is {measured}."
            )


def without_surrogate(why: str) -> list[str]:
    """What stands for the surrogate where none proposes."""
    return [
        f"No learned surrogate proposes: {why}. What is called the surrogate below is the MPM itself, linearised by "
        "differences around its last run (`inverse/forward/linearised.py`).",
        "",
    ]


def widened(result: Result) -> str:
    """A sentence on a fit that is worse than noise and chance allow; empty where it is not."""
    if result.discrepancy is None or result.discrepancy == 1.0:
        return ""
    return (
        f" The fit is {result.discrepancy:.2g} times worse than the stated noise and chance allow: the half-widths are "
        "that much wider."
    )


def unidentified(result: Result) -> str:
    """Which unknowns an observation that is met does not tell, and what it tells of them together."""
    names = undetermined(result.problem, result.answer, result.certainty or {})
    told_of = worth.told_combinations(result) if len(result.unknowns) > 1 else []
    does = f"it tells {'; '.join(told_of)}" if told_of else "it tells nothing of them"
    many = "Half-widths of" if len(names) > 1 else "The half-width of"
    unknowns = ", ".join(code(names))
    return f"{many} {unknowns} come near the bounds or the values themselves: others fit as well; {does}."


def design(solved: Solved, who: str) -> str:
    """The verdict on a design: is it better than where the search began?"""
    now = 100.0 * float(solved.answer.observation[0])
    before = "" if solved.begun is None else f", {100.0 * float(solved.begun.observation[0]):.2f} % did at the start"
    if solved.result.verdict is Verdict.CONFIRMED:
        return f"**The MPM confirms the design**: in {who} {now:.2f} % of the material pass{before}."
    return (
        f"**The MPM does not confirm the design**: in {who} {now:.2f} % of the material pass{before}; more is chance."
    )


def miss(solved: Solved) -> str:
    """How far from the target the MPM at the answer is, and how far it might be."""
    result = solved.result
    problem, kind = result.problem, result.problem.observation.kind
    components = 1 if kind is Observable.SEVERAL else build(problem.observation, problem.scene).components
    chance = solved.certainty.misfit if solved.certainty else 0.0
    found = distance(kind, solved.answer.observation, result.target.values, components)
    most, asked = (allowed(problem, result.target, each, components) for each in (chance, 0.0))
    scale = 1e3 if kind in (Observable.TOE, Observable.DEPOSIT) else 1.0 if kind is Observable.SEVERAL else 100.0
    unit = "" if kind is Observable.SEVERAL else f"{APART[kind].split(',')[0].split()[0]} "
    why = ", twice what two MPM runs differ by" if most > asked else ""
    said = f"off the target by {scale * found:.3g} {APART[kind]}; at most {scale * most:.3g} {unit}is allowed{why}"
    if kind is Observable.PROFILE and math.isfinite(solved.answer.front_error):
        scatter = solved.certainty.front_misfit if solved.certainty else 0.0
        most_of_front = f"at most {100.0 * of_the_front(problem, result.target, scatter):.3g} % is allowed"
        said += f". Its front is off by {100.0 * solved.answer.front_error:+.2f} %; {most_of_front}"
    return said


def against(solved: Solved) -> list[str]:
    """What surrogate and MPM show beside the target, from the start to the answer."""
    result = solved.result
    problem = result.problem
    first, own = result.rounds[0].evaluations[0], best(list(result.rounds[0].evaluations))
    mean = "" if len(solved.answer.runs) == 1 else f", mean of {len(solved.answer.runs)} runs"
    rows = [observation_row(problem, "target", result.target.values, None)]
    if problem.target.least:
        rows = []
    rows += [
        observation_row(problem, "surrogate, at the start", first.observation, first.loss),
        observation_row(problem, "surrogate, where it ended alone", own.observation, own.loss),
        observation_row(problem, "MPM, there", solved.proposed.observation, solved.proposed.loss),
        observation_row(problem, "surrogate, at the answer", result.surrogate, result.loss_surrogate),
        observation_row(problem, f"**MPM, at the answer**{mean}", result.mpm, result.loss_mpm),
    ]
    return [*table(["", *OBSERVATION], rows), *each_observation(solved)]


def each_observation(solved: Solved) -> list[str]:
    """Of several observations: what each measured and what the MPM shows at the answer."""
    combined = solved.result.target.combined
    if combined is None:
        return []
    measured, shown = (combined.raw(each) for each in (solved.result.target.values, solved.answer.observation))
    rows = []
    for part in combined.parts:
        own, off = part.numbers, (shown - measured)[part.numbers] / combined.scale[part.numbers]
        unit = part.observation.unit or "-"
        noise = np.sqrt(np.maximum(combined.scale[own] ** 2 - combined.chance[own] ** 2, 0.0))
        rows.append(
            [
                part.name,
                f"{brief(measured[own])} {unit}",
                f"{brief(shown[own])} {unit}",
                f"{brief(noise)} {unit}",
                f"{float(np.sqrt(np.mean(off**2))):.2g}",
            ]
        )
    head = ["observation", "measured", "MPM, at the answer", "noise", "away [standard deviations, rms]"]
    return ["", *table(head, rows)]


def brief(values: Values) -> str:
    """Numbers in a cell of a table: all of a few, else the ends."""
    if len(values) <= 3:
        return ", ".join(f"{value:.4g}" for value in values)
    return f"{values[0]:.4g} ... {values[-1]:.4g} ({len(values)})"


def way(result: Result) -> list[str]:
    """Every round of the surrogate and every MPM run."""
    names = told(result.problem)
    checked = result.checks
    members = [run for run in result.mpm_runs if run.purpose is Purpose.ENSEMBLE]
    lines = [
        f"The surrogate proposes, the MPM answers: {len(checked)} of {result.problem.loop.mpm_runs} MPM runs were "
        f"spent on the way, {len(members)} more around the answer for its last step and its certainty. Round 0 is the "
        "surrogate as it is; in later rounds it is corrected by what the MPM showed.",
        "",
        *rounds_table(result),
        "",
        *table(
            ["MPM run", *code(names), "away", "front [m]", "seconds", "file"], [row(result, run) for run in checked]
        ),
    ]
    if members:
        front = [run.front for run in members]
        lines += [
            "",
            f"The ensemble, `mpm/ensemble-*.npz`: fronts from {min(front):.4f} to {max(front):.4f} m, "
            f"{sum(run.seconds for run in members):.0f} s in all; every run is in `result.json`.",
        ]
    return lines


def row(result: Result, run: RunRecord) -> list[str]:
    """A line of the table of MPM runs."""
    return [
        run.purpose,
        *(number(name, run.unknowns[name]) for name in told(result.problem)),
        away(result.problem, run.loss),
        f"{run.front:.4f}",
        f"{run.seconds:.2f}",
        f"`{run.file}`",
    ]


def elsewhere(result: Result) -> list[str]:
    """Other answers that the surrogate found from other starts."""
    if not result.other_minima:
        return []
    rows = [
        [*(number(name, value) for name, value in named(result.problem, each.unknowns).items()), f"{each.loss:.2e}"]
        for each in result.other_minima
    ]
    lines = ["From other starts the surrogate ended elsewhere; the loop did not follow these:", ""]
    return [*lines, *table([*code(result.problem.names), "loss of the surrogate"], rows), ""]


def shown(trajectory: Trajectory, folder: Path, *, vtk: bool, movie: bool) -> list[str]:
    """Write the final MPM run for ParaView and as a movie, and tell where they are. Raises WorkFailed."""
    lines = ["## The final MPM run", ""]
    if vtk:
        write_vtk(trajectory, folder / "vtk", progress=True)
        with_baffles = ", with its baffles" if trajectory.scene.baffles else ""
        lines += [f"- For ParaView{with_baffles}: `vtk/{SERIES}`"]
    if movie:
        # VTK takes a second to import: only who draws pays for it.
        from validation.report.rendering import Colour, write_movie

        frames = frames_of(trajectory, EVERY)
        drawn = write_movie(folder / "movie.mp4", trajectory, Colour.VELOCITY, frames, rate=RATE, progress=True)
        lines += [f"- As a movie: `{drawn.name}`"]
    return lines


def alone_found(result: Result) -> dict[str, float]:
    """What the surrogate had found before any MPM run corrected it."""
    return named(result.problem, best(list(result.rounds[0].evaluations)).unknowns)


def summary(result: Result) -> str:
    """The outcome as the terminal shows it."""
    lines = [f"{result.problem.name}: {result.verdict}"]
    width = max(14, *(len(name) for name in result.unknowns))
    for name, value in result.unknowns.items():
        line = f"  {name:<{width}} {quantity(name, value)}"
        if result.certainty:
            line += f" ± {quantity(name, result.certainty[name])}"
        if result.target.truth:
            line += ", truth {}, error {}".format(*known(result, name))
        lines.append(line)
    off = "-" if result.loss_mpm is None else away(result.problem, result.loss_mpm)
    if "front" in result.error_pct:
        off += f", front {result.front_error_pct:+.2f} %,"
    if said := widened(result):
        lines.append(f"  {'fit':<{width}}{said}")
    if result.verdict is Verdict.NOT_IDENTIFIABLE:
        lines.append(f"  {'told':<{width}} {unidentified(result)}")
    lines.append(f"  {'away':<{width}} {off} in the MPM, {len(result.checks)} MPM runs")
    seconds = result.seconds
    lines.append(f"  {'time':<{width}} {seconds['total']:.0f} s, {seconds['per_iteration']:.1f} s per gradient")
    return "\n".join(lines)
