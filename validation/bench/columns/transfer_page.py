"""What `validation.bench.columns.transfer` writes: tables of fronts, whether bars are met, and a picture."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

from datasets import files
from datasets.measures import front
from datasets.trajectory import Trajectory
from inverse.report.markdown import table
from validation.bench.accuracy.page import paragraph, percent, signed
from validation.bench.accuracy.pictures import LINES, plain
from validation.bench.columns.transfer_cases import CUBE, LENGTH, NEVER, USUAL, YOUNG, Case, Plan
from validation.report.machine import machine

NAMES = {1.0: "AFLIP, default", 0.0: "APIC"}
"""Of the transfers that stand beside each other, by relaxation time over the default one."""
SPREAD_BARS = (0.03, 0.015)
"""Of the fronts over stiffness, step and output, on the coarse and on the fine grid."""
CONVERGENCE_BARS = {20: 0.04, 40: 0.015}
"""Of a front against the finest grid's, by cells across."""


@dataclass(frozen=True, kw_only=True)
class Figures:
    """What is read from a run."""

    front: float
    """[m]."""
    kinetic: float
    """Kinetic energy at the end over its largest [-]."""
    rise: float
    """Largest rise of the total energy above its lowest value before, over what was released in all [-]."""


Found = Mapping[Case, Figures]


def figures(flow: Trajectory) -> Figures:
    """The front and energies of a run."""
    energy = {name: np.array(values) for name, values in flow.summary["energy"].items()}
    total = energy["kinetic"] + energy["potential"] + energy["elastic"]
    rise = float((total - np.minimum.accumulate(total)).max())
    return Figures(
        front=front(flow.positions[-1]),
        kinetic=float(energy["kinetic"][-1] / energy["kinetic"].max()),
        rise=rise / float(total[0] - total[-1]),
    )


def spread(cases: Iterable[Case], found: Found) -> float:
    """Largest less smallest front over their mean [-]."""
    fronts = [found[case].front for case in cases]
    return (max(fronts) - min(fronts)) / float(np.mean(fronts))


def mean(cases: Sequence[Case], found: Found) -> float:
    """Mean front [m]."""
    return float(np.mean([found[case].front for case in cases]))


def verdict(value: float, bar: float) -> str:
    """Whether a bar is met."""
    return f"bar {percent(bar)}, {'met' if value <= bar else '**missed**'}"


def text(plan: Plan, found: Found) -> str:
    """transfer.md."""
    return "\n".join(
        [
            "# The transfer: fronts over stiffness, step, output, cell and relaxation time",
            "",
            *conclusion(plan, found),
            *paragraph("""
                `python -m validation.bench.columns.transfer --out docs`. In 2D a dry column 0.2 m long and 0.4 m high, 30°, floor
                friction 0.385, smooth walls, undamped, 1.5 s; in 3D a quarter of a dry square column of 30°, as high as
                long, between two smooth walls, for 5 sqrt(H/g); 2 particles per axis, single precision. The front is
                the x that 99.5 % of the particles are behind. A spread is the largest front less the smallest, over
                their mean. The default transfer is AFLIP with a relaxation time of 0.5 sqrt(cell / g); APIC is
                a relaxation time of 0 (`mpm/physics/transfer.py`).
            """),
            "![fronts over stiffness and over the cell](transfer.png)",
            "",
            "## Stiffness, step and interval of output",
            "",
            *grids(plan, found),
            "## The cell",
            "",
            *convergence(plan, found),
            "## The relaxation time",
            "",
            *relaxation(plan, found),
            "## Volume correction",
            "",
            *correction(plan, found),
            "## In 3D",
            "",
            *solid(plan, found),
        ]
    )


def conclusion(plan: Plan, found: Found) -> list[str]:
    """What was found, a sentence a bar."""
    lines = []
    for cells, bar in zip((plan.coarse, plan.fine), SPREAD_BARS, strict=True):
        ours, apic = (spread(plan.grid(cells, each), found) for each in NAMES)
        lines.append(
            f"- On {cells} cells across the column, fronts spread by {percent(ours)} over stiffness, step and output"
            f" ({verdict(ours, bar)}); APIC's by {percent(apic)}."
        )
    for cells in plan.cells[:-1]:
        off, apic = (deviation(cells, plan, found, each) for each in NAMES)
        judged = f" ({verdict(abs(off), CONVERGENCE_BARS[cells])})" if cells in CONVERGENCE_BARS else ""
        lines.append(
            f"- On {cells} cells the front is {signed(off)} from that on {plan.cells[-1]}{judged};"
            f" APIC's {signed(apic)}."
        )
    for cells, bar in zip(plan.cells_3d, SPREAD_BARS, strict=True):
        ours, apic = (spread(plan.grid_3d(cells, each), found) for each in NAMES)
        lines.append(
            f"- In 3D, on {cells} cells, fronts spread by {percent(ours)} over stiffness and step"
            f" ({verdict(ours, bar)}); APIC's by {percent(apic)}."
        )
    some = [case for case in plan.relaxed(plan.coarse) if 0.0 < case.relaxation < NEVER]
    changes = ", ".join(f"{case.relaxation:g}" for case in some)
    pairs = [plan.corrected()[k : k + 2] for k in range(0, len(plan.corrected()), 2)]
    moved = max((abs(found[on].front / found[off].front - 1.0) for off, on in pairs if off.relaxation == 1.0))
    lines += [
        f"- Over {changes} times the default relaxation time fronts spread by {percent(spread(some, found))};"
        f" volume correction moves a front by {percent(moved)} at most.",
        f"- {machine()}.",
        "",
    ]
    return lines


def deviation(cells: int, plan: Plan, found: Found, relaxation: float) -> float:
    """The mean front over the jitters against the finest grid's, over the latter [-]."""
    finest = mean(plan.convergence(plan.cells[-1], relaxation), found)
    return mean(plan.convergence(cells, relaxation), found) / finest - 1.0


def grids(plan: Plan, found: Found) -> list[str]:
    """Fronts over stiffness x step x interval, both transfers side by side, on both grids."""
    lines = []
    for cells in (plan.coarse, plan.fine):
        tried = {each: list(plan.grid(cells, each)) for each in NAMES}
        intervals = {each: sorted({case.interval for case in tried[each]}) for each in NAMES}
        kinds = dict.fromkeys((case.stiffness, case.step) for case in tried[1.0] + tried[0.0])
        rows = []
        for stiffness, step in kinds:
            row = [f"{YOUNG * stiffness:.0e}", f"{step:g}"]
            for each in NAMES:
                here = {c.interval: found[c].front for c in tried[each] if (c.stiffness, c.step) == (stiffness, step)}
                row += [f"{here[interval]:.3f}" if interval in here else "-" for interval in intervals[each]]
            rows.append(row)
        heads = [f"{name}, {1000 * interval:g} ms" for each, name in NAMES.items() for interval in intervals[each]]
        lines += [
            f"Fronts [m] on {cells} cells across the column ({1000 * LENGTH / cells:g} mm), by interval of output:",
            "",
            *table(["E [Pa]", "step", *heads], rows),
            "",
        ]
    return lines


def convergence(plan: Plan, found: Found) -> list[str]:
    """Fronts over the cells."""
    rows = []
    for cells in plan.cells:
        row = [f"{cells}", f"{1000 * LENGTH / cells:g} mm"]
        for each in NAMES:
            cases = plan.convergence(cells, each)
            fronts = [found[case].front for case in cases]
            scatter = f" ± {np.std(fronts, ddof=1):.3f}" if len(fronts) > 1 else ""
            row += [f"{np.mean(fronts):.3f}{scatter}", signed(deviation(cells, plan, found, each))]
        rows.append(row)
    heads = [part for name in NAMES.values() for part in (f"front, {name} [m]", "against the finest")]
    return [
        f"E = {YOUNG:.0e} Pa, step 0.9; ± the standard deviation over jitters ({', '.join(map(str, plan.seeds))}):",
        "",
        *table(["cells across", "cell", *heads], rows),
        "",
    ]


def relaxation(plan: Plan, found: Found) -> list[str]:
    """Front and energies over the relaxation time."""
    rows = []
    for cells in (plan.coarse, plan.fine):
        for case in plan.relaxed(cells):
            here = found[case]
            name = {0.0: "0 (APIC)", 1.0: "1 (default)", NEVER: "infinite"}.get(case.relaxation)
            rows.append(
                [
                    f"{cells}",
                    name or f"{case.relaxation:g}",
                    f"{here.front:.3f}",
                    f"{here.kinetic:.1e}",
                    percent(here.rise),
                ]
            )
    head = ["cells across", "relaxation time over the default", "front [m]", "kinetic energy at 1.5 s over its largest"]
    return [
        *table([*head, "rise of the energy"], rows),
        "",
        *paragraph("""
            The rise is the largest one of kinetic, potential and elastic energy together above their lowest value
            before, over what the flow has released in all.
        """),
    ]


def correction(plan: Plan, found: Found) -> list[str]:
    """Fronts with and without volume correction."""
    cases = plan.corrected()
    rows = [
        [
            f"{off.cells}",
            NAMES[off.relaxation],
            f"{found[off].front:.3f}",
            f"{found[on].front:.3f}",
            signed(found[on].front / found[off].front - 1.0),
        ]
        for off, on in zip(cases[::2], cases[1::2], strict=True)
    ]
    return [*table(["cells across", "transfer", "front, off [m]", "front, on [m]", "difference"], rows), ""]


def solid(plan: Plan, found: Found) -> list[str]:
    """Fronts over stiffness x step in 3D."""
    rows = []
    for cells in plan.cells_3d:
        tried = {each: {(c.stiffness, c.step): c for c in plan.grid_3d(cells, each)} for each in NAMES}
        for stiffness, step in tried[1.0]:
            pair = [found[tried[each][stiffness, step]].front for each in NAMES]
            rows.append(
                [f"{cells}", f"{CUBE.stiffness * stiffness:g}", f"{step:g}", *(f"{value:.4f}" for value in pair)]
            )
    return [*table(["cells across", "E / (rho g H)", "step", *(f"{name} [m]" for name in NAMES.values())], rows), ""]


def draw(path: Path, plan: Plan, found: Found) -> None:
    """Fronts over stiffness, a line per step and transfer; and over the cells."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(11.0, 4.4), layout="constrained")
    for each, name in NAMES.items():
        style = "o-" if each else "s--"
        for step, colour in zip(plan.steps, LINES, strict=False):
            some = [c for c in plan.grid(plan.coarse, each) if (c.step, c.interval) == (step, USUAL)]
            left.plot(
                [YOUNG * c.stiffness for c in some],
                [found[c].front for c in some],
                style,
                color=colour,
                markersize=4,
                linewidth=1.0,
                label=f"{name}, step {step:g}",
            )
        fronts = [mean(plan.convergence(cells, each), found) for cells in plan.cells]
        right.plot(plan.cells, fronts, style, color=LINES[0 if each else 1], label=name)
    left.set_xlabel(f"Young's modulus [Pa], {plan.coarse} cells across the column")
    left.set_ylabel("front [m]")
    right.set_xlabel("cells across the column")
    right.set_xticks(plan.cells, [f"{cells}" for cells in plan.cells])
    for axis in (left, right):
        axis.set_xscale("log")
        axis.set_ylim(bottom=0.0)
        plain(axis)
        axis.legend(fontsize=8, frameon=False)
    right.set_xticks(plan.cells, [f"{cells}" for cells in plan.cells])
    with files.replacing(path) as part:
        figure.savefig(part, dpi=140)
    plt.close(figure)
