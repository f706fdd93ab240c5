"""What `validation.bench.columns.codes` writes: fronts of columns by several codes, their differences, and a picture."""

import math
from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

from datasets import files
from inverse.report.markdown import table
from validation.bench.accuracy.page import paragraph, percent, signed
from validation.bench.accuracy.pictures import LINES, plain
from validation.bench.columns.collapse import FRICTION_DEG, STEP, STIFFNESS
from validation.bench.columns.fronts import Code, Front
from validation.bench.columns.scaling_laws import Law
from validation.report.machine import machine
from validation.report.power_law import fit

OURS, OUR_APIC = "Talus AFLIP", "Talus APIC"
STYLES = ("o-", "s-", "^--", "v--", "d:", "x:", "+:", "*:")
LOW, HIGH = 2.0, 2.0
"""Exponents are fitted to the aspect ratios up to the one and from the other."""
FITTED = 3
"""Aspect ratios that a fit takes at least."""


def text(fronts: Sequence[Front], codes: Sequence[Code], laws: Sequence[Law]) -> str:
    """peers.md."""
    lines = ["# Fronts of columns by several codes", "", *conclusion(fronts, laws)]
    lines += paragraph(f"""
        `python -m validation.bench.columns.codes --out docs`. Half columns of length L and height a L in plane strain on a floor of
        the grains' own friction, {FRICTION_DEG:g}°; dry, undamped, E = {STIFFNESS:g} rho g H, step {STEP:g} of
        cell / wave speed, 2 particles per axis, no volume correction; until the kinetic energy is a thousandth of its
        largest. All codes have the same cells, particles and step. The front is that of 99.5 % of the particles, as
        (d - L) / L; per cents are against Talus' default. Cells are counted across the smaller of L and H.
    """)
    lines += ["![fronts over the aspect ratio](peers.png)", ""]
    for cells in sorted({each.cells for each in fronts if each.name == OURS}):
        lines += [f"## {cells} cells", "", *beside(fronts, cells, laws)]
    lines += ["## Exponents", "", *exponents(fronts, laws), "## The other codes", ""]
    lines += [
        f"- {code.name}: github.com/{code.repository} at `{code.commit[:10]}`. {code.settings}." for code in codes
    ]
    return "\n".join([*lines, ""])


def conclusion(fronts: Sequence[Front], laws: Sequence[Law]) -> list[str]:
    """What was found, in a few lines, each from its numbers."""
    lines = []
    finest = max(each.cells for each in fronts if each.name == OURS)
    aspects = sorted({each.aspect for each in fronts})
    apic = sorted({each.name for each in fronts if each.transfer == "APIC" and each.name != OUR_APIC})
    for name in apic:
        off = [
            (cells, aspect, of(fronts, OUR_APIC, cells, aspect) / of(fronts, name, cells, aspect) - 1.0)
            for cells in sorted({each.cells for each in fronts})
            for aspect in aspects
        ]
        some = [each for each in off if not math.isnan(each[2])]
        if some:
            worst = max(some, key=lambda each: abs(each[2]))
            rms = math.sqrt(np.mean([value**2 for *_, value in some]))
            lines.append(
                f"- The same transfer: {OUR_APIC}'s fronts differ from {name}'s by {percent(rms)} rms over {len(some)}"
                f" columns, by {signed(worst[2])} at most (aspect ratio {worst[1]:g}, {worst[0]} cells)."
            )
    ratios = {
        aspect: of(fronts, OURS, finest, aspect) / of(fronts, OUR_APIC, finest, aspect) - 1.0 for aspect in aspects
    }
    parts = ", ".join(f"{signed(ratio)} at {aspect:g}" for aspect, ratio in ratios.items() if not math.isnan(ratio))
    lines.append(f"- The default, AFLIP with a relaxation time, against our APIC on {finest} cells: {parts}.")
    for name in (OURS, OUR_APIC):
        low, coarse = aspects[0], min(each.cells for each in fronts if each.name == OURS)
        change = of(fronts, name, finest, low) / of(fronts, name, coarse, low) - 1.0
        lines.append(
            f"- From {coarse} to {finest} cells {name}'s front at aspect ratio {low:g} moves by {signed(change)}."
        )
    for law in laws:
        if "Lube" in law.source and law.prefactor is not None:
            some_law = [
                of(fronts, OURS, finest, aspect) / (law.prefactor * aspect**law.exponent) - 1.0
                for aspect in aspects
                if law.above <= aspect <= law.below
            ]
            known = [value for value in some_law if not math.isnan(value)]
            if known:
                lines.append(
                    f"- Against {law.source}, {law.prefactor:g} a^{law.exponent:.2g}: {signed(min(known))} to"
                    f" {signed(max(known))} ({finest} cells)."
                )
    return [*lines, f"- Talus on {machine()}.", ""]


def of(fronts: Sequence[Front], name: str, cells: int, aspect: float) -> float:
    """The mean front over the jitters; nan of none."""
    some = [each.front for each in fronts if (each.name, each.cells, each.aspect) == (name, cells, aspect)]
    return float(np.mean(some)) if some else math.nan


def beside(fronts: Sequence[Front], cells: int, laws: Sequence[Law]) -> list[str]:
    """Fronts by code and aspect ratio, with the difference from ours."""
    aspects = sorted({each.aspect for each in fronts if each.cells == cells})
    rows = []
    for name in dict.fromkeys(each.name for each in fronts if each.cells == cells):
        row = [name]
        for aspect in aspects:
            value, own = of(fronts, name, cells, aspect), of(fronts, OURS, cells, aspect)
            scatter = [e.front for e in fronts if (e.name, e.cells, e.aspect) == (name, cells, aspect)]
            spread = f" ± {np.std(scatter, ddof=1):.2f}" if len(scatter) > 2 else ""
            against = f" ({signed(value / own - 1.0)})" if name != OURS and not math.isnan(own) else ""
            row.append("-" if math.isnan(value) else f"{value:.2f}{spread}{against}")
        rows.append(row)
    for law in laws:
        prefactor = law.prefactor
        if "Lube" in law.source and prefactor is not None:
            row = [f"{law.source}: {prefactor:g} a^{law.exponent:.2g}"]
            for aspect in aspects:
                value, own = prefactor * aspect**law.exponent, of(fronts, OURS, cells, aspect)
                row.append(f"{value:.2f} ({signed(value / own - 1.0)})" if law.above <= aspect <= law.below else "-")
            rows.append(row)
    return [*table(["", *(f"a = {aspect:g}" for aspect in aspects)], rows), ""]


def exponents(fronts: Sequence[Front], laws: Sequence[Law]) -> list[str]:
    """Exponents of the fronts over the aspect ratio by code, beside those of the experiments."""
    rows = []
    for name, cells in sorted({(each.name, each.cells) for each in fronts}):
        known = {a: of(fronts, name, cells, a) for a in sorted({each.aspect for each in fronts})}
        known = {aspect: value for aspect, value in known.items() if not math.isnan(value)}
        sides = (
            [aspect for aspect in known if aspect <= LOW],
            [aspect for aspect in known if aspect >= HIGH],
        )
        found = [
            f"{fit(np.array(side), np.array([known[a] for a in side])).exponent:.2f}" if len(side) >= FITTED else "-"
            for side in sides
        ]
        rows.append([f"{name}, {cells} cells", *found])
    for source in dict.fromkeys(law.source for law in laws if "Lube" in law.source or "Lajeunesse" in law.source):
        mine = {law.high: law.exponent for law in laws if law.source == source}
        rows.append([source, *(f"{mine[high]:.2f}" if high in mine else "-" for high in (False, True))])
    return [*table(["", f"exponent, a up to {LOW:g}", f"from {HIGH:g}"], rows), ""]


def draw(path: Path, fronts: Sequence[Front], laws: Sequence[Law]) -> None:
    """Fronts over the aspect ratio, a panel per grid, a line per code, with the laws of the experiments."""
    grids = sorted({each.cells for each in fronts if each.name == OURS})
    figure, axes = plt.subplots(
        1, len(grids), figsize=(6.0 * len(grids), 4.6), sharey=True, layout="constrained", squeeze=False
    )
    for axis, cells in zip(axes[0], grids, strict=True):
        names = list(dict.fromkeys(each.name for each in fronts if each.cells == cells))
        for number, name in enumerate(names):
            aspects = sorted({each.aspect for each in fronts if (each.name, each.cells) == (name, cells)})
            axis.plot(
                aspects,
                [of(fronts, name, cells, aspect) for aspect in aspects],
                STYLES[number % len(STYLES)],
                color=LINES[number % len(LINES)],
                markersize=4,
                linewidth=1.0,
                label=name,
            )
        for law in laws:
            if "Lube" in law.source and law.prefactor is not None:
                ends = np.array([max(law.above, 0.5), min(law.below, 8.0)])
                axis.plot(ends, law.prefactor * ends**law.exponent, color="#222222", label=law.source)
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.set_xticks([0.5, 1, 2, 4, 8], ["0.5", "1", "2", "4", "8"])
        axis.set_yticks([0.5, 1, 2, 5, 10], ["0.5", "1", "2", "5", "10"])
        plain(axis)
        axis.set_title(f"{cells} cells across the smaller side", loc="left", fontsize=10)
        axis.set_xlabel("aspect ratio a = H / L")
        axis.legend(fontsize=7, frameon=False)
    axes[0, 0].set_ylabel("front (d - L) / L")
    with files.replacing(path) as part:
        figure.savefig(part, dpi=140)
    plt.close(figure)
