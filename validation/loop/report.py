"""`report.md` of a loop: conclusion, answer, comparison with the target, uncertainty, how it was found, cost."""

from pathlib import Path

import numpy as np

from datasets.exchange.vtk import SERIES, frames_of, write_vtk
from inverse.observations import Values
from inverse.observations.joint import Joint
from inverse.optimise import best
from inverse.report import course, pictures
from inverse.report.course import Check as Mark
from inverse.report.markdown import (
    OBSERVATION,
    answer,
    cost,
    found_picture,
    markdown_table,
    observation_row,
    over_target,
    question,
    rounds_table,
    tabulated,
)
from inverse.result import Purpose, RunRecord, Verdict
from validation.loop.result import Result
from validation.loop.uncertainty_report import constrained, uncertainty_section
from validation.loop.verdict import unidentified
from validation.report.machine import GNS, MPM
from validation.report.page import Page

NAMED = 4
"""With more parameters than these the conclusion gives the range of their half-widths."""
EVERY = 4
"""A movie has every so many frames: a hundredth of a second each."""
RATE = 25
"""Frames of the movie a second: a quarter of real speed."""


def write(result: Result, folder: Path) -> None:
    """Write `report.md` and its pictures into `folder`."""
    draw(result, folder)
    page(result, folder).write(folder / "report.md")


def page(result: Result, folder: Path) -> Page:
    """The report; `folder` is where its pictures are."""
    problem = result.problem
    command = f"python -m validation.loop {problem.name} --out {folder}"
    report = Page(
        f"{problem.name}: {result.verdict}",
        command=command,
        conclusion=[sentence for sentence in conclusion(result) if sentence],
        packages=MPM | GNS,
    )
    proposed = problem.named(best(result.rounds[0].evaluations).parameters)
    report.text(question(problem))
    if result.without_surrogate:
        report.text(
            f"No learned surrogate proposes: {result.without_surrogate}. What is called the surrogate below is the MPM "
            "itself, linearised by differences around its last run (`inverse/forward/linearised.py`)."
        )
    for part in (*answer(result, proposed), *found_picture(result, folder, proposed)):
        report.text(part)
    report.section("Comparison with the target")
    report.text(comparison(result))
    report.text(each_observation(result))
    report.picture("deposit.png", "deposits")
    if result.uncertainty is not None:
        report.section("Uncertainty")
        for part in uncertainty_section(result, result.uncertainty):
            report.text(part)
    report.section("How it was found")
    for part in search(result):
        report.text(part)
    report.picture("iterations.png", "iterations")
    report.text(other_minima(result))
    report.text(f"The deposits of the checks{over_target(result)}:")
    report.picture("stages.png", "stages")
    for part in cost(result):
        report.text(part)
    return report


def conclusion(result: Result) -> list[str]:
    """Five sentences: verdict, parameters, truth, what the observation constrains, cost."""
    ensembles = len(result.mpm_runs) - len(result.checks)
    price = (
        f"Cost: {len(result.evaluations)} evaluations of the surrogate, {len(result.checks)} of "
        f"{result.problem.loop.mpm_runs} checks by the MPM, {ensembles} MPM runs in ensembles, "
        f"{result.total_seconds:.0f} s in all."
    )
    return [verdict(result), parameters(result), errors(result), fit(result), price]


def verdict(result: Result) -> str:
    """The verdict, with the distance from the target and the one allowed."""
    runs = len(result.found.checks)
    which = "the MPM run at the answer" if runs == 1 else f"the mean of {runs} MPM runs at the answer"
    if result.begun is not None:
        now, before = (100.0 * float(each.observation[0]) for each in (result.found, result.begun))
        better = "The MPM confirms the design" if result.verdict is Verdict.CONFIRMED else "The MPM does not confirm it"
        return f"**{better}**: {now:.2f} % of the material pass in {which}, {before:.2f} % at the start."
    words = {
        Verdict.CONFIRMED: "The MPM confirms",
        Verdict.UNCONFIRMED: "The MPM does not confirm",
        Verdict.NOT_IDENTIFIABLE: "The MPM fits, but the parameters are not identifiable",
        Verdict.UNREACHABLE: "No parameters within the bounds give the target, not even in the MPM",
    }[result.verdict]
    return f"**{words}**: {which} is off the target by {distance(result)}."


def distance(result: Result) -> str:
    """Distance of the MPM at the answer from the target, and how much is allowed."""
    problem, target, observation = result.problem, result.target, result.target.observation
    loop, cell = problem.loop, problem.scene.domain.cell
    scatter, front_scatter = 0.0, 0.0
    if result.uncertainty is not None:
        scatter, front_scatter = result.uncertainty.misfit_scatter, result.uncertainty.front_scatter
    found = observation.distance(result.found.observation, target.values)
    allowed = observation.tolerance(loop, cell, target, scatter)
    text = f"{observation.distance_text(found)}; {observation.distance_text(allowed)} is allowed"
    if allowed > observation.tolerance(loop, cell, target, 0.0):
        text += ", twice the difference of two MPM runs"
    most = observation.front_tolerance(loop, target, front_scatter)
    if not observation.scalar and np.isfinite(most) and np.isfinite(result.found.front_error):
        text += f"; its front is off by {100.0 * result.found.front_error:+.2f} %, {100.0 * most:.2g} % is allowed"
    return text


def parameters(result: Result) -> str:
    """The parameters with their half-widths."""
    widths, kinds = result.certainty, {each.name: each.kind for each in result.problem.parameters}
    if len(kinds) > NAMED:
        if not widths:
            return f"{len(kinds)} parameters, in the table below."
        ranges = {each.name: each.upper - each.lower for each in result.problem.parameters}
        low, high = (pick(widths, key=lambda name: widths[name] / ranges[name]) for pick in (min, max))
        return (
            f"{len(kinds)} parameters, with 95 % half-widths from {kinds[low].text(widths[low])} (`{low}`) to "
            f"{kinds[high].text(widths[high])} (`{high}`)."
        )
    found = []
    for name, kind in kinds.items():
        width = f" ± {kind.text(widths[name])}" if widths else ""
        found.append(f"`{name}` = {kind.text(result.unknowns[name])}{width}")
    meaning = "changes that the MPM distinguishes" if result.problem.target.minimise else "95 %"
    return f"{'; '.join(found)}{f' ({meaning})' if widths else ''}."


def errors(result: Result) -> str:
    """Errors against the truth, where it is known."""
    truth = result.target.truth
    if not truth:
        return ""
    inside = f", {len(result.inside)} of {len(truth)} within the half-width" if result.certainty else ""
    parameters = result.problem.parameters
    worst = max(
        parameters, key=lambda each: abs(result.unknowns[each.name] - truth[each.name]) / (each.upper - each.lower)
    )
    error = worst.kind.text(result.unknowns[worst.name] - truth[worst.name])
    which = "" if len(parameters) == 1 else f" (`{worst.name}`)"
    return f"Error against the truth: {error}{which}{inside}."


def fit(result: Result) -> str:
    """What the observation does not constrain, and whether the model fits it."""
    parts = []
    if result.certainty and not result.problem.target.minimise:
        widths = np.array(list(result.certainty.values()))
        if names := unidentified(result.problem, result.answer, widths):
            known = "; ".join(constrained(result))
            parts.append(
                f"Not identifiable: {', '.join(f'`{name}`' for name in names)}; constrained: {known or 'nothing'}"
            )
        elif result.identifiability and len(widths) > 1:
            last = result.identifiability.combinations[-1]
            parts.append(
                f"Every combination of the parameters is known to ± {last.half_width:.2g} of its range or better"
            )
    if result.discrepancy is not None and result.discrepancy > 1.0:
        parts.append(
            f"the fit is {result.discrepancy:.2g} times worse than the stated noise and scatter explain, "
            "the half-widths are that much wider"
        )
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}." if text else ""


def comparison(result: Result) -> str:
    """Surrogate and MPM beside the target, from the start to the answer."""
    first, own = result.rounds[0].evaluations[0], best(result.rounds[0].evaluations)
    proposed = result.history.checks[0]
    mean = "" if len(result.found.checks) == 1 else f", mean of {len(result.found.checks)} runs"
    rows = [] if result.problem.target.minimise else [observation_row(result, "target", result.target.values, None)]
    rows += [
        observation_row(result, "surrogate, at the start", first.observation, first.loss),
        observation_row(result, "surrogate, at its own minimum", own.observation, own.loss),
        observation_row(result, "MPM, there", proposed.observation, proposed.misfit),
        observation_row(result, "surrogate, at the answer", result.surrogate, result.loss_surrogate),
        observation_row(result, f"**MPM, at the answer**{mean}", result.mpm, result.loss_mpm),
    ]
    return markdown_table(["", *OBSERVATION], rows)


def each_observation(result: Result) -> str:
    """Of multiple observations: each as measured and in the MPM at the answer."""
    joint = result.target.observation
    if not isinstance(joint, Joint):
        return ""
    measured, shown = (joint.raw(each) for each in (result.target.values, result.found.observation))
    rows = []
    for part in joint.parts:
        own, unit = part.numbers, part.observation.unit or "-"
        residual = (shown - measured)[own] / joint.scale[own]
        noise = np.sqrt(np.maximum(joint.scale[own] ** 2 - joint.prior[own] ** 2, 0.0))
        rms = f"{float(np.sqrt(np.mean(residual**2))):.2g}"
        rows.append([part.name, *(f"{brief(each)} {unit}" for each in (measured[own], shown[own], noise)), rms])
    head = ["observation", "measured", "MPM, at the answer", "noise", "residual [standard deviations, rms]"]
    return markdown_table(head, rows)


def brief(values: Values) -> str:
    """Numbers in a cell of a table: all of a few, else the ends."""
    if len(values) <= 3:
        return ", ".join(f"{value:.4g}" for value in values)
    return f"{values[0]:.4g} ... {values[-1]:.4g} ({len(values)})"


def search(result: Result) -> list[str]:
    """Every round on the surrogate and every MPM run."""
    names, checks = tabulated(result.problem), result.checks
    members = [run for run in result.mpm_runs if run.purpose is Purpose.ENSEMBLE]
    head = ["MPM run", *(f"`{name}`" for name in names), "distance to the target", "front [m]", "seconds", "file"]
    parts = [
        "Round 0 is on the surrogate as it is; in later rounds it is corrected by the checks.",
        rounds_table(result),
        markdown_table(head, [run_row(result, names, run) for run in checks]),
    ]
    if members:
        fronts = [run.front for run in members]
        parts.append(
            f"{len(members)} MPM runs in ensembles, `mpm/ensemble-*.npz`: fronts from {min(fronts):.4f} to "
            f"{max(fronts):.4f} m, {sum(run.seconds for run in members):.0f} s in all; each is in `result.json`."
        )
    return parts


def run_row(result: Result, names: list[str], run: RunRecord) -> list[str]:
    """A line of the table of MPM runs."""
    kinds = {each.name: each.kind for each in result.problem.parameters}
    return [
        run.purpose,
        *(kinds[name].number(run.unknowns[name]) for name in names),
        result.target.observation.misfit_text(run.loss, result.problem.scene.domain.cell),
        f"{run.front:.4f}",
        f"{run.seconds:.2f}",
        f"`{run.file}`",
    ]


def other_minima(result: Result) -> str:
    """Minima that the surrogate has from other starts."""
    if not result.other_minima:
        return ""
    rows = [
        [
            *(p.kind.number(value) for p, value in zip(result.problem.parameters, each.parameters, strict=True)),
            f"{each.loss:.2e}",
        ]
        for each in result.other_minima
    ]
    head = [*(f"`{name}`" for name in result.problem.names), "loss of the surrogate"]
    table = markdown_table(head, rows)
    return f"Other minima of the surrogate, from other starts, which the MPM did not check:\n\n{table}"


def draw(result: Result, folder: Path) -> None:
    """The pictures."""
    problem, target = result.problem, result.target
    deposits = {"surrogate": result.surrogate_deposit, "MPM": result.deposit}
    if target.deposit is not None:
        deposits = {"target": target.deposit, **deposits}
    pictures.draw_deposits(folder / "deposit.png", problem, target, result.answer, deposits)
    # The second check of a design is at its start, where no round ends.
    marks = [
        Mark(unknowns=run.unknowns, loss=run.loss)
        for index, run in enumerate(result.checks)
        if not (problem.target.minimise and index == 1)
    ]
    course.draw(folder / "iterations.png", problem, result.rounds, target.truth, marks)
    cell = problem.scene.domain.cell
    stages = [
        (
            f"check {number}: {target.observation.misfit_text(check.misfit, cell)}",
            check.parameters,
            check.trajectory.positions[-1],
        )
        for number, check in enumerate(result.history.checks, 1)
    ]
    pictures.draw_stages(folder / "stages.png", problem, target, stages, pictures.COLOURS["MPM"])


def append_final_run(result: Result, folder: Path, *, vtk: bool, movie: bool) -> None:
    """Write the final MPM run for ParaView or as a movie, and name them in `report.md`. Raises WorkFailed."""
    trajectory, report = result.found.checks[0].trajectory, page(result, folder)
    report.section("The final MPM run")
    if vtk:
        write_vtk(trajectory, folder / "vtk", progress=True)
        with_baffles = ", with its baffles" if trajectory.scene.baffles else ""
        report.text(f"- For ParaView{with_baffles}: `vtk/{SERIES}`")
    if movie:
        # VTK takes a second to import.
        from validation.report.rendering import Colour, write_movie

        frames = frames_of(trajectory, EVERY)
        drawn = write_movie(folder / "movie.mp4", trajectory, Colour.VELOCITY, frames, rate=RATE, progress=True)
        report.text(f"- As a movie: `{drawn.name}`")
    report.write(folder / "report.md")


def summary(result: Result) -> str:
    """The outcome for the terminal: the conclusion of the report."""
    lines = [sentence.replace("**", "").replace("`", "") for sentence in conclusion(result) if sentence]
    return "\n".join([f"{result.problem.name}: {result.verdict}", *(f"  {line}" for line in lines)])
