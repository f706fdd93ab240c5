"""What `validation.accuracy` writes: tables, pictures and the file that `--tolerance` reads."""

import dataclasses
import json
import math
import textwrap
from collections.abc import Sequence
from pathlib import Path

from datasets.files import write_text
from inverse.report import table
from mpm.resolution import Measured, Resolution, resolved
from validation import accuracy_pictures, studies
from validation.bodies import Spread
from validation.scores import Outcome
from validation.studies import Findings, worth

TOLERANCES = (0.1, 0.07, 0.05, 0.04, 0.03, 0.02, 0.015)
"""What each of them picks is shown."""


def write(
    out: Path, findings: Sequence[Findings], spreads: Sequence[Spread], measured: Sequence[Measured], seeds: int
) -> None:
    """Write accuracy.md and its pictures into `out`."""
    accuracy_pictures.draw_front(out / "accuracy.png", findings)
    accuracy_pictures.draw_scenes(out / "accuracy-scenes.png", findings)
    lines = [*introduction(seeds), "![error against seconds](accuracy.png)", ""]
    for each in findings:
        lines += [f"## {each.study.title}", "", *reference(each), *cheapest(each, measured), *precisions(each)]
    lines += [
        "## Scene by scene",
        "",
        "The signed error of the front, mean and standard deviation over the jitter seeds.",
        "",
        "![front over cells, scene by scene](accuracy-scenes.png)",
        "",
    ]
    if spreads:
        lines += shapes(spreads)
    for each in findings:
        lines += [f"## All that was tried in {each.study.dimension}D", "", *everything(each), ""]
    write_text(out / "accuracy.md", "\n".join(lines))


def introduction(seeds: int) -> list[str]:
    """What is measured, and how."""
    return [
        "# Speed against error",
        "",
        *paragraph(f"""
            `python -m validation.accuracy mpm --seeds {seeds}`. An error is that of one run against the same scene on a
            quarter of its cell: the reference, in double precision, with 2 points per axis, at the scene's own fraction
            of the stable step, 0.9. Two things are compared at the end of the run: the **front**, the x that 99.5 % of
            the points are behind, and the **profile**, by the transport distance between the deposits (the rms distance
            along x of twenty equal shares of their volume); root mean squares over {seeds} jitter seeds. The larger of
            the two, over the **reach** (from the rear of the mass at the start to the front of the reference's deposit;
            for a column its runout distance), is the error of a scene. The **error** of a resolution is the root mean
            square over the scenes, what to expect of a scene like them; the worst of them is given too. **Scatter** is
            the standard deviation of the front over the seeds, over the reach; errors contain it. **Seconds** are those
            of a run alone on one thread, compilation apart, mean over the scenes. A step of 0.9 is at most 0.9 of
            cell / wave speed: a frame takes a whole number of steps.
        """),
        *paragraph("""
            `--tolerance` of `python -m mpm.run` picks from these measurements (`mpm/resolution.toml`).
        """),
        *paragraph("""
            What the tables say: a long step and two points per axis are the best use of time. A shorter step costs
            twice, in steps and in error: APIC dissipates per step, so on a coarse grid the flow stops short. Three
            points per axis buy little. One does not do for columns: the flow stretches, cells between points run empty,
            the mass tears, and a finer grid makes it worse; that it does well in the one scene in 3D is not enough, so
            `--tolerance` never picks it. Double precision changes nothing that could be seen.
        """),
    ]


def paragraph(text: str) -> list[str]:
    """A paragraph in lines of Markdown, and the empty line after it."""
    return [*textwrap.wrap(" ".join(text.split()), 118), ""]


def reference(findings: Findings) -> list[str]:
    """How good the reference is."""
    study = findings.study
    half = findings.at_own(study.reference / 2.0, "f32")
    rows = []
    for name, truth in findings.truths.items():
        other = findings.other_step.get(name)
        rows.append(
            [
                name,
                f"{truth.front:.4f} m",
                f"{truth.runout:.4f} m",
                "-" if math.isnan(truth.scatter) else percent(truth.scatter / truth.reach),
                signed(-half.scores[name].bias),
                signed((other.front - truth.front) / truth.reach) if other else with_step(findings, name),
            ]
        )
    head = ["scene", "front", "runout d", "scatter of the front", "from half as many cells", "at step 0.4"]
    return [
        f"The reference has {study.reference:g} cells across the smallest side of the mass. How far it can be trusted:",
        "",
        *table(head, rows),
        "",
        *paragraph("""
            The last two columns say how its front moves, over the reach: from half as many cells to its own, and with a
            step of 0.4 of the stable one in place of 0.9, since APIC dissipates per step. Where an error falls in
            proportion to the cell, the reference itself is as far from the limit as it moved from half the cells. A
            tolerance below these figures speaks of grid and jitter at a given fraction of the stable step, not of the
            distance to the exact solution.
        """),
        *paragraph(study.remark),
    ]


def with_step(findings: Findings, name: str) -> str:
    """How the front moves with the step on the finest grid on which both were tried."""
    own, other = (studies.own(1.0, "f32", step) for step in (studies.OWN_STEP, studies.OTHER_STEP))
    tried = [{o.resolution.cells for o in findings.outcomes if alike(o.resolution, what)} for what in (own, other)]
    cells = max(tried[0] & tried[1])
    moved = (
        findings.at_own(cells, "f32", studies.OTHER_STEP).scores[name].bias
        - findings.at_own(cells, "f32").scores[name].bias
    )
    return f"{signed(moved)} (on {cells:g} cells)"


def alike(a: Resolution, b: Resolution) -> bool:
    """Whether two resolutions differ in nothing but the cells."""
    return dataclasses.replace(a, cells=b.cells) == b


def cheapest(findings: Findings, measured: Sequence[Measured]) -> list[str]:
    """The Pareto front, and what each tolerance picks."""
    lines = [
        "What is worth its price, that is nothing cheaper was as good:",
        "",
        *outcome_table(worth(findings.outcomes)),
        "",
    ]
    scene = next(iter(findings.scenes.values()))
    rows = []
    for tolerance in TOLERANCES:
        known = [each for each in measured if each.dimension == findings.study.dimension]
        if min((each.error for each in known), default=math.inf) > tolerance:
            continue
        found = resolved(scene, tolerance, known)
        rows.append(
            [
                f"{100 * tolerance:g} %",
                f"{found.cells:g}",
                f"{found.scene.domain.cell:.4g} m",
                f"{found.scene.particles_per_axis}",
                f"{found.scene.step_fraction:g}",
                found.precision,
                percent(found.error),
                percent(found.worst),
                f"{found.cost:.2g}",
            ]
        )
    head = ["tolerance", "cells", f"cell in {next(iter(findings.scenes))}", "points per axis", "step", "precision"]
    return [
        *lines,
        *paragraph("""
            What `--tolerance` picks: the cheapest whose error, and that of every finer grid measured alike, is within
            it, so that an error is not taken for small where two cancel. Cost: point-steps over those of the scene as
            it is.
        """),
        *table([*head, "error", "worst scene", "cost"], rows),
        "",
    ]


def outcome_table(outcomes: Sequence[Outcome]) -> list[str]:
    """One line a resolution."""
    rows = []
    for each in outcomes:
        what, scores = each.resolution, list(each.scores.values())
        rows.append(
            [
                f"{what.cells:g}",
                f"{what.particles_per_axis}",
                f"{what.step_fraction:g}",
                what.precision,
                f"{each.seconds:.3g}",
                f"{each.particle_steps / 1e6:.3g}",
                percent(each.error),
                percent(each.worst),
                percent(max(score.profile_error for score in scores)),
                percent(each.scatter),
                " / ".join(signed(score.bias) for score in scores),
            ]
        )
    names = " / ".join(outcomes[0].scores)
    head = ["cells", "points per axis", "step", "precision", "seconds", "million point-steps", "error", "worst scene"]
    return table([*head, "worst profile", "worst scatter", f"signed error of the front: {names}"], rows)


def everything(findings: Findings) -> list[str]:
    """The table of all resolutions, by points per axis, step, cells."""

    def order(each: Outcome) -> tuple[str, int, float, float]:
        what = each.resolution
        return what.precision, what.particles_per_axis, -what.step_fraction, what.cells

    return outcome_table(sorted(findings.outcomes, key=order))


def precisions(findings: Findings) -> list[str]:
    """What double precision changes."""
    off, dearer = [], []
    for each in findings.outcomes:
        if each.resolution.precision == "f64":
            other = findings.at_own(each.resolution.cells, "f32")
            off += [
                abs(a - b) / findings.truths[name].reach
                for name in each.scores
                for a, b in zip(each.scores[name].fronts, other.scores[name].fronts, strict=True)
            ]
            dearer.append(each.seconds / other.seconds)
    return [
        f"Double precision moves the front of a run by {percent(max(off))} of the reach at most and costs"
        f" {min(dearer):.2f} to {max(dearer):.2f} times the seconds.",
        "",
    ]


def shapes(spreads: Sequence[Spread]) -> list[str]:
    """What the cells are to be counted across."""
    first = spreads[0]
    rows = [
        [trial.name, f"{trial.cells:g}", percent(trial.error), signed(trial.bias), percent(trial.scatter)]
        for trial in first.trials
    ]
    return [
        "## What the cells are counted across",
        "",
        *paragraph("""
            A resolution carries over to another scene if it is counted across the right length. Columns of other
            shapes, each with 5 and with 10 cells across its smallest side, against a quarter of that cell (f32,
            2 points per axis, step 0.9, 2 seeds):
        """),
        *table(["column, length x height", "cells", "error", "front, signed", "scatter"], rows),
        "",
        *paragraph("""
            The errors of all of them as one power of the cells across a length, and the factor by which they scatter
            about it (standard deviation):
        """),
        *table(
            ["cells across the", "error falls with the cells to the power", "scatters by a factor of"],
            [[spread.length, f"{spread.exponent:.2f}", f"{spread.factor:.2f}"] for spread in spreads],
        ),
        "",
        *paragraph("""
            No length brings the shapes together: errors change their sign on the way, and none predicts one better
            than within a factor of about two. Cells across the smallest side are safe for flat bodies, which do better
            than the others, and it is the length that a thin body must have resolved, so `--tolerance` counts them. A
            body of another shape than the paper's columns may miss a tolerance by that factor.
        """),
    ]


def toml(measured: Sequence[Measured]) -> str:
    """`resolution.toml`."""
    blocks = [
        "# What resolutions are worth and cost, for --tolerance. By `python -m validation.accuracy mpm --ship`.\n"
        "# error, worst: rms over the scenes and of the worst one, over the reach; seconds: of a run alone\n"
        "# on one thread, mean over the scenes.\n"
    ]
    for each in measured:
        what = each.resolution
        blocks.append(
            f"[[measured]]\ndimension = {each.dimension}\n"
            f"error = {each.error}\nworst = {each.worst}\nseconds = {each.seconds}\n"
            f"resolution = {{ cells = {what.cells}, particles_per_axis = {what.particles_per_axis}, "
            f"step_fraction = {what.step_fraction}, precision = {json.dumps(what.precision)} }}\n"
        )
    return "\n".join(blocks)


def percent(fraction: float) -> str:
    """0.0213 as 2.1 %."""
    return f"{100 * fraction:.2g} %"


def signed(fraction: float) -> str:
    """The same with its sign."""
    return f"{100 * fraction:+.1f} %"
