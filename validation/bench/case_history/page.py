"""case-history.md: what was found in five lines, the ground with release and deposits, the choices."""

import math
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt

from datasets import files
from datasets.measures import front
from inverse.report.markdown import table
from validation.bench.accuracy.page import paragraph, signed
from validation.bench.case_history.history import BackAnalysis
from validation.report.machine import machine

HEAD = ["", "cell [m]", "angle of the bed friction", "coefficient", "runs"]


def tables(found: BackAnalysis) -> str:
    """The bed friction that was inferred, on either cell, beside the twin's."""
    rows = []
    for name, cell, one in zip(("coarse", "fine"), found.read.history.cells, found.inferred, strict=True):
        if math.isnan(one.deg):
            rows.append([name, f"{cell:g}", "none", "none", f"{one.runs}"])
            continue
        low, high = (math.tan(math.radians(one.deg + sign * one.half_width_deg)) for sign in (-1.0, 1.0))
        middle = math.tan(math.radians(one.deg))
        rows.append(
            [
                name,
                f"{cell:g}",
                f"{one.deg:.2f} ± {one.half_width_deg:.2f}°",
                f"{middle:.3f} ({low:.3f} to {high:.3f})",
                f"{one.runs}",
            ]
        )
    history = found.read.history
    rows.append(
        ["the twin's", f"{history.twin.cell:g}", f"{found.truth_deg:.2f}°", f"{history.twin.bed_friction:.3f}", ""]
    )
    return "\n".join([*table(HEAD, rows), ""])


def page(found: BackAnalysis) -> str:
    """case-history.md."""
    history, fine = found.read.history, found.inferred[1]
    lines = ["# A case history at field scale", "", *conclusion(found)]
    lines += paragraph(f"**{history.title}.** {history.what}")
    lines += paragraph("""
        `python -m validation.bench case-history --out docs`. The runout alone is given to the back-analysis, rounded to
        the middle of its pixel; the search is that of the [measured experiments](experiments.md), here for the angle of
        the bed friction. ± is what the uncertainty of the runout leaves open.
    """)
    lines += [tables(found), "![ground, release and deposits](case-history.png)", ""]
    if not math.isnan(fine.deg):
        off = front(found.deposit) / front(found.twin) - 1.0
        lines += paragraph(f"The front of the deposit at the inferred friction is {signed(off)} from the twin's.")
    scene = f"validation/case_history/{found.read.name}/{history.scene}"
    lines += paragraph(f"""
        Depth, velocity and deposit of the twin along the ground, as a table and a picture: `python -m mpm.run {scene}
        --out out/twin --fields`, then `python -m datasets.maps out/twin --out out/twin/maps`.
    """)
    lines += paragraph(f"Source: {history.source}")
    lines += [
        f"Licence: {history.licence}.",
        "",
        f"Spread of the runout, {history.spread:g} m: {history.spread_from}.",
        "",
    ]
    rows = [[each.what, each.choice, each.reason] for each in history.unsaid]
    return "\n".join([*lines, *table(["not stated", "our choice", "reason"], rows), ""])


def conclusion(found: BackAnalysis) -> list[str]:
    """What was found, in a few lines, each from its numbers."""
    history, fine = found.read.history, found.inferred[1]
    lines = [
        f"- **What it is**: {history.title.lower()}; the observed runout is x = {found.observed:g} m,"
        f" {history.spread:g} m of spread.",
    ]
    if math.isnan(fine.deg):
        lines.append("- **Back-analysis**: no bed friction within the bounds gives that runout.")
    else:
        lines.append(
            f"- **Back-analysis**: the bed friction is {fine.deg:.2f} ± {fine.half_width_deg:.2f}°, after {fine.runs}"
            f" runs; the twin's {found.truth_deg:.2f}° is {'within' if found.holds else '**outside**'} that."
        )
        shift = fine.deg - found.inferred[0].deg
        lines.append(
            f"- **Cells**: from {history.cells[0]:g} to {history.cells[1]:g} m the answer moves by {shift:+.2f}°."
        )
    lines.append(
        f"- **Travel angle**: the line between the centres of mass of release and deposit falls at"
        f" {found.travel_deg:.1f}°, {found.travel_deg - found.truth_deg:+.1f}° from the bed friction: what that rule of"
        " thumb would have said."
    )
    return [*lines, f"- {machine()}.", ""]


def draw(path: Path, found: BackAnalysis) -> None:
    """Ground, release and both deposits, heights exaggerated as the axes say."""
    figure, axes = plt.subplots(2, 1, figsize=(11.0, 6.4), layout="constrained")
    ground = found.read.ground
    for axis, window in zip(axes, (None, found.observed), strict=True):
        axis.plot(ground[:, 0], ground[:, 1], color="#888888", linewidth=0.8)
        for points, colour, name in (
            (found.start, "#222222", "release"),
            (found.twin, "#d95f02", "deposit of the twin"),
            (found.deposit, "#1b6ca8", "deposit at the inferred friction"),
        ):
            axis.plot(points[:, 0], points[:, 1], ".", color=colour, markersize=2, label=name)
        axis.axvline(found.observed, color="#888888", linewidth=0.8, linestyle="--", label="runout observed")
        axis.spines[["top", "right"]].set_visible(False)
        axis.set_ylabel("y [m]")
        if window is not None:
            low = float(found.twin[:, 0].min())
            axis.set_xlim(low, window + 0.05 * (window - low))
            near = found.twin[:, 1]
            axis.set_ylim(float(near.min()) - 5.0, float(near.max()) + 5.0)
    axes[0].legend(fontsize=8, frameon=False, markerscale=4)
    axes[1].set_xlabel("x [m]")
    with files.replacing(path) as part:
        figure.savefig(part, dpi=140)
    plt.close(figure)
