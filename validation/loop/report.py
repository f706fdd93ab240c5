"""`report.md` of a loop: conclusion, answers, comparison with the target, uncertainty, what would decide, cost."""

import math
from pathlib import Path

import numpy as np

from datasets.exchange.vtk import SERIES, frames_of, write_vtk
from inverse.observations import Values
from inverse.observations.joint import Joint
from inverse.parameters import Kind
from inverse.report import pictures
from inverse.report.markdown import OBSERVATION, answer, found_picture, markdown_table, observation_row, question
from inverse.result import Purpose, Verdict, peak_memory_mib
from validation.loop.pictures import draw_posterior, draw_predictive, draw_waves
from validation.loop.result import Result
from validation.loop.uncertainty_report import mix, uncertainty
from validation.loop.verdict import Answer, unidentified
from validation.report.page import GNS, MPM, Page

NAMED = 4
"""With more parameters than these the conclusion gives the range of their half-widths."""
EVERY = 4
"""A movie has every so many frames: a hundredth of a second each."""
RATE = 25
"""Frames of the movie a second: a quarter of real speed."""
SUGGESTED = 3
"""Measurements that the conclusion names."""


def write(result: Result, folder: Path) -> None:
    """Write `report.md` and its pictures into `folder`."""
    draw(result, folder)
    page(result, folder).write(folder / "report.md")


def page(result: Result, folder: Path) -> Page:
    """The report; `folder` is where its pictures are."""
    problem = result.problem
    further = result.further
    report = Page(
        f"{problem.name}: {result.verdict}",
        command=f"python -m validation.loop {problem.name} --out {folder}",
        conclusion=[sentence for sentence in conclusion(result) if sentence],
        packages=MPM | GNS,
    )
    report.text(question(problem))
    for part in (*answer(result), *found_picture(result, folder)):
        report.text(part)
    if len(result.outcome.answers) > 1:
        report.section("Every separate answer")
        report.text(every_answer(result))
    report.section("Comparison with the target")
    report.text(comparison(result))
    report.text(each_observation(result))
    report.picture("deposit.png", "deposits")
    report.picture("predictive.png", "deposits that the posterior predicts, and their difference from the target")
    report.section("Uncertainty")
    for part in uncertainty(result):
        report.text(part)
    report.picture("posterior.png", "prior and posterior")
    if further:
        report.section("What a further measurement would decide")
        report.text(
            "Expected information of each about the parameters, beyond what was observed; 0.69 halves one interval."
        )
        report.text(markdown_table(["measurement", "information [nat]"], [[e.name, f"{e.gain:.2f}"] for e in further]))
    report.section("How it was found")
    for part in search(result):
        report.text(part)
    report.picture("waves.png", "mean and standard deviation over the runs")
    report.section("Cost")
    runs = [sum(each.purpose is purpose for each in result.mpm_runs) for purpose in Purpose]
    report.text(
        markdown_table(
            [
                "MPM runs in waves",
                "at answers",
                "at the start",
                "on larger cells",
                "seconds in the MPM",
                "in all",
                "peak memory",
            ],
            [
                [
                    *map(str, runs),
                    f"{result.mpm_seconds:.1f} s",
                    f"{result.total_seconds:.1f} s",
                    f"{peak_memory_mib():.0f} MiB",
                ]
            ],
        )
    )
    return report


def conclusion(result: Result) -> list[str]:
    """Five sentences: verdict, parameters, what is not identifiable and would decide, truth and fit, cost."""
    seconds = f"{result.mpm_seconds:.1f} s in the MPM, {result.total_seconds:.1f} s in all"
    price = f"Cost: {len(result.mpm_runs)} MPM runs, {seconds}."
    return [verdict(result), parameters(result), equifinality(result), quality(result), price]


def verdict(result: Result) -> str:
    """The verdict, with the distance from the target and the one allowed."""
    first = result.outcome.answers[0]
    runs = len(first.checks)
    which = "the MPM run nearest to the answer" if runs == 1 else f"the mean of {runs} MPM runs at the answer"
    if result.problem.target.minimise:
        now, before = (
            100.0 * float(first.observation[0]),
            100.0 * float(np.mean([e.observation[0] for e in result.begun])),
        )
        better = "The MPM confirms the design" if result.verdict is Verdict.CONFIRMED else "The MPM does not confirm it"
        return f"**{better}**: {now:.2f} % of the material pass in {which}, {before:.2f} % at the start."
    count = len(result.outcome.answers)
    words = {
        Verdict.CONFIRMED: "The MPM confirms",
        Verdict.AMBIGUOUS: f"Ambiguous: {count} separate answers"
        if count > 1
        else "Ambiguous: the MPM meets the target with a whole range of parameters",
        Verdict.UNCONFIRMED: "The MPM does not confirm",
        Verdict.UNREACHABLE: "No parameters within the bounds give the target, not even in the MPM",
    }[result.verdict]
    return f"**{words}**: {which} is off the target by {distance(result, first)}."


def distance(result: Result, found: Answer) -> str:
    """Distance of the MPM at an answer from the target, and how much is allowed."""
    task, observation = result.outcome.state.task, result.target.observation
    loop, cell = result.problem.loop, result.problem.scene.domain.cell
    scatter = found.scatter(task)
    text = observation.distance_text(observation.distance(found.observation, result.target.values))
    allowed = observation.tolerance(loop, cell, result.target, scatter)
    text += f"; {observation.distance_text(allowed)} is allowed"
    if allowed > observation.tolerance(loop, cell, result.target, 0.0):
        text += ", by the difference of two MPM runs"
    most = observation.front_tolerance(loop, result.target, found.front_scatter)
    if not observation.scalar and math.isfinite(most) and math.isfinite(found.front_error):
        text += f"; its front is off by {100.0 * found.front_error:+.2f} %, {100.0 * most:.2g} % is allowed"
    return text


def parameters(result: Result) -> str:
    """The parameters with their half-widths, of every answer."""
    kinds = {each.name: each.kind for each in result.problem.parameters}
    if len(kinds) > NAMED:
        ranges = {each.name: each.range for each in result.problem.parameters}
        widths = result.certainty or {}
        low, high = (pick(widths, key=lambda name: widths[name] / ranges[name]) for pick in (min, max))
        return (
            f"{len(kinds)} parameters, with 95 % half-widths from {kinds[low].text(widths[low])} (`{low}`) to "
            f"{kinds[high].text(widths[high])} (`{high}`)."
        )
    texts = []
    for each in result.outcome.answers:
        found = [
            f"`{name}` = {kind.text(value)} ± {kind.text(width)}"
            for (name, kind), value, width in zip(
                kinds.items(), each.parameters.tolist(), each.half_widths.tolist(), strict=True
            )
        ]
        share = f" ({100.0 * each.weight:.0f} % of the posterior)" if len(result.outcome.answers) > 1 else ""
        texts.append(", ".join(found) + share)
    meaning = "changes that the MPM distinguishes" if result.problem.target.minimise else "95 %"
    return f"{'; or '.join(texts)} ({meaning})."


def equifinality(result: Result) -> str:
    """What the observation does not constrain, and which measurement would."""
    if result.problem.target.minimise:
        return ""
    first, parts = result.outcome.answers[0], []
    if names := unidentified(result.problem, first.parameters, first.half_widths):
        known = [f"{mix(each)} to ± {100.0 * each.half_width:.2g} % of the range" for each in result.combinations]
        known = [text for text, each in zip(known, result.combinations, strict=True) if each.identifiable]
        parts.append(
            f"Not identifiable: {', '.join(f'`{name}`' for name in names)}; "
            f"constrained: {'; '.join(known) or 'nothing'}"
        )
    if result.further:
        best = ", ".join(each.name for each in result.further[:SUGGESTED])
        parts.append(f"most would be decided by {best}")
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}." if text else ""


def quality(result: Result) -> str:
    """Errors against the truth, where it is known, and whether the model fits."""
    parts, truth = [], result.target.truth
    if truth:
        found = result.problem.parameters
        worst = max(found, key=lambda each: abs(result.unknowns[each.name] - truth[each.name]) / each.range)
        error = worst.kind.text(result.unknowns[worst.name] - truth[worst.name])
        which = "" if len(found) == 1 else f" (`{worst.name}`)"
        parts.append(
            f"error against the truth: {error}{which}, {len(result.inside)} of {len(truth)} within the half-width"
        )
    fit = result.outcome.discrepancy
    if fit is not None and fit.factor > 1.0:
        parts.append(
            f"the fit is {fit.factor:.2g} times worse than the stated noise and scatter explain, the half-widths are "
            "wider for it"
        )
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}." if text else ""


def every_answer(result: Result) -> str:
    """A line for each."""
    head = [*(f"`{name}`" for name in result.problem.names), "share of the posterior", "the MPM there is off by"]
    rows = [
        [
            *(
                f"{each.kind.text(value)} ± {each.kind.text(width)}"
                for each, value, width in zip(
                    result.problem.parameters, found.parameters.tolist(), found.half_widths.tolist(), strict=True
                )
            ),
            f"{100.0 * found.weight:.0f} %",
            distance(result, found),
        ]
        for found in result.outcome.answers
    ]
    return markdown_table(head, rows)


def comparison(result: Result) -> str:
    """The MPM at the answer beside the target."""
    first = result.outcome.answers[0]
    rows = [] if result.problem.target.minimise else [observation_row(result, "target", result.target.values, None)]
    rows.append(
        observation_row(result, f"**MPM, at the answer**, {len(first.checks)} runs", first.observation, result.misfit)
    )
    return markdown_table(["", *OBSERVATION], rows)


def each_observation(result: Result) -> str:
    """Of multiple observations: each as measured and in the MPM at the answer."""
    joint = result.target.observation
    if not isinstance(joint, Joint):
        return ""
    measured, shown = (joint.raw(each) for each in (result.target.values, result.outcome.answers[0].observation))
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
    """Every wave, and every MPM run at an answer."""
    state, kinds = result.outcome.state, {each.name: each.kind for each in result.problem.parameters}
    names = result.problem.names if len(result.problem.names) <= NAMED else []
    rows = []
    for wave in state.waves:
        mean, deviation = state.task.values(wave.mean), wave.deviation * state.task.bounds.range
        rows.append(
            [
                str(wave.runs),
                *(
                    f"{_number(kinds[n], m)} ± {_number(kinds[n], d)}"
                    for n, m, d in zip(names, mean, deviation, strict=False)
                ),
                f"{wave.emulator_share:.2g}",
                "yes" if wave.with_surrogate else "no",
            ]
        )
    head = [
        "MPM runs",
        *(f"`{name}`, mean ± standard deviation" for name in names),
        "emulator's share",
        "surrogate in the trend",
    ]
    checks = [each for each in result.mpm_runs if each.purpose is not Purpose.WAVE]
    cells = [
        [
            run.purpose.value,
            *(kinds[name].number(run.unknowns[name]) for name in names),
            result.target.observation.misfit_text(run.loss, result.problem.scene.domain.cell),
            f"{run.front:.4f}",
            f"{run.seconds:.2f}",
            f"`{run.file}`",
        ]
        for run in checks
    ]
    columns = ["MPM run", *(f"`{name}`" for name in names), "distance to the target", "front [m]", "seconds", "file"]
    return [
        f"Surrogate: {result.surrogate}.",
        "The emulator's share is that in the variance of the residuals, on average over the posterior.",
        markdown_table(head, rows),
        markdown_table(columns, cells),
        "All runs are in `result.json`, the samples in `posterior.npz`.",
    ]


def _number(kind: Kind, value: float) -> str:
    return kind.number(float(value))


def draw(result: Result, folder: Path) -> None:
    """The pictures."""
    deposits = {"MPM": result.deposit}
    if result.target.deposit is not None:
        deposits = {"target": result.target.deposit, **deposits}
    pictures.draw_deposits(folder / "deposit.png", result.problem, result.target, result.answer, deposits)
    draw_predictive(folder / "predictive.png", result)
    draw_posterior(folder / "posterior.png", result)
    draw_waves(folder / "waves.png", result)


def append_final_run(result: Result, folder: Path, *, vtk: bool, movie: bool) -> None:
    """Write the final MPM run for ParaView or as a movie, and name them in `report.md`. Raises WorkFailed."""
    trajectory, report = result.outcome.answers[0].checks[0].trajectory, page(result, folder)
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
