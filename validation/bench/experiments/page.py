"""experiments.md: what was found, in five lines, then every number with its source."""

import math
from collections.abc import Sequence

import numpy as np

from inverse.report.markdown import table
from validation.bench.accuracy.page import paragraph, percent, signed
from validation.bench.experiments.computed import CourseFound, Findings, VariantFound
from validation.bench.experiments.scores import CLOSE, AngleScore, Score, rms
from validation.experiments.experiment import Quantity, Shipped
from validation.report.machine import machine


def page(findings: Findings, *, quick: bool) -> str:
    """experiments.md."""
    lines = [
        "# Measured experiments",
        "",
        *conclusion(findings),
        *quickly(quick),
        *method(),
        *tables(findings).split("\n"),
    ]
    lines += ["![measured against found](experiments.png)", "", *outside(findings), *variants(findings.variants)]
    lines += courses(findings.courses)
    lines += ["## The experiments", ""]
    for each in findings.shipped:
        lines += described(each)
    return "\n".join(lines)


def conclusion(findings: Findings) -> list[str]:
    """What was found, in five lines, each from its numbers."""
    scores, angles = findings.scores, [each for each in findings.angles if not math.isnan(each.difference_deg)]
    lines = []
    if scores:
        inside = [each for each in scores if each.agrees]
        worst = max(scores, key=lambda each: abs(each.error))
        lines.append(
            f"- **Forward**, with angles of friction that were measured independently, no fitting, no damping:"
            f" {len(inside)} of {len(scores)} measured numbers are met within {CLOSE:g} times their spread; rms"
            f" {rms(each.error for each in scores):.1f} spreads, the worst {worst.error:+.1f} ({label(worst)})."
        )
        fronts = [each for each in scores if each.measured.quantity in (Quantity.FRONT, Quantity.RADIUS)]
        far = [each.found[1] / each.measured.value - 1.0 for each in fronts]
        mean = float(np.mean(far))
        moved = max(abs(each.found[1] / each.found[0] - 1.0) for each in fronts)
        lines.append(
            f"- **Fronts** come {percent(abs(mean))} too {'far' if mean > 0.0 else 'short'} on average,"
            f" {signed(min(far))} to {signed(max(far))}; from coarse to fine cells they move by"
            f" {percent(moved)} at most."
        )
    if angles:
        off = [each.difference_deg for each in angles]
        agreed = sum(each.agrees for each in angles)
        lines.append(
            f"- **Backward**, the angle inferred from the front alone is {np.mean(off):+.1f}° from the measured one on"
            f" average, {min(off):+.1f} to {max(off):+.1f}°; in {agreed} of {len(angles)} cases the two ranges overlap."
        )
    if findings.others:
        both = {(each.experiment, each.case.name) for each in findings.others}
        first = rms(each.error for each in scores if (each.experiment, each.case.name) in both)
        other = rms(each.error for each in findings.others)
        nearer, names = ("first" if first < other else "second"), sorted({each.angle.name for each in findings.others})
        kept = sorted({each.angle.name for each in scores if (each.experiment, each.case.name) in both})
        lines.append(
            f"- **Which angle**: where two were measured, the {' or '.join(kept)} angle leaves {first:.1f} spreads rms,"
            f" the {' or '.join(names)} angle {other:.1f}: the {nearer} is the one to compute with."
        )
    return [*lines, f"- {machine()}.", ""]


def quickly(quick: bool) -> list[str]:
    """A warning on a page of coarse cells."""
    return ["**Made with --quick: coarse cells, 2D alone; the figures mean little.**", ""] if quick else []


def method() -> list[str]:
    """How the numbers come about."""
    return paragraph(f"""
        `python -m validation.bench experiments --out docs`. Every experiment is a folder in `validation/experiments`
        with its scene, its numbers, their spread, source and licence. A number there stood in a source that was read or
        is worked out from such numbers; where sources disagree the band between them is the target, its half width the
        spread. Scenes are computed until they rest, undamped, with a step of 0.9 of cell / wave speed, once on coarse
        and once on fine cells, one jitter each; nothing is chosen by the outcome. The error is (found - measured) /
        spread on the fine cells, and a number beyond {CLOSE:g} has its reason below. Where both an avalanche and a
        repose angle were measured, the avalanche angle is the one to compute with, as Rousseau et al. (2023) find for
        Drucker-Prager continua; the other is shown beside it. The angle inferred is the one at which the MPM's front is
        the measured one, floor included where it is as rough as the grains; ± is what the measurement's spread leaves
        open, not what the model misses.
    """)


def tables(findings: Findings) -> str:
    """The score tables."""
    lines = ["## Forward", ""]
    rows = []
    for each in findings.scores:
        coarse, fine = each.found
        rows.append(
            [
                each.experiment,
                f"{each.case.name}, {each.measured.quantity}",
                f"{each.angle.deg:.1f}° ({each.angle.name})",
                f"{each.measured.value:.4f} ± {each.measured.spread:.4f}",
                f"{coarse:.4f}",
                f"{fine:.4f}",
                f"{each.error:+.1f}" if each.agrees else f"**{each.error:+.1f}**",
                beside(each, findings.others),
            ]
        )
    head = ["experiment", "", "angle", "measured [m]", "found, coarse", "fine", "error [spreads]", "at the other angle"]
    lines += [*table(head, rows), "", "## Backward", ""]
    rows = [
        [
            each.experiment,
            each.case.name,
            ", ".join(f"{angle.deg:.1f} ± {angle.half_width_deg:.1f}° ({angle.name})" for angle in each.angles) or "-",
            *(angle_text(each, number) for number in (0, 1)),
            f"{each.difference_deg:+.1f}°" if not math.isnan(each.difference_deg) else "-",
            f"{each.inferred[1].runs}",
        ]
        for each in findings.angles
    ]
    head = ["experiment", "", "measured angle", "inferred, coarse", "fine", "difference", "runs"]
    return "\n".join([*lines, *table(head, rows), ""])


def angle_text(each: AngleScore, number: int) -> str:
    """An inferred angle and its half-width."""
    found = each.inferred[number]
    return "none" if math.isnan(found.deg) else f"{found.deg:.1f} ± {found.half_width_deg:.1f}°"


def beside(score: Score, others: Sequence[Score]) -> str:
    """The errors of the same number at the material's other angles."""
    same = [each for each in others if each.case == score.case and each.measured == score.measured]
    return ", ".join(
        f"{each.error:+.1f} at {each.angle.deg:.1f}°" for each in same if each.experiment == score.experiment
    )


def outside(findings: Findings) -> list[str]:
    """Why a number is missed by more than twice its spread, where one is."""
    missed = [each for each in findings.scores if not each.agrees]
    if not missed:
        return ["Every number is within twice its spread.", ""]
    lines = ["## Outside twice the spread", ""]
    for each in missed:
        reason = each.measured.beyond or "No reason is known."
        lines.append(f"- {label(each)}, {each.error:+.1f} spreads: {reason}")
    return [*lines, ""]


def variants(found: Sequence[VariantFound]) -> list[str]:
    """What a difference in one respect is worth."""
    if not found:
        return []
    lines = ["## What one respect is worth", ""]
    for each in found:
        value, spread = each.measured
        error = (each.found - value) / spread
        moved = 1000.0 * (each.found - each.usual)
        lines.append(
            f"- {each.shipped.name}, {each.variant.name}: the front is at {each.found:.3f} m, {moved:+.0f} mm from that"
            f" of the case itself on the same cells ({1000.0 * each.cell:g} mm) and {error:+.1f}"
            f" spreads from the measured one: {each.variant.says}"
        )
    return [*lines, ""]


def courses(found: Sequence[CourseFound]) -> list[str]:
    """Extents over time at an effective angle: what one angle cannot say of a flow."""
    lines = ["## Over time", ""] if found else []
    for each in found:
        course = each.course
        errors = [(f - v) / s for f, v, s in zip(each.found, course.values, course.spreads, strict=True)][1:]
        worst = max(errors, key=abs)
        lines += paragraph(f"""
            {each.experiment}, {each.case.name}, at the angle that its end implies, {each.deg:.1f}°: the extent over
            time differs from the measured one by {rms(errors):.1f} spreads rms, {worst:+.1f} at most. Time counts from
            the first row, where both are equally far. {course.status}: {course.source}. Spread: {course.spread_from}.
        """)
        rows = [
            [f"{time:.3f}", f"{1000.0 * value:.1f} ± {1000.0 * spread:.1f}", f"{1000.0 * computed:.1f}", f"{miss:+.1f}"]
            for time, value, spread, computed, miss in zip(
                course.times, course.values, course.spreads, each.found, [0.0, *errors], strict=True
            )
        ]
        lines += [*table(["time [s]", "measured [mm]", "found [mm]", "error [spreads]"], rows), ""]
    return lines


def described(shipped: Shipped) -> list[str]:
    """Source, licence, numbers and choices of an experiment."""
    one = shipped.experiment
    lines = [f"### {shipped.name}", "", *paragraph(f"**{one.title}.** {one.what}"), *paragraph(f"Source: {one.source}")]
    lines += [f"Licence: {one.licence}.", ""]
    lines += [
        f"- Angle ({angle.name}): {angle.lower_deg:g} to {angle.upper_deg:g}°; {angle.status}: {angle.source}."
        for angle in one.angles
    ]
    for case in one.cases:
        for measured in case.measured:
            lines.append(
                f"- {case.name}, {measured.quantity}: {measured.value:g} ± {measured.spread:g} m; {measured.status}:"
                f" {measured.source}. Spread: {measured.spread_from}."
            )
    rows = [[each.what, each.choice, each.reason] for each in one.unsaid]
    return [*lines, "", *table(["not stated", "our choice", "reason"], rows), ""]


def label(score: Score) -> str:
    """Experiment, case and quantity."""
    return f"{score.experiment}, {score.case.name}, {score.measured.quantity}"
