"""What `validation.bench.columns.scaling` writes: our columns beside those of the experiments."""

import math
from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from datasets import files
from inverse.report.markdown import table
from validation.bench.accuracy.page import paragraph
from validation.bench.columns.collapse import FRICTION_DEG, STEP, STIFFNESS
from validation.bench.columns.scaling_laws import HIGH, LOW, Law, Series, side
from validation.report.power_law import PowerLaw

NAMES = {2: "2D", 3: "cylinder, 3D"}
BAND = 2.0
"""A prefactor within this factor of a published one is in the band."""
COLOURS = ("#d95f02", "#7a9a01", "#7570b3", "#c2408a")
OURS = "#1b6ca8"


def text(main: Sequence[Series], others: Sequence[Series], laws: Sequence[Law], seeds: int) -> str:
    """scaling.md."""
    cylinder = next(each for each in main if each.dimension == 3)
    lines = [
        "# Runout of columns over their aspect ratio",
        "",
        *paragraph(f"""
            `python -m validation.bench.columns.scaling --seeds {seeds}`. Columns of length (in 3D: cylinders of radius) L and height
            H = a L are let go on a rough floor and run out to d; a from 0.5 to 8. Dry sand: friction {FRICTION_DEG:g}°,
            grains and floor alike, no cohesion, no damping, E = {STIFFNESS:g} rho g H, step {STEP:g}. The planes of
            symmetry are smooth walls: half a column in 2D, a quarter of a cylinder in 3D, built of slabs (volume off by
            {100 * cylinder.volume_error:+.2f} %). {main[0].cells} cells across the smaller of L and H in 2D,
            {cylinder.cells} in 3D, 2 points per axis. No column comes near the far wall. A run ends when its kinetic
            energy is a thousandth of its maximum. The front holds 99.5 % of the points; the runout is the furthest
            point's; the height is that of the surface at the axis.
        """),
        "![runout and height over the aspect ratio](scaling.png)",
        "",
        *verdict(main, laws),
    ]
    for series in main:
        lines += [f"## {NAMES[series.dimension]}", "", *sides(series, laws), *points(series)]
    return "\n".join([*lines, *elsewhere(main, others)])


def verdict(main: Sequence[Series], laws: Sequence[Law]) -> list[str]:
    """Exponents against the published ones, and where ours deviate."""
    rows = []
    for series in main:
        for high in (False, True):
            there = [
                law for law in laws if (law.dimension, law.quantity, law.high) == (series.dimension, "runout", high)
            ]
            least, most = min(law.exponent for law in there), max(law.exponent for law in there)
            ours = [side(series, quantity, high=high).law for quantity in ("front", "runout")]
            rows.append(
                [
                    f"{NAMES[series.dimension]}, {span(high)}",
                    f"{least:.2f}" if least == most else f"{least:.2f} to {most:.2f}",
                    *(f"{law.exponent:.2f} ± {law.half_width:.2f}" for law in ours),
                    *(against(law, least, most) for law in ours),
                ]
            )
    (*_, a, b), (*_, y, z) = next(series for series in main if series.dimension == 3).of("front")
    last = math.log(z / y) / math.log(b / a)
    head = ["exponent of (d - L) / L", "published", "front", "furthest point", "front", "furthest point"]
    return [
        "## Verdict",
        "",
        *table(head, rows),
        "",
        *paragraph(f"""
            "holds": the published range is met within our half-width. **Tall columns in 2D** spread as everyone's do,
            with a prefactor between the experiments in channels, whose side walls brake (Lube, Lajeunesse), and those
            and the simulations without side walls (discs, rods). **Low columns in 2D**: the front's exponent is too
            large, the furthest point's hardly. A low column leaves most of itself in place and sends out a thin tongue,
            of which the quantile cuts off more the smaller a is; and the thinner the tongue, the more the grid brakes
            it. **Cylinders**: low ones agree in exponent and prefactor; tall ones are still on their way to the
            experiments' root, their local exponent falls with a, to {last:.2f} between the two tallest. **Heights** are
            a quarter above the experiments', with their exponent; the likely reason is that no grain rolls off the
            summit of a continuum. **Friction**: the experiments see none of it in their prefactors, we do (last table):
            a Mohr-Coulomb continuum on a floor as rough as the grains is braked by tan(phi) all the way. The grid adds
            to that: half the cells shorten the runouts of low columns by a sixth, by APIC's dissipation, which goes
            with the cell.
        """),
    ]


def against(law: PowerLaw, least: float, most: float) -> str:
    """Whether an exponent meets the published range."""
    off = max(least - law.exponent, law.exponent - most, 0.0)
    if off <= law.half_width:
        return "holds"
    return f"{'above' if law.exponent > most else 'below'} by {off:.2f}"


def span(high: bool) -> str:
    """Where a side is fitted."""
    return f"a >= {HIGH:g}" if high else f"a <= {LOW:g}"


def sides(series: Series, laws: Sequence[Law]) -> list[str]:
    """Our power laws on both sides of the break, and everyone else's."""
    rows = []
    for quantity, sort in (("front", "runout"), ("runout", "runout"), ("height", "height")):
        for high in (False, True):
            if quantity == "height" and not high:
                continue
            ours = side(series, quantity, high=high).law
            label = "h / L" if quantity == "height" else f"(d - L) / L, {quantity}"
            exponent = f"**{ours.exponent:.2f}** ± {ours.half_width:.2f}"
            rows.append([f"Talus: {label}", span(high), exponent, f"{ours.prefactor:.2f}", ""])
            for law in laws:
                if (law.dimension, law.quantity, law.high) == (series.dimension, sort, high) and quantity != "runout":
                    rows.append(published(series, quantity, law))
    head = ["", "aspect ratios", "exponent", "prefactor", "ours at this exponent"]
    return [
        *table(head, rows),
        "",
        *paragraph(f"""
            ± is the half-width at 95 % of the fitted exponent. The last column is the prefactor that our fronts (or
            heights) take with the exponent held at the published one, and its ratio to the published prefactor; a ratio
            beyond {1 / BAND:g} to {BAND:g} is marked.
        """),
    ]


def published(series: Series, quantity: str, law: Law) -> list[str]:
    """A line about one published law."""
    held = side(series, quantity, high=law.high).prefactor(law.exponent)
    ratio = "" if law.prefactor is None else f" ({held / law.prefactor:.2f} of it)"
    if law.prefactor is not None and not 1.0 / BAND <= held / law.prefactor <= BAND:
        ratio += " out of the band"
    aspects = " < ".join(
        part
        for part in (f"{law.above:g}" if law.above else "", "a", f"{law.below:g}" if math.isfinite(law.below) else "")
        if part
    )
    prefactor = "-" if law.prefactor is None else f"{law.prefactor:g}"
    return [law.source, aspects, f"{law.exponent:.3g}", prefactor, f"{held:.2f}{ratio}"]


def points(series: Series) -> list[str]:
    """What was measured; means over the seeds."""
    rows = []
    for aspect in sorted({each.aspect for each in series.deposits}):
        some = [each for each in series.deposits if each.aspect == aspect]
        rested = [each.rest_time for each in some if each.rest_time is not None]
        rows.append(
            [
                f"{aspect:.2f}",
                f"{np.mean([each.front for each in some]):.3f}",
                f"{np.mean([each.runout for each in some]):.3f}",
                f"{np.mean([each.height for each in some]):.3f}",
                f"{np.mean(rested):.1f}" if len(rested) == len(some) else "moving",
                *([f"{100 * np.mean([each.skew for each in some]):+.1f} %"] if series.dimension == 3 else []),
            ]
        )
    head = ["a", "front (d - L) / L", "runout (d - L) / L", "h / L", "at rest after, in sqrt(H / g)"]
    lines = [*table([*head, *(["walls over diagonal"] if series.dimension == 3 else [])], rows), ""]
    if series.dimension == 3:
        lines += paragraph("""
            The last column is how much further the front is along the walls than along the diagonal: what grid and
            corner do to a flow that should be round.
        """)
    return lines


def elsewhere(main: Sequence[Series], others: Sequence[Series]) -> list[str]:
    """The same fits on half the grid and at other angles of friction."""
    rows = []
    for each in (*main, *others):
        low, high = side(each, "front", high=False).law, side(each, "front", high=True).law
        rows.append(
            [
                NAMES[each.dimension],
                f"{each.cells}",
                f"{each.friction_deg:g}°",
                *(f"{law.prefactor:.2f} a^({law.exponent:.2f} ± {law.half_width:.2f})" for law in (low, high)),
            ]
        )
    return [
        "## Grid and friction",
        "",
        "The fronts' laws again, on half as many cells and at other angles of friction.",
        "",
        *table(["", "cells", "friction", span(False), span(True)], rows),
        "",
    ]


def draw(path: Path, main: Sequence[Series], laws: Sequence[Law]) -> None:
    """Fronts in 2D and 3D and heights in 2D over the aspect ratio, with the published laws as lines."""
    figure, axes = plt.subplots(1, 3, figsize=(14.5, 4.9), layout="constrained")
    flat, cylinder = main
    panels = (
        (flat, "front", "runout", "Half columns, 2D", "(d - L) / L"),
        (cylinder, "front", "runout", "Quarter cylinders, 3D", "(d - L) / L"),
        (flat, "height", "height", "Half columns, 2D", "h / L"),
    )
    for axis, (series, quantity, sort, title, label) in zip(axes, panels, strict=True):
        draw_laws(axis, [law for law in laws if (law.dimension, law.quantity) == (series.dimension, sort)])
        aspects, values = series.of(quantity)
        axis.plot(aspects, values, "o", color=OURS, markersize=5, label="Talus, front" if sort == "runout" else "Talus")
        if sort == "runout":
            axis.plot(*series.of("runout"), "o", color=OURS, markersize=4, mfc="none", mew=0.8, label="furthest point")
        for high in (False, True) if sort == "runout" else (True,):
            fitted = side(series, quantity, high=high).law
            ends = np.array([HIGH, 8.0]) if high else np.array([0.5, LOW])
            axis.plot(ends, fitted(ends), color=OURS, linewidth=1.0)
            note(axis, fitted, float(np.sqrt(ends[0] * ends[1])))
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.set_xticks([0.5, 1, 2, 4, 8], ["0.5", "1", "2", "4", "8"])
        ticks = [0.5, 1, 2, 5, 10, 20] if sort == "runout" else [0.5, 1, 2]
        axis.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
        axis.minorticks_off()
        axis.grid(color="#e6e6e6", linewidth=0.6)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
        axis.set_title(title, loc="left", fontsize=10)
        axis.set_xlabel("aspect ratio a = H / L")
        axis.set_ylabel(label)
        axis.legend(fontsize=7.5, frameon=False)
    with files.replacing(path) as part:
        figure.savefig(part, dpi=140)
    plt.close(figure)


def draw_laws(axis: Axes, laws: Sequence[Law]) -> None:
    """A colour per source; what has no prefactor cannot be drawn."""
    drawn = [law for law in laws if law.prefactor is not None]
    colours = dict(zip(dict.fromkeys(law.source for law in drawn), COLOURS, strict=False))
    seen = set[str]()
    for law in drawn:
        ends = np.array([max(law.above, 0.45), min(law.below, 9.0)])
        line = PowerLaw(prefactor=law.prefactor or 0.0, exponent=law.exponent)
        label = None if law.source in seen else law.source
        seen.add(law.source)
        axis.plot(ends, line(ends), "--", color=colours[law.source], linewidth=1.3, label=label)


def note(axis: Axes, law: PowerLaw, at: float) -> None:
    """The exponent beside its line."""
    place = float(law(np.array([at]))[0])
    label = f"{law.prefactor:.2f} $a^{{{law.exponent:.2f}}}$"
    axis.annotate(label, (at, place), xytext=(8, -18), textcoords="offset points", fontsize=8, color=OURS)
