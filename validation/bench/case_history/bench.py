"""`python -m validation.bench case-history`: a friction back-analysed at field scale, a page, a picture."""

import dataclasses
import math
from functools import partial
from pathlib import Path

from datasets.measures import front
from datasets.particles import initial_particles
from validation.bench.case_history.history import FOLDER, BackAnalysis, analyse, read_history
from validation.bench.experiments.bench import deposits_of
from validation.report.page import Page, signed
from validation.report.plots import BLUE, GREY, INK, ORANGE, figure
from validation.runs import RunStore

QUICK_FACTOR = 2.0


def bench(out: Path, *, quick: bool, keep: Path, history: Path = FOLDER / "yildiz-parabola") -> str:
    """Back-analyse the case history in the folder `history`: case-history.md and its picture.

    quick: on cells twice as large. Raises InputError for a history that cannot be read.
    """
    read = read_history(history)
    if quick:
        coarse, fine = read.history.cells
        twin = dataclasses.replace(read.history.twin, cell=QUICK_FACTOR * read.history.twin.cell)
        larger = dataclasses.replace(read.history, cells=(QUICK_FACTOR * coarse, QUICK_FACTOR * fine), twin=twin)
        read = dataclasses.replace(read, history=larger)
    twin = read.history.twin
    start = initial_particles(read.scene(twin.bed_friction, twin.cell, twin.seed)).positions
    found = analyse(read, partial(deposits_of, RunStore(keep)), start)
    draw(out / "case-history.png", found)
    return write(out / "case-history.md", found, quick=quick)


def write(path: Path, found: BackAnalysis, *, quick: bool) -> str:
    """Write the page, and return its conclusion."""
    history, fine = found.read.history, found.fine
    page = Page(
        "A case history at field scale",
        command="python -m validation.bench case-history --out docs",
        conclusion=conclusion(found),
        quick=quick,
    )
    page.text(f"""
        **{history.title}.** {history.what}

        The runout alone is the observation, rounded to the middle of its pixel; the search is that of the
        [measured experiments](experiments.md), here for the angle of the bed friction. ± is the uncertainty by that of
        the runout.
    """)
    rows = [
        {
            "": name,
            "cell [m]": f"{cell:g}",
            "angle of the bed friction": f"{each.deg:.2f} ± {each.half_width_deg:.2f}°",
            "coefficient": " to ".join(
                f"{math.tan(math.radians(each.deg + sign * each.half_width_deg)):.3f}" for sign in (-1.0, 1.0)
            ),
            "runs": each.runs,
        }
        for name, cell, each in zip(("coarse", "fine"), history.cells, (found.coarse, fine), strict=True)
        if not math.isnan(each.deg)
    ]
    twin = {
        "": "twin",
        "cell [m]": f"{history.twin.cell:g}",
        "angle of the bed friction": f"{found.truth_deg:.2f}°",
        "coefficient": f"{history.twin.bed_friction:.3f}",
        "runs": None,
    }
    page.table([*rows, twin])
    page.picture(path.with_suffix(".png").name, "ground, release and deposits")
    if not math.isnan(fine.deg):
        off = front(found.deposit) / front(found.twin) - 1.0
        page.text(f"The front of the deposit at the inferred friction is {signed(off)} from the twin's.")
    scene = f"validation/bench/case_history/{found.read.name}/{history.scene}"
    page.text(f"""
        Depth, velocity and deposit of the twin along the ground, as a table and a picture:
        `python -m mpm.run {scene} --out out/twin --fields`, then
        `python -m datasets.maps out/twin --out out/twin/maps`.

        Source: {history.source}

        Licence: {history.licence}.

        Spread of the runout, {history.spread:g} m: {history.spread_from}.
    """)
    page.table(
        [{"not stated": each.what, "choice": each.choice, "reason": each.reason} for each in history.assumptions]
    )
    return page.write(path)


def conclusion(found: BackAnalysis) -> list[str]:
    """What was found, each sentence from its numbers."""
    history, fine = found.read.history, found.fine
    lines = [
        f"**Observation**: {history.title.lower()}; runout at x = {found.observed:g} m, {history.spread:g} m of spread."
    ]
    if math.isnan(fine.deg):
        lines.append("**Back-analysis**: no bed friction within the bounds gives that runout.")
    else:
        lines.append(
            f"**Back-analysis**: the bed friction is {fine.deg:.2f} ± {fine.half_width_deg:.2f}°, after {fine.runs}"
            f" runs; the twin's {found.truth_deg:.2f}° is {'within' if found.covers_truth else '**outside**'} that."
        )
        lines.append(
            f"**Cells**: from {history.cells[0]:g} to {history.cells[1]:g} m the answer moves by"
            f" {fine.deg - found.coarse.deg:+.2f}°."
        )
    return [
        *lines,
        "**Travel angle**: the line between the centres of mass of release and deposit falls at"
        f" {found.travel_deg:.1f}°, {found.travel_deg - found.truth_deg:+.1f}° from the bed friction: the error of that"
        " rule of thumb.",
    ]


def draw(path: Path, found: BackAnalysis) -> None:
    """Ground, release and both deposits; below, the deposits alone, heights exaggerated as the axes show."""
    ground = found.read.ground
    with figure(path, rows=2, size=(10.0, 3.2)) as axes:
        for axis in axes[:, 0]:
            axis.plot(ground[:, 0], ground[:, 1], color=GREY, linewidth=0.8)
            for positions, colour, name in (
                (found.start, INK, "release"),
                (found.twin, ORANGE, "deposit of the twin"),
                (found.deposit, BLUE, "deposit at the inferred friction"),
            ):
                axis.plot(positions[:, 0], positions[:, 1], ".", color=colour, markersize=2, label=name)
            axis.axvline(found.observed, color=GREY, linewidth=0.8, linestyle="--", label="observed runout")
            axis.set(xlabel="x [m]", ylabel="y [m]")
        axes[0, 0].legend(markerscale=4)
        low, high = float(found.twin[:, 0].min()), found.observed
        heights = found.twin[:, 1]
        axes[1, 0].set(
            xlim=(low, high + 0.05 * (high - low)), ylim=(float(heights.min()) - 5.0, float(heights.max()) + 5.0)
        )
