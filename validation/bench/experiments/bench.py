"""`python -m validation.bench experiments`: every experiment forward and backward, a page, a picture."""

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from datasets.measures import Positions
from datasets.scene import Scene
from mpm import AT_REST
from validation.bench.experiments.computed import Findings, compute, with_cells
from validation.bench.experiments.scores import CLOSE, AngleScore, Score, rms
from validation.experiments.experiment import FOLDER, Quantity, Shipped, read_experiments
from validation.report.page import Page, percent, signed
from validation.report.plots import BLUE, INK, LIGHT_BLUE, figure
from validation.runs import Run, RunStore

QUICK_FACTOR = 2.0
QUICK_ROUNDS = 2


def bench(out: Path, *, quick: bool, keep: Path, experiments: Path = FOLDER) -> str:
    """Run all experiments in the folder `experiments`: experiments.md and its picture.

    quick: on cells twice as large, in 2D alone, with fewer runs for an angle. Raises InputError for an experiment that
    cannot be read.
    """
    shipped = read_experiments(experiments)
    run = partial(deposits_of, RunStore(keep))
    if quick:
        flat = [
            each
            for each in shipped
            if each.scene(each.experiment.cases[0].scene, each.experiment.cells[0], 25.0).dimension == 2
        ]
        findings = compute([with_cells(each, QUICK_FACTOR) for each in flat], run, rounds=QUICK_ROUNDS)
    else:
        findings = compute(shipped, run)
    draw(out / "experiments.png", findings)
    return write(out / "experiments.md", findings, quick=quick)


def deposits_of(store: RunStore, scenes: Sequence[Scene]) -> list[Positions]:
    """The deposits [m] of scenes, each of shape [N, D], at rest or at their end."""
    return [flow.positions[-1] for flow in store.run([Run(scene=scene, record=AT_REST) for scene in scenes])]


def write(path: Path, findings: Findings, *, quick: bool) -> str:
    """Write the page, and return its conclusion."""
    page = Page(
        "Measured experiments",
        command="python -m validation.bench experiments --out docs",
        conclusion=conclusion(findings),
        quick=quick,
    )
    page.text(f"""
        Every experiment is a folder in `validation/experiments` with its scene, its numbers, their spread, source and
        licence. A number was read in a source or is worked out from such numbers; where sources disagree the band
        between them is the target, its half width the spread. Scenes are computed until they rest, undamped, with a
        step of 0.9 of cell / wave speed, once on coarse and once on fine cells, one jitter each; nothing is fitted. The
        error is (computed - measured) / spread on the fine cells; bold where it is beyond {CLOSE:g}, with the reason
        below. Where both an avalanche and a repose angle were measured, the avalanche angle is the one to compute with,
        as Rousseau et al. (2023) find for Drucker-Prager continua; the other is shown beside it. The inferred angle is
        the one at which the MPM's front is the measured one, floor included where it is as rough as the grains; ± is
        the uncertainty by the measurement's spread, without the discrepancy of the model.
    """)
    page.section("Forward")
    page.table(
        [
            (
                each.experiment,
                f"{each.case.name}, {each.measured.quantity}",
                f"{each.angle.deg:.1f}° ({each.angle.name})",
                f"{each.measured.value:.4f} ± {each.measured.spread:.4f}",
                each.coarse,
                each.fine,
                f"{each.error:+.1f}" if each.agrees else f"**{each.error:+.1f}**",
                at_other_angles(each, findings),
            )
            for each in findings.scores
        ],
        formats={
            "experiment": "",
            "case": "",
            "angle": "",
            "measured [m]": "",
            "coarse cells [m]": ".4f",
            "fine cells [m]": ".4f",
            "error [spreads]": "",
            "at the other angle": "",
        },
    )
    page.section("Backward")
    page.table(
        [
            (
                each.experiment,
                each.case.name,
                ", ".join(f"{angle.deg:.1f} ± {angle.half_width_deg:.1f}° ({angle.name})" for angle in each.angles),
                *(
                    "none" if math.isnan(found.deg) else f"{found.deg:.1f} ± {found.half_width_deg:.1f}°"
                    for found in (each.coarse, each.fine)
                ),
                each.difference_deg,
                each.fine.runs,
            )
            for each in findings.angles
        ],
        formats={
            "experiment": "",
            "case": "",
            "measured angle": "",
            "inferred, coarse cells": "",
            "fine cells": "",
            "difference [°]": "+.1f",
            "runs": "",
        },
    )
    page.picture("experiments.png", "measured against computed")
    page.section(f"Beyond {CLOSE:g} spreads")
    beyond = [each for each in findings.scores if not each.agrees]
    page.text(
        "\n".join(
            f"- {each.label}, {each.error:+.1f} spreads: {each.measured.explanation or 'No reason is known.'}"
            for each in beyond
        )
        or f"Every number is within {CLOSE:g} spreads."
    )
    if findings.variants:
        page.section("Effect of one respect")
    for variant in findings.variants:
        off = (variant.found - variant.measured.value) / variant.measured.spread
        page.text(
            f"- {variant.experiment}, {variant.variant.name}: the front is at {variant.found:.3f} m,"
            f" {1000.0 * (variant.found - variant.usual):+.0f} mm from that of the case itself on the same cells"
            f" ({1000.0 * variant.cell:g} mm) and {off:+.1f} spreads from the measured one: {variant.variant.comment}"
        )
    if findings.series:
        page.section("Over time")
    for each in findings.series:
        series = each.series
        page.text(
            f"{each.label}, at the angle that its end implies, {each.deg:.1f}°: the extent over time differs from the"
            f" measured one by {rms(each.errors[1:]):.1f} spreads rms, {max(each.errors, key=abs):+.1f} at most. Time"
            f" counts from the first row, where both are equally far. Source ({series.status}): {series.source}."
            f" Spread: {series.spread_from}."
        )
        page.table(
            [
                (time, f"{1000.0 * value:.1f} ± {1000.0 * spread:.1f}", 1000.0 * found, error)
                for time, value, spread, found, error in zip(
                    series.times, series.values, series.spreads, each.found, each.errors, strict=True
                )
            ],
            formats={"time [s]": ".3f", "measured [mm]": "", "computed [mm]": ".1f", "error [spreads]": "+.1f"},
        )
    page.section("The experiments")
    for shipped in findings.shipped:
        describe(page, shipped)
    return page.write(path)


def conclusion(findings: Findings) -> list[str]:
    """What was found, each sentence from its numbers."""
    scores, angles = findings.scores, [each for each in findings.angles if not math.isnan(each.difference_deg)]
    lines = []
    if scores:
        agreed = sum(each.agrees for each in scores)
        largest = max(scores, key=lambda each: abs(each.error))
        lines.append(
            f"**Forward**, with angles of friction that were measured independently, no fitting, no damping: {agreed}"
            f" of {len(scores)} measured numbers are within {CLOSE:g} times their spread; rms"
            f" {rms(each.error for each in scores):.1f} spreads, at most {largest.error:+.1f} ({largest.label})."
        )
        fronts = [each for each in scores if each.measured.quantity in (Quantity.FRONT, Quantity.RADIUS)]
        far = [each.fine / each.measured.value - 1.0 for each in fronts]
        mean = float(np.mean(far))
        lines.append(
            f"**Fronts** come {percent(abs(mean))} too {'far' if mean > 0.0 else 'short'} on average,"
            f" {signed(min(far))} to {signed(max(far))}; from coarse to fine cells they move by"
            f" {percent(max(abs(each.fine / each.coarse - 1.0) for each in fronts))} at most."
        )
    if angles:
        off = [each.difference_deg for each in angles]
        lines.append(
            f"**Backward**, the angle inferred from the front alone is {np.mean(off):+.1f}° from the measured one on"
            f" average, {min(off):+.1f} to {max(off):+.1f}°; in {sum(each.agrees for each in angles)} of {len(angles)}"
            " cases the two ranges overlap."
        )
    if findings.others:
        cases = {(each.experiment, each.case.name) for each in findings.others}
        same = [each for each in scores if (each.experiment, each.case.name) in cases]
        first, other = (rms(each.error for each in some) for some in (same, findings.others))
        names = [" or ".join(sorted({each.angle.name for each in some})) for some in (same, findings.others)]
        lines.append(
            f"**Which angle**: where two were measured, the {names[0]} angle leaves {first:.1f} spreads rms, the"
            f" {names[1]} angle {other:.1f}: the {names[first > other]} angle is the one to compute with."
        )
    return lines or ["No experiment has a measured extent."]


def at_other_angles(score: Score, findings: Findings) -> str:
    """The errors of the same number at the material's other angles."""
    same = [each for each in findings.others if each.label == score.label and each.measured == score.measured]
    return ", ".join(f"{each.error:+.1f} at {each.angle.deg:.1f}°" for each in same)


def describe(page: Page, shipped: Shipped) -> None:
    """Source, licence, numbers and choices of an experiment."""
    one = shipped.experiment
    page.section(shipped.name, level=3)
    page.text(f"**{one.title}.** {one.what}\n\nSource: {one.source}\n\nLicence: {one.licence}.")
    lines = [
        f"- Angle ({angle.name}): {angle.lower_deg:g} to {angle.upper_deg:g}°; {angle.status}: {angle.source}."
        for angle in one.angles
    ]
    lines += [
        f"- {case.name}, {measured.quantity}: {measured.value:g} ± {measured.spread:g} m; {measured.status}:"
        f" {measured.source}. Spread: {measured.spread_from}."
        for case in one.cases
        for measured in case.measured
    ]
    page.text("\n".join(lines))
    page.table([{"not stated": each.what, "choice": each.choice, "reason": each.reason} for each in one.assumptions])


def draw(path: Path, findings: Findings) -> None:
    """A row per measured length on the left, one per inferred angle on the right."""
    lengths = [each for each in findings.scores if each.measured.quantity is not Quantity.PROFILE]
    with figure(path, columns=2, size=(7.0, 1.6 + 0.36 * max(len(lengths), len(findings.angles), 1))) as axes:
        draw_lengths(axes[0, 0], lengths)
        draw_angles(axes[0, 1], findings.angles)
        for axis in axes.flat:
            axis.grid(axis="y", visible=False)
            axis.invert_yaxis()
            axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2)


def draw_lengths(axis: Axes, scores: list[Score]) -> None:
    """Lengths over the measured ones."""
    rows = range(len(scores))
    value = np.array([each.measured.value for each in scores])
    spread = np.array([each.measured.spread for each in scores]) / value
    axis.errorbar(
        np.ones(len(scores)), rows, xerr=spread, fmt="s", color=INK, capsize=3, ms=4, label="measured, ± spread"
    )
    axis.plot(np.array([each.coarse for each in scores]) / value, rows, "o", color=LIGHT_BLUE, label="coarse cells")
    axis.plot(np.array([each.fine for each in scores]) / value, rows, "o", color=BLUE, label="fine cells")
    axis.set_yticks(rows, [each.label for each in scores])
    axis.set(xlabel="length over the measured one", title="Forward, with angles measured independently")


def draw_angles(axis: Axes, scores: tuple[AngleScore, ...]) -> None:
    """Angles in degrees."""
    rows = range(len(scores))
    style = {"capsize": 3, "ms": 4, "linestyle": "none"}
    for number, marker, fill, name in (
        (0, "s", INK, "measured, computed with"),
        (1, "d", "none", "measured, the other"),
    ):
        some = [(row, each.angles[number]) for row, each in zip(rows, scores, strict=True) if len(each.angles) > number]
        axis.errorbar(
            [angle.deg for _, angle in some],
            [row for row, _ in some],
            xerr=[angle.half_width_deg for _, angle in some],
            marker=marker,
            mfc=fill,
            color=INK,
            label=name,
            **style,  # type: ignore[arg-type]
        )
    for name, colour in (("coarse", LIGHT_BLUE), ("fine", BLUE)):
        found = [(row, getattr(each, name)) for row, each in zip(rows, scores, strict=True)]
        found = [(row, each) for row, each in found if math.isfinite(each.half_width_deg)]
        axis.errorbar(
            [each.deg for _, each in found],
            [row for row, _ in found],
            xerr=[each.half_width_deg for _, each in found],
            marker="o",
            color=colour,
            label=f"inferred from the front, {name} cells",
            **style,  # type: ignore[arg-type]
        )
    axis.set_yticks(rows, [each.label for each in scores])
    axis.set(xlabel="angle of friction [deg]", title="Backward")
