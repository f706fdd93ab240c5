"""`python -m validation.bench scaling`: columns over their aspect ratio, beside experiments and other codes."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mpm import AT_REST
from validation.bench.columns.codes import Fronts, codes_conclusion, front_rows, fronts_of_all, grids, read_codes
from validation.bench.columns.collapse import (
    FRICTION_DEG,
    STEP,
    STIFFNESS,
    half_column,
    measured,
    quarter_cylinder,
    volume_error,
)
from validation.bench.columns.laws import HIGH, LARGEST, LOW, SMALLEST, Law, Series, read_laws
from validation.report.page import Page, Row, signed
from validation.report.plots import BLUE, GREEN, GREY, INK, ORANGE, figure
from validation.runs import Run, RunStore

ASPECTS = {
    2: tuple(0.5 * 2.0 ** (number / 3.0) for number in range(13)),
    3: tuple(0.5 * 2.0 ** (number / 2.0) for number in range(9)),
}
CELLS = {2: 32, 3: 14}
"""Across the smaller of length and height, by dimension."""
OTHER_ANGLES = (25.0, 35.0)
"""Angles of friction [deg], grains and floor alike, tried in 2D on half the cells."""
NAMES = {2: "2D", 3: "cylinder, 3D"}


def bench(out: Path, *, quick: bool, keep: Path, seeds: int = 2) -> str:
    """Runout and final height over aspect ratios 0.5 to 8, in 2D and of cylinders in 3D: scaling.md.

    quick: on an eighth of the cells in 2D, a third in 3D. seeds: jitters per column in 2D, but beside other codes.
    """
    store, cells = RunStore(keep), {2: 4, 3: 4} if quick else CELLS
    main = [collapse(store, 2, cells[2], seeds), collapse(store, 3, cells[3], 1)]
    others = [
        collapse(store, 2, cells[2] // 2, seeds),
        *(collapse(store, 2, cells[2] // 2, seeds, friction_deg=angle) for angle in OTHER_ANGLES),
        collapse(store, 3, cells[3] // 2, 1),
    ]
    return write(out, main, others, fronts_of_all(store, quick=quick), seeds, quick=quick)


def collapse(store: RunStore, dimension: int, cells: int, seeds: int, *, friction_deg: float = FRICTION_DEG) -> Series:
    """Half columns or quarters of cylinders, until they rest."""
    column = half_column if dimension == 2 else quarter_cylinder
    pairs = [(aspect, seed) for aspect in ASPECTS[dimension] for seed in range(seeds)]
    scenes = [column(aspect, cells, friction_deg=friction_deg, seed=seed) for aspect, seed in pairs]
    flows = store.run([Run(scene=scene, record=AT_REST) for scene in scenes])
    return Series(
        dimension=dimension,
        cells=cells,
        friction_deg=friction_deg,
        deposits=tuple(
            measured(aspect, flow.positions[-1], flow.summary["rest_time"])
            for (aspect, _), flow in zip(pairs, flows, strict=True)
        ),
        volume_error=max((volume_error(scene) for scene in scenes), key=abs) if dimension == 3 else 0.0,
    )


def write(
    out: Path, main: Sequence[Series], others: Sequence[Series], fronts: Fronts, seeds: int, *, quick: bool = False
) -> str:
    """Write scaling.md and its picture, and return the conclusion. main: in 2D, then in 3D; fronts: of all codes."""
    laws = read_laws()
    flat, cylinder = main
    page = Page(
        "Runout of columns over their aspect ratio",
        command=f"python -m validation.bench scaling --seeds {seeds} --out docs",
        conclusion=[*conclusion(flat, cylinder, others, laws), codes_conclusion(fronts)],
        quick=quick,
    )
    page.text(f"""
        Columns of length (in 3D: cylinders of radius) L and height H = a L are released on a rough floor and run out to
        d; a from {SMALLEST:g} to {LARGEST:g}. Dry sand: friction {FRICTION_DEG:g}°, grains and floor alike, without
        cohesion or damping, E = {STIFFNESS:g} rho g H, step {STEP:g}. The planes of symmetry are smooth walls: half a
        column in 2D, a quarter of a cylinder in 3D, built of slabs (volume off by
        {100.0 * cylinder.volume_error:+.2f} %). {flat.cells} cells across the smaller of L and H in 2D,
        {cylinder.cells} in 3D, 2 particles per axis. No column comes near the far wall. A run ends when its kinetic
        energy is a thousandth of its maximum. The front is that of 99.5 % of the particles; the runout is the furthest
        particle's; the height is that of the surface at the axis.
    """)
    draw(out / "scaling.png", main, laws)
    page.picture("scaling.png", "runout and height over the aspect ratio")
    page.section("Exponents")
    page.table(
        [
            {
                "exponent of (d - L) / L": f"{NAMES[series.dimension]}, {span(high)}",
                "published": published(series, laws, high=high),
                "front": exponent(series, "front", laws, high=high),
                "furthest particle": exponent(series, "runout", laws, high=high),
            }
            for series in main
            for high in (False, True)
        ]
    )
    page.text("""
        An exponent agrees where the published range is within its half-width at 95 %. Known causes of differences: side
        walls brake the experiments in channels (Lube, Lajeunesse), not those of discs and rods; a low column sends out
        a thin tongue, of which the quantile cuts off more the smaller a is and which the grid brakes; no grain rolls
        off the summit of a continuum; and a Mohr-Coulomb continuum on a floor as rough as its grains is braked by
        tan(phi), where the experiments' prefactors do not depend on the friction.
    """)
    for series in main:
        page.section(NAMES[series.dimension])
        page.table(law_rows(series, laws), formats=dict.fromkeys(LAW_HEADS, ""))
        page.text("""
            ± is the half-width at 95 % of the fitted exponent. The last columns are the prefactor of our fronts (or
            heights) with the exponent held at the published one, and its ratio to the published prefactor.
        """)
        page.table(deposit_rows(series))
        if series.dimension == 3:
            page.text("""
                The last column is how much further the front is along the walls than along the diagonal: the effect of
                grid and corner on a flow that should be round.
            """)
    page.section("Grid and friction")
    page.text("The fronts' laws again, on half as many cells and at other angles of friction.")
    page.table(
        [
            {
                "": NAMES[each.dimension],
                "cells": each.cells,
                "friction": f"{each.friction_deg:g}°",
                **{
                    span(high): f"{law.prefactor:.2f} a^({law.exponent:.2f} ± {law.half_width:.2f})"
                    for high, law in ((high, each.fit("front", high=high)) for high in (False, True))
                },
            }
            for each in (*main, *others)
        ]
    )
    page.section("Other codes")
    page.text("""
        Fronts of the half columns of 30°, (d - L) / L, by other codes with the same cells, particles and step, without
        volume correction; per cents are against Talus' default, AFLIP with a relaxation time.
    """)
    for cells in grids(fronts):
        page.text(f"{cells} cells across the smaller of L and H:")
        page.table(front_rows(fronts, cells))
    page.text(
        "\n".join(
            f"- {code.name}: github.com/{code.repository} at `{code.commit[:10]}`. {code.settings}."
            for code in read_codes().codes
        )
    )
    return page.write(out / "scaling.md")


def conclusion(flat: Series, cylinder: Series, others: Sequence[Series], laws: Sequence[Law]) -> list[str]:
    """What was found, each sentence from its numbers."""
    lines = []
    for series in (flat, cylinder):
        parts = [
            f"{exponent(series, 'front', laws, high=high)}"
            f" (published {published(series, laws, high=high)}, {span(high)})"
            for high in (False, True)
        ]
        lines.append(f"**{NAMES[series.dimension]}**: the front's exponent is {'; '.join(parts)}.")
    parts = []
    for quantity, kind in (("front", "runout"), ("height", "height")):
        ratios = [
            series.prefactor(quantity, law) / law.prefactor
            for series in (flat, cylinder)
            for law in laws
            if (law.dimension, law.quantity) == (series.dimension, kind) and law.prefactor is not None
        ]
        parts.append(f"{quantity}s are {min(ratios):.2f} to {max(ratios):.2f}")
    lines.append(f"At the published exponents our {', our '.join(parts)} of the published.")
    in_2d = sorted((each for each in others if each.dimension == 2), key=lambda each: each.friction_deg)
    half = next(each for each in in_2d if each.friction_deg == flat.friction_deg)
    lines.append(
        f"**Grid and friction**, 2D, low and tall columns: half the cells change the front's prefactor by"
        f" {changes(flat, half)}; from {in_2d[0].friction_deg:g}° to {in_2d[-1].friction_deg:g}° it changes by"
        f" {changes(in_2d[0], in_2d[-1])}."
    )
    return lines


def changes(first: Series, second: Series) -> str:
    """Changes of the front's prefactor, of low and of tall columns."""
    return " and ".join(
        signed(second.fit("front", high=high).prefactor / first.fit("front", high=high).prefactor - 1.0)
        for high in (False, True)
    )


def exponents(series: Series, laws: Sequence[Law], *, high: bool) -> list[float]:
    """The published exponents of the runout, ascending."""
    of_series = (series.dimension, "runout", high)
    return sorted(law.exponent for law in laws if (law.dimension, law.quantity, law.high) == of_series)


def published(series: Series, laws: Sequence[Law], *, high: bool) -> str:
    """The range of the published exponents."""
    some = exponents(series, laws, high=high)
    return " to ".join(dict.fromkeys(f"{each:.2f}" for each in (some[0], some[-1])))


def exponent(series: Series, quantity: str, laws: Sequence[Law], *, high: bool) -> str:
    """An exponent, and whether it agrees with the published range within its half-width."""
    law, some = series.fit(quantity, high=high), exponents(series, laws, high=high)
    off = max(some[0] - law.exponent, law.exponent - some[-1], 0.0)
    way = "agrees" if off <= law.half_width else f"{'above' if law.exponent > some[-1] else 'below'} by {off:.2f}"
    return f"{law.exponent:.2f} ± {law.half_width:.2f}, {way}"


def span(high: bool) -> str:
    """The aspect ratios of low or of tall columns."""
    return f"a >= {HIGH:g}" if high else f"a <= {LOW:g}"


LAW_HEADS = ("", "aspect ratios", "exponent", "prefactor", "ours at this exponent", "ratio")


def law_rows(series: Series, laws: Sequence[Law]) -> list[Row]:
    """Our power laws of low and of tall columns, and the published ones."""
    rows: list[Row] = []
    for quantity, high in (("front", False), ("front", True), ("runout", False), ("runout", True), ("height", True)):
        ours, label = series.fit(quantity, high=high), "h / L" if quantity == "height" else f"(d - L) / L, {quantity}"
        width = f"**{ours.exponent:.2f}** ± {ours.half_width:.2f}"
        rows.append((f"Talus: {label}", span(high), width, f"{ours.prefactor:.2f}", None, None))
        kind = {"front": "runout", "height": "height"}.get(quantity)
        for law in laws:
            if (law.dimension, law.quantity, law.high) == (series.dimension, kind, high):
                held = series.prefactor(quantity, law)
                known = ("-", None) if law.prefactor is None else (f"{law.prefactor:g}", f"{held / law.prefactor:.2f}")
                rows.append((law.source, law.range, f"{law.exponent:.3g}", known[0], f"{held:.2f}", known[1]))
    return rows


def deposit_rows(series: Series) -> list[Row]:
    """The measured deposits; means over the jitters."""
    rows: list[Row] = []
    for aspect in sorted({each.aspect for each in series.deposits}):
        some = [each for each in series.deposits if each.aspect == aspect]
        rest = [math.nan if each.rest_time is None else each.rest_time for each in some]
        row = {"a": f"{aspect:.2f}"}
        for quantity, head in (("front", "front (d - L) / L"), ("runout", "runout (d - L) / L"), ("height", "h / L")):
            row[head] = f"{np.mean([getattr(each, quantity) for each in some]):.3f}"
        row["at rest after, in sqrt(H / g)"] = "moving" if np.isnan(rest).any() else f"{np.mean(rest):.1f}"
        if series.dimension == 3:
            row["walls over diagonal"] = signed(float(np.mean([each.skew for each in some])))
        rows.append(row)
    return rows


def draw(path: Path, main: Sequence[Series], laws: Sequence[Law]) -> None:
    """Fronts in 2D and 3D and heights in 2D over the aspect ratio, with the published laws as lines."""
    flat, cylinder = main
    panes = (
        (flat, "front", "Half columns, 2D"),
        (cylinder, "front", "Quarter cylinders, 3D"),
        (flat, "height", "Half columns, 2D"),
    )
    with figure(path, columns=3, size=(4.8, 4.9)) as axes:
        for axis, (series, quantity, title) in zip(axes[0], panes, strict=True):
            of_front = quantity == "front"
            kind = "runout" if of_front else "height"
            colours = dict[str, str]()
            for law in laws:
                if (law.dimension, law.quantity) == (series.dimension, kind) and law.prefactor is not None:
                    label = None if law.source in colours else law.source
                    colour = colours.setdefault(law.source, (INK, ORANGE, GREEN, GREY)[len(colours)])
                    ends = np.array([max(law.above, SMALLEST), min(law.below, LARGEST)])
                    line = law.prefactor * ends**law.exponent
                    axis.plot(ends, line, "--", color=colour, linewidth=1.3, label=label)
            axis.plot(*series.values(quantity), "o", color=BLUE, markersize=5, label=f"Talus, {quantity}")
            if of_front:
                axis.plot(
                    *series.values("runout"), "o", color=BLUE, markersize=4, mfc="none", label="furthest particle"
                )
            for high in (False, True) if of_front else (True,):
                ours = series.fit(quantity, high=high)
                ends = np.array([HIGH, LARGEST] if high else [SMALLEST, LOW])
                axis.plot(ends, ours(ends), color=BLUE, linewidth=1.0)
                middle = np.array([math.sqrt(ends[0] * ends[1])])
                axis.annotate(
                    f"{ours.prefactor:.2f} $a^{{{ours.exponent:.2f}}}$",
                    (middle[0], ours(middle)[0]),
                    xytext=(8, -18),
                    textcoords="offset points",
                    color=BLUE,
                )
            axis.set(title=title, ylabel="(d - L) / L" if of_front else "h / L")
            axis.set(xscale="log", yscale="log", xlabel="aspect ratio a = H / L")
            ticks = (0.5, 1, 2, 5, 10, 20) if of_front else (0.5, 1, 2)
            axis.set_xticks([0.5, 1, 2, 4, 8], ["0.5", "1", "2", "4", "8"])
            axis.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
            axis.minorticks_off()
            axis.legend()
