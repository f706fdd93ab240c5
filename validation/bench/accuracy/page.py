"""What `validation.bench.accuracy.bench` writes: tables, pictures and the file that `--tolerance` reads."""

import json
import math
import textwrap
from collections.abc import Sequence
from pathlib import Path

from datasets.errors import InputError
from datasets.files import write_text
from inverse.report.markdown import table
from mpm.resolution import COVERAGE, Measured, Resolved, resolved
from validation.bench.accuracy import extent as bodies
from validation.bench.accuracy import pictures as accuracy_pictures
from validation.bench.accuracy.extent import Spread
from validation.bench.accuracy.flows import OWN_STEP
from validation.bench.accuracy.studies import OTHER_PARTICLES, OTHER_STEP, OWN_PARTICLES, Findings, own
from validation.report.machine import machine

TOLERANCES = (0.2, 0.15, 0.1, 0.07, 0.05, 0.04, 0.03, 0.02)
"""What each of them picks is shown."""


def write(out: Path, findings: Sequence[Findings], measured: Sequence[Measured]) -> None:
    """Write accuracy.md and its pictures into `out`."""
    accuracy_pictures.draw_cost(out / "accuracy.png", findings)
    accuracy_pictures.draw_scenes(out / "accuracy-scenes.png", findings)
    spreads = {each.study.dimension: bodies.compare(each) for each in findings}
    lines = ["# Error against cost", "", *conclusion(findings, measured, spreads), *method(findings)]
    lines += ["![error against particle-steps](accuracy.png)", ""]
    for each in findings:
        lines += [f"## {each.study.dimension}D", "", *picks(each, measured), *everything(each), *reference(each)]
        lines += [*shapes(spreads[each.study.dimension])]
    lines += [
        "## Scene by scene",
        "",
        "Signed error of the front over the cells, mean and standard deviation over the jitters.",
        "",
        "![front over cells, scene by scene](accuracy-scenes.png)",
        "",
    ]
    write_text(out / "accuracy.md", "\n".join(lines))


def conclusion(
    findings: Sequence[Findings], measured: Sequence[Measured], spreads: dict[int, list[Spread]]
) -> list[str]:
    """What was found, in a few lines, each from its numbers."""
    lines = []
    for each in findings:
        d, finest = each.study.dimension, max(each.study.cells)
        five = pick(each, 0.05, measured)
        least = min(found.promised for found in measured if found.dimension == d)
        asked = (
            "no grid that was tried promises 5 %"
            if five is None
            else f"5 % takes {five.cells:.3g} cells across the smallest side"
        )
        lines.append(f"- **{d}D**: {asked}; the tightest promise is {percent(least)}, with up to {finest:g} cells.")
        lines.append(
            f"- If errors fall in proportion to the cell, the references ({each.study.reference:g} cells) are"
            f" themselves {percent(left_over(each))} rms from the limit in {d}D, which no promise counts."
        )
        lines.append(f"- {step_and_particles(each)}")
        best = spreads[d][0]
        lines.append(
            f"- Counted across the {best.length}, the errors of the {d}D scenes scatter least about one power of the"
            f" cells (by a factor of {best.factor:.2f})"
            + ("." if best.length == "smallest side" else f"; across the smallest side: {factor(spreads[d]):.2f}.")
        )
    lines.append(f"- {machine()}.")
    return [*lines, ""]


def left_over(findings: Findings) -> float:
    """The references' own distance from the limit, rms over the scenes, if errors are proportional to the cell [-].

    From n to N cells a front then moves by k (1 / n - 1 / N), and k / N is left.
    """
    n, reference = max(findings.study.cells), findings.study.reference
    moved = [score.bias for score in findings.at(own(n)).scores.values()]
    return math.sqrt(sum(bias**2 for bias in moved) / len(moved)) * n / (reference - n)


def factor(spreads: Sequence[Spread]) -> float:
    """Scatter about the power of the cells across the smallest side."""
    return next(each.factor for each in spreads if each.length == "smallest side")


def step_and_particles(findings: Findings) -> str:
    """What a shorter step and more particles change where they were tried."""
    d, parts = findings.study.dimension, []
    for cells in findings.study.checked:
        plain = findings.at(own(cells)).error
        shorter = findings.at(own(cells, step_fraction=OTHER_STEP)).error
        more = findings.at(own(cells, particles_per_axis=OTHER_PARTICLES)).error
        parts.append(
            f"on {cells:g} cells the rms error is {percent(plain)}, with a step of {OTHER_STEP:g} {percent(shorter)},"
            f" with {OTHER_PARTICLES} particles per axis {percent(more)}"
        )
    return f"In {d}D, {'; '.join(parts)}."


def method(findings: Sequence[Findings]) -> list[str]:
    """What is measured, and how."""
    counts = " and ".join(f"{len(each.study.scenes)} in {each.study.dimension}D" for each in findings)
    references = ", ".join(f"{each.study.reference:g} in {each.study.dimension}D" for each in findings)
    return [
        *paragraph(f"""
            `python -m validation.bench.accuracy.bench mpm --out docs --ship`. Scenes: {counts} (`validation/bench/accuracy/flows.py`). A run is
            compared at its end with the same scene on the reference's cells ({references} across the smallest side),
            {OWN_PARTICLES} particles per axis, step {OWN_STEP:g} of cell / wave speed, single precision: the **front**,
            the x that 99.5 % of the particles are behind, and the **profile**, by the rms distance along x of twenty
            equal shares of the deposits' volume. The larger of the two, over the **reach** (from the rear of the mass
            at the start to the reference's front), is the error of the run.
        """),
        *paragraph(f"""
            What is **promised**: at least {COVERAGE * 10:.0f} of 10 scenes like these stay within it. Of each scene
            the largest error counts, over the jitters, on this and all finer grids; the promise is the upper
            prediction limit for one more scene ({100 * COVERAGE:.0f} %, Student's t), and no less than the largest of
            them. `--tolerance` picks the cheapest resolution that promises what is asked;
            [tolerance.md](tolerance.md) tries it on scenes that were not measured.
        """),
    ]


def paragraph(text: str) -> list[str]:
    """A paragraph in lines of Markdown, and the empty line after it."""
    return [*textwrap.wrap(" ".join(text.split()), 118), ""]


def pick(findings: Findings, tolerance: float, measured: Sequence[Measured]) -> Resolved | None:
    """What a tolerance picks for the study's first scene, None where nothing promises it."""
    try:
        return resolved(next(iter(findings.study.scenes.values())), tolerance, measured)
    except InputError:
        return None


def picks(findings: Findings, measured: Sequence[Measured]) -> list[str]:
    """What each tolerance picks."""
    rows = []
    for tolerance in TOLERANCES:
        found = pick(findings, tolerance, measured)
        if found is not None:
            rows.append(
                [
                    f"{100 * tolerance:g} %",
                    f"{found.cells:.3g}",
                    f"{found.scene.particles_per_axis}",
                    f"{found.scene.step_fraction:g}",
                    percent(found.promised),
                    percent(found.expected),
                ]
            )
    head = ["`--tolerance`", "cells", "particles per axis", "step", "promised", "rms error"]
    return [*table(head, rows), ""] if rows else ["Nothing that was tried promises any of the tolerances shown.", ""]


def everything(findings: Findings) -> list[str]:
    """One line a resolution."""
    rows = []
    for each in findings.outcomes:
        what = each.resolution
        worst = max(each.scores, key=lambda name: each.scores[name].largest)
        scatter = max(score.scatter for score in each.scores.values())
        rows.append(
            [
                f"{what.cells:g}",
                f"{what.particles_per_axis}",
                f"{what.step_fraction:g}",
                f"{each.particle_steps / 1e6:.3g}",
                percent(each.error),
                percent(findings.promised(what)),
                f"{percent(each.largest)} ({worst})",
                "-" if math.isnan(scatter) else percent(scatter),
            ]
        )
    head = ["cells", "particles per axis", "step", "million particle-steps", "rms error", "promised", "largest error"]
    return [*table([*head, "largest scatter of the front over jitters"], rows), ""]


def reference(findings: Findings) -> list[str]:
    """How good the reference is."""
    finest = findings.at(own(max(findings.study.cells)))
    cells = f"{finest.resolution.cells:g} cells"
    rows = []
    for name, truth in findings.truths.items():
        score = finest.scores[name]
        spread = "-" if math.isnan(score.scatter) else percent(score.scatter)
        rows.append([name, f"{truth.front:.4g} m", f"{truth.reach:.4g} m", signed(-score.bias), spread])
    return [
        *paragraph(f"""
            The reference ({findings.study.reference:g} cells). Where an error falls in proportion to the cell, the
            reference is itself about as far from the limit as its front moved from {cells}, in the ratio of the cells:
            a promise speaks of the distance to the reference, not of that to the exact solution.
        """),
        *table(["scene", "front", "reach", f"front from {cells} to it", f"scatter over jitters on {cells}"], rows),
        "",
    ]


def shapes(spreads: Sequence[Spread]) -> list[str]:
    """What the cells are to be counted across."""
    return [
        *paragraph("""
            Errors of all scenes as one power of the cells across a length of the body, and the factor by which they
            scatter about it (exp of the standard deviation of the logarithms):
        """),
        *table(
            ["cells across the", "error falls with the cells to the power", "scatters by a factor of"],
            [[spread.length, f"{spread.exponent:.2f}", f"{spread.factor:.2f}"] for spread in spreads],
        ),
        "",
    ]


def toml(measured: Sequence[Measured]) -> str:
    """`resolution.toml`."""
    blocks = [
        "# What resolutions promise and cost, for --tolerance. By `python -m validation.bench.accuracy.bench mpm --ship`.\n"
        "# expected, promised: errors over the reach, rms over scenes and jitters, and what nine of ten scenes stay\n"
        "# within; particle_steps: mean over the scenes.\n"
    ]
    for each in measured:
        what = each.resolution
        blocks.append(
            f"[[measured]]\ndimension = {each.dimension}\n"
            f"expected = {each.expected}\npromised = {each.promised}\nparticle_steps = {each.particle_steps}\n"
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
