"""`python -m validation.bench accuracy`: error against cost of the MPM, and what --tolerance reads."""

import json
from collections.abc import Sequence
from pathlib import Path

from datasets.errors import InputError
from datasets.files import write_text
from mpm.resolution import COVERAGE, MEASURED, Measured, Resolved, resolved
from validation.bench.accuracy import studies
from validation.bench.accuracy.flows import OWN_STEP
from validation.bench.accuracy.pictures import draw_cost, draw_scenes
from validation.bench.accuracy.studies import OTHER_PARTICLES, OTHER_STEP, OWN_PARTICLES, Findings, own
from validation.report.page import Page, percent, signed
from validation.runs import RunStore

TOLERANCES = (0.2, 0.15, 0.1, 0.07, 0.05, 0.04, 0.03, 0.02)
"""The resolution that each selects is shown."""
STATED = 0.05
"""That of the conclusion."""


def bench(out: Path, *, quick: bool, keep: Path, dimension: int | None = None, ship: bool = False) -> str:
    """Error and cost of the MPM over cell, step and particles per cell: accuracy.md, its pictures and resolution.toml.

    quick: a few coarse runs. dimension: 2 or 3, only the scenes of this dimension. ship: put resolution.toml where
    --tolerance reads it, not into `out`.
    """
    tried = [each for each in (studies.quick() if quick else studies.full()) if dimension in (None, each.dimension)]
    if not tried:
        raise InputError(f"expected 2 or 3, got {dimension}", key="dimension")
    findings = [studies.compute(study, RunStore(keep)) for study in tried]
    measured = studies.measured(findings)
    write_text(MEASURED if ship else out / MEASURED.name, toml(measured))
    return write(out, findings, measured, quick=quick)


def write(out: Path, findings: Sequence[Findings], measured: Sequence[Measured], *, quick: bool = False) -> str:
    """Write accuracy.md and its pictures, and return the conclusion."""
    page = Page(
        "Error against cost",
        command="python -m validation.bench accuracy --ship --out docs",
        conclusion=[sentence for each in findings for sentence in conclusion(each, measured)],
        quick=quick,
    )
    counts = " and ".join(f"{len(each.study.scenes)} in {each.study.dimension}D" for each in findings)
    references = ", ".join(f"{each.study.reference:g} in {each.study.dimension}D" for each in findings)
    page.text(f"""
        Scenes: {counts} (`validation/bench/accuracy/flows.py`). A run is compared at its end with the same scene on the
        reference's cells ({references} across the smallest side), {OWN_PARTICLES} particles per axis, step
        {OWN_STEP:g} of cell / wave speed, single precision: the **front**, the x that 99.5 % of the particles are
        behind, and the **profile**, by the rms distance along x of twenty equal shares of the deposits' volume. The
        larger of the two, over the **extent** (from the rear of the mass at the start to the reference's front), is the
        error of the run.

        The **bound** is for {COVERAGE * 10:.0f} of 10 further scenes like these. The error of each scene is the largest
        over the jitters, on this and all finer grids; the bound is the upper prediction limit for one more scene
        ({100 * COVERAGE:.0f} %, Student's t), and no less than the largest of them. `--tolerance` selects the cheapest
        resolution whose bound is within it.
    """)
    draw_cost(out / "accuracy.png", findings)
    page.picture("accuracy.png", "error against particle-steps")
    for each in findings:
        describe(page, each, measured)
    page.section("Scene by scene")
    page.text("Signed error of the front over the cells, mean and standard deviation over the jitters.")
    draw_scenes(out / "accuracy-scenes.png", findings)
    page.picture("accuracy-scenes.png", "front over cells, scene by scene")
    return page.write(out / "accuracy.md")


def conclusion(findings: Findings, measured: Sequence[Measured]) -> tuple[str, str]:
    """What was found in a dimension, two sentences from its numbers."""
    study, parts = findings.study, []
    selected = select(findings, STATED, measured)
    smallest = min(each.promised for each in measured if each.dimension == study.dimension)
    needed = (
        f"takes {selected.cells:.3g} cells" if selected else "is within the bound of none of these grids; cells are"
    )
    for cells in study.checked:
        changes = (own(cells), own(cells, step_fraction=OTHER_STEP), own(cells, particles_per_axis=OTHER_PARTICLES))
        usual, shorter, more = (percent(findings.at(each).error) for each in changes)
        parts.append(
            f"on {cells:g} cells {usual}, with a step of {OTHER_STEP:g} {shorter}, with {OTHER_PARTICLES} particles per"
            f" axis {more}"
        )
    return (
        f"**{study.dimension}D**: {percent(STATED)} {needed} across the smallest side; the smallest bound is"
        f" {percent(smallest)}, with up to {max(study.cells):g} cells. If errors fall in proportion to the cell, the"
        f" references ({study.reference:g} cells) are {percent(findings.reference_error())} rms from the limit, beyond"
        " every bound.",
        f"**{study.dimension}D**, rms error: {'; '.join(parts)}.",
    )


def select(findings: Findings, tolerance: float, measured: Sequence[Measured]) -> Resolved | None:
    """The resolution that a tolerance selects for the study's first scene, None where no bound is within it."""
    try:
        return resolved(next(iter(findings.study.scenes.values())), tolerance, measured)
    except InputError:
        return None


def describe(page: Page, findings: Findings, measured: Sequence[Measured]) -> None:
    """The section of a dimension."""
    study = findings.study
    page.section(f"{study.dimension}D")
    resolution = {"cells": ".3g", "particles per axis": "", "step": "g"}
    selected = [(tolerance, select(findings, tolerance, measured)) for tolerance in TOLERANCES]
    page.table(
        [
            (tolerance, r.cells, r.scene.particles_per_axis, r.scene.step_fraction, r.promised, r.expected)
            for tolerance, r in selected
            if r is not None
        ],
        formats={"`--tolerance`": percent, **resolution, "bound": percent, "rms error": percent},
    )
    rows = []
    for each in findings.outcomes:
        what, worst = each.resolution, max(each.scores, key=lambda name: each.scores[name].largest)
        rows.append(
            (
                what.cells,
                what.particles_per_axis,
                what.step_fraction,
                each.particle_steps / 1e6,
                each.error,
                findings.bound(what),
                f"{percent(each.scores[worst].largest)} ({worst})",
                max(score.scatter for score in each.scores.values()),
            )
        )
    page.table(
        rows,
        formats={
            **resolution,
            "million particle-steps": ".3g",
            "rms error": percent,
            "bound": percent,
            "largest error": "",
            "largest scatter of the front over jitters": percent,
        },
    )
    finest = findings.at(own(max(study.cells)))
    cells = f"{finest.resolution.cells:g} cells"
    page.text(f"""
        The reference ({study.reference:g} cells). Where an error falls in proportion to the cell, the reference is
        itself about as far from the limit as its front moved from {cells}, in the ratio of the cells: a bound is of the
        distance to the reference, not of that to the exact solution.
    """)
    page.table(
        [
            (name, each.front, each.extent, -finest.scores[name].bias, finest.scores[name].scatter)
            for name, each in findings.references.items()
        ],
        formats={
            "scene": "",
            "front [m]": ".4g",
            "extent [m]": ".4g",
            f"front from {cells} to it": signed,
            f"scatter over jitters on {cells}": percent,
        },
    )


def toml(measured: Sequence[Measured]) -> str:
    """`resolution.toml`."""
    blocks = [
        "# What resolutions promise and cost, for --tolerance. By `python -m validation.bench accuracy --ship`.\n"
        "# expected, promised: errors over the extent, rms over scenes and jitters, and the bound for nine of ten\n"
        "# scenes; particle_steps: mean over the scenes.\n"
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
