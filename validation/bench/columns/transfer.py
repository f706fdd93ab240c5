"""`python -m validation.bench transfer`: fronts over stiffness, step, output, cell and relaxation time."""

import dataclasses
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from datasets.material import Material
from datasets.measures import front
from datasets.scene import Domain, Mass, Scene
from datasets.trajectory import Trajectory
from mpm.resolution import Resolution, particle_steps, with_resolution
from validation.bench.accuracy.flows import Flow
from validation.report.page import Page, Row, percent, signed
from validation.report.plots import BLUE, GREEN, ORANGE, figure
from validation.runs import Run, RunStore

YOUNG = 2.0e6
"""Young's modulus of the column in 2D at stiffness 1 [Pa]."""
LENGTH, HEIGHT = 0.2, 0.4
"""Of the column in 2D [m]."""
CUBE = Flow(aspect=1.0, friction_deg=30.0, depth=1.0, box=6.0, duration=5.0)
"""The column in 3D: a quarter of a square one, 0.1 m high, between two smooth walls of symmetry."""
USUAL = 0.0025
"""Interval of output [s]."""
DEFAULT, APIC = 1.0, 0.0
"""Relaxation times over the default one; that of 0 is APIC."""
INFINITE = 1.0e6
"""A relaxation time in which nothing decays within a flow, over the default one."""
NAMES = {DEFAULT: "AFLIP, default", APIC: "APIC"}
SPREAD_CRITERIA = (0.03, 0.015)
"""Of the fronts over stiffness, step and output, on the coarse and on the fine grid."""
CONVERGENCE_CRITERIA = {20: 0.04, 40: 0.015}
"""Of a front against the finest grid's, by cells across."""


@dataclass(frozen=True, kw_only=True)
class Column:
    """A dry column of 30 degrees, and how it is computed."""

    dimension: int = 2
    cells: int = 10
    """Across its length."""
    stiffness: float = 1.0
    """Young's modulus over that of the softest column."""
    step: float = 0.9
    """As a fraction of cell / wave speed."""
    interval: float = USUAL
    """Between two frames of output in 2D [s]."""
    relaxation: float = DEFAULT
    """Relaxation time over the default one."""
    corrected: bool = False
    """With volume correction."""
    seed: int = 0

    def scene(self) -> Scene:
        """In 2D 0.2 x 0.4 m at a smooth wall, on a floor of friction 0.385, for 1.5 s; in 3D `CUBE`."""
        if self.dimension == 2:
            scene = Scene(
                domain=Domain(size=(1.6, 0.6), cell=LENGTH / self.cells),
                material=Material(friction_deg=30.0, young=YOUNG * self.stiffness),
                masses=(Mass(lower=(0.0, 0.0), size=(LENGTH, HEIGHT)),),
                duration=1.5,
                frame_dt=self.interval,
                floor_friction=0.385,
            )
        else:
            stiff = dataclasses.replace(CUBE, stiffness=CUBE.stiffness * self.stiffness).scene()
            scene = with_resolution(
                stiff, Resolution(cells=self.cells, particles_per_axis=2, step_fraction=self.step, precision="f32")
            )
        return dataclasses.replace(
            scene,
            relaxation_time=None if self.relaxation == DEFAULT else self.relaxation * scene.relaxation,
            volume_correction=self.corrected,
            step_fraction=self.step,
            seed=self.seed,
        )


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Which columns are run."""

    coarse: int = 10
    """Cells across the column in 2D where all stiffnesses and steps are tried ..."""
    fine: int = 20
    """... and where some are: up to `most_fine`."""
    stiffnesses: tuple[float, ...] = (1.0, 10.0, 100.0, 1000.0)
    steps: tuple[float, ...] = (0.9, 0.3, 0.1)
    intervals: tuple[float, ...] = (0.001, 0.0025, 0.005, 0.01)
    most_intervals: tuple[float, float] = (1.0e8, 3.0e7)
    """Particle-steps up to which intervals other than the usual one are tried, by the default and by APIC."""
    most_fine: float = 2.5e8
    """Particle-steps up to which stiffnesses and steps are tried on the fine cells."""
    cells: tuple[int, ...] = (10, 20, 40, 80)
    """Of the convergence; the last is the reference."""
    seeds: tuple[int, ...] = (4, 4, 2, 1)
    """Of each of these."""
    relaxations: tuple[float, ...] = (APIC, 0.25, DEFAULT, 2.0, 4.0, INFINITE)
    cells_3d: tuple[int, ...] = (6, 12)
    stiffnesses_3d: tuple[float, ...] = (1.0, 10.0, 100.0)
    steps_3d: tuple[float, ...] = (0.9, 0.1)
    most_3d: float = 1.5e8
    """The same in 3D."""

    def grid(self, cells: int, relaxation: float) -> Iterator[Column]:
        """Stiffness x step x interval of output in 2D."""
        for stiffness, step, interval in product(self.stiffnesses, self.steps, self.intervals):
            column = Column(cells=cells, stiffness=stiffness, step=step, interval=interval, relaxation=relaxation)
            most = self.most_intervals[relaxation == APIC] if interval != USUAL else math.inf
            if cells != self.coarse:
                most = self.most_fine if interval == USUAL else 0.0
            if particle_steps(column.scene()) <= most:
                yield column

    def grid_3d(self, cells: int, relaxation: float) -> Iterator[Column]:
        """Stiffness x step in 3D."""
        for stiffness, step in product(self.stiffnesses_3d, self.steps_3d):
            column = Column(dimension=3, cells=cells, stiffness=stiffness, step=step, relaxation=relaxation)
            if particle_steps(column.scene()) <= self.most_3d:
                yield column

    def convergence(self, cells: int, relaxation: float) -> list[Column]:
        """One column a jitter on a grid of the convergence."""
        count = self.seeds[self.cells.index(cells)]
        return [Column(cells=cells, relaxation=relaxation, seed=seed) for seed in range(count)]

    def relaxed(self, cells: int) -> list[Column]:
        """Relaxation times in 2D."""
        return [Column(cells=cells, relaxation=each) for each in self.relaxations]

    def corrected(self) -> list[tuple[Column, Column]]:
        """Without and with volume correction, by the default and by APIC, on both grids."""
        plain = [Column(cells=cells, relaxation=each) for cells in (self.coarse, self.fine) for each in (DEFAULT, APIC)]
        return [(column, dataclasses.replace(column, corrected=True)) for column in plain]

    def columns(self) -> list[Column]:
        """All of them, each once."""
        every = [column for pair in self.corrected() for column in pair]
        for relaxation in (DEFAULT, APIC):
            for cells in (self.coarse, self.fine):
                every += self.grid(cells, relaxation)
            for cells in self.cells:
                every += self.convergence(cells, relaxation)
            for cells in self.cells_3d:
                every += self.grid_3d(cells, relaxation)
        for cells in (self.coarse, self.fine):
            every += self.relaxed(cells)
        return list(dict.fromkeys(every))


QUICK = Plan(
    coarse=5,
    fine=10,
    stiffnesses=(1.0, 10.0),
    steps=(0.9, 0.3),
    intervals=(0.0025, 0.01),
    cells=(5, 10),
    seeds=(2, 1),
    relaxations=(APIC, DEFAULT, INFINITE),
    cells_3d=(4, 5),
    stiffnesses_3d=(1.0, 10.0),
    steps_3d=(0.9, 0.3),
)


@dataclass(frozen=True, kw_only=True)
class Figures:
    """Of a run."""

    front: float
    """[m]."""
    kinetic: float
    """Kinetic energy at the end over its largest [-]."""
    rise: float
    """Largest rise of the total energy above its lowest value before, over what was released in all [-]."""


Found = Mapping[Column, Figures]


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


def spread(columns: Iterable[Column], found: Found) -> float:
    """Largest less smallest front over their mean [-]."""
    fronts = [found[column].front for column in columns]
    return (max(fronts) - min(fronts)) / float(np.mean(fronts))


def mean(columns: Sequence[Column], found: Found) -> float:
    """Mean front [m]."""
    return float(np.mean([found[column].front for column in columns]))


def deviation(cells: int, plan: Plan, found: Found, relaxation: float) -> float:
    """The mean front over the jitters against the finest grid's, over the latter [-]."""
    finest = mean(plan.convergence(plan.cells[-1], relaxation), found)
    return mean(plan.convergence(cells, relaxation), found) / finest - 1.0


def bench(out: Path, *, quick: bool, keep: Path) -> str:
    """The front of a dry column over stiffness, step, output, cell and relaxation time, beside APIC's: transfer.md.

    quick: coarse grids and few columns.
    """
    plan = QUICK if quick else Plan()
    columns = plan.columns()
    flows = RunStore(keep).run([Run(scene=column.scene()) for column in columns])
    return write(out, plan, {column: figures(flow) for column, flow in zip(columns, flows, strict=True)}, quick=quick)


def write(out: Path, plan: Plan, found: Found, *, quick: bool = False) -> str:
    """Write transfer.md and its picture, and return the conclusion."""
    page = Page(
        "Transfer: fronts over stiffness, step, output, cell and relaxation time",
        command="python -m validation.bench transfer --out docs",
        conclusion=conclusion(plan, found),
        quick=quick,
    )
    page.text("""
        In 2D a dry column 0.2 m long and 0.4 m high, 30°, floor friction 0.385, smooth walls, undamped, 1.5 s; in 3D a
        quarter of a dry square column of 30°, as high as long, between two smooth walls, for 5 sqrt(H/g); 2 particles
        per axis, single precision. The front is the x that 99.5 % of the particles are behind. A spread is the largest
        front less the smallest, over their mean. The default transfer is AFLIP with a relaxation time of
        0.5 sqrt(cell / g); APIC is a relaxation time of 0 (`mpm/physics/transfer.py`).
    """)
    draw(out / "transfer.png", plan, found)
    page.picture("transfer.png", "fronts over stiffness and over the cell")
    page.section("Stiffness, step and interval of output")
    for cells in (plan.coarse, plan.fine):
        page.text(f"Fronts [m] on {cells} cells across the column ({1000 * LENGTH / cells:g} mm), by output interval:")
        page.table(grid_rows(cells, plan, found))
    page.section("Cell")
    jitters = ", ".join(map(str, plan.seeds))
    page.text(f"E = {YOUNG:.0e} Pa, step 0.9; ± the standard deviation over jitters ({jitters}):")
    page.table([convergence_row(cells, plan, found) for cells in plan.cells])
    page.section("Relaxation time")
    names = {APIC: "0 (APIC)", DEFAULT: "1 (default)", INFINITE: "infinite"}
    page.table(
        [
            (cells, names.get(each.relaxation, f"{each.relaxation:g}"), *vars(found[each]).values())
            for cells in (plan.coarse, plan.fine)
            for each in plan.relaxed(cells)
        ],
        formats={
            "cells across": "",
            "relaxation time over the default": "",
            "front [m]": ".3f",
            "kinetic energy at 1.5 s over its largest": ".1e",
            "rise of the energy": percent,
        },
    )
    page.text("""
        The rise is the largest one of kinetic, potential and elastic energy together above their lowest value before,
        over what the flow has released in all.
    """)
    page.section("Volume correction")
    page.table(
        [
            (
                off.cells,
                NAMES[off.relaxation],
                found[off].front,
                found[on].front,
                found[on].front / found[off].front - 1,
            )
            for off, on in plan.corrected()
        ],
        formats={
            "cells across": "",
            "transfer": "",
            "front, off [m]": ".3f",
            "front, on [m]": ".3f",
            "difference": signed,
        },
    )
    page.section("3D")
    pairs = [
        (default, apic)
        for cells in plan.cells_3d
        for default in plan.grid_3d(cells, DEFAULT)
        for apic in plan.grid_3d(cells, APIC)
        if (apic.stiffness, apic.step) == (default.stiffness, default.step)
    ]
    page.table(
        [(a.cells, CUBE.stiffness * a.stiffness, a.step, found[a].front, found[b].front) for a, b in pairs],
        formats={"cells across": "", "E / (rho g H)": "g", "step": "g"}
        | {f"{each} [m]": ".4f" for each in NAMES.values()},
    )
    return page.write(out / "transfer.md")


def conclusion(plan: Plan, found: Found) -> list[str]:
    """What was found, each sentence from its numbers."""
    lines = []
    for dimension, grids, grid in (("2D", (plan.coarse, plan.fine), plan.grid), ("3D", plan.cells_3d, plan.grid_3d)):
        parts = []
        for cells, limit in zip(grids, SPREAD_CRITERIA, strict=True):
            ours, apic = (spread(grid(cells, each), found) for each in NAMES)
            parts.append(f"{percent(ours)} on {cells} cells across ({criterion(ours, limit)}; APIC's {percent(apic)})")
        over = "stiffness, step and output" if dimension == "2D" else "stiffness and step"
        lines.append(f"**{dimension}**: over {over} the fronts spread by {', '.join(parts)}.")
    parts = []
    for cells in plan.cells[:-1]:
        ours, apic = (deviation(cells, plan, found, each) for each in NAMES)
        result = f"{criterion(abs(ours), CONVERGENCE_CRITERIA[cells])}; " if cells in CONVERGENCE_CRITERIA else ""
        parts.append(f"{signed(ours)} on {cells} cells ({result}APIC's {signed(apic)})")
    lines.append(f"**Cell**: against {plan.cells[-1]} cells across the column the front is {', '.join(parts)}.")
    some = [each for each in plan.relaxed(plan.coarse) if 0.0 < each.relaxation < INFINITE]
    corrected = [found[on].front / found[off].front - 1.0 for off, on in plan.corrected() if off.relaxation == DEFAULT]
    lines.append(
        f"Over {', '.join(f'{each.relaxation:g}' for each in some)} times the default relaxation time fronts spread by"
        f" {percent(spread(some, found))}; volume correction moves one by up to {percent(max(map(abs, corrected)))}."
    )
    return lines


def criterion(value: float, limit: float) -> str:
    """Whether a criterion is met."""
    return f"criterion {percent(limit)}, {'met' if value <= limit else '**missed**'}"


def grid_rows(cells: int, plan: Plan, found: Found) -> list[Row]:
    """Fronts over stiffness x step x interval, both transfers side by side."""
    rows: dict[tuple[float, float], dict[str, object]] = {}
    columns = [column for each in NAMES for column in plan.grid(cells, each)]
    heads = {f"{NAMES[each.relaxation]}, {1000 * each.interval:g} ms": None for each in columns}
    for each in columns:
        start = {"E [Pa]": f"{YOUNG * each.stiffness:.0e}", "step": f"{each.step:g}"} | dict.fromkeys(heads, "-")
        row = rows.setdefault((each.stiffness, each.step), dict(start))
        row[f"{NAMES[each.relaxation]}, {1000 * each.interval:g} ms"] = f"{found[each].front:.3f}"
    return list(rows.values())


def convergence_row(cells: int, plan: Plan, found: Found) -> Row:
    """Fronts on a grid, by both transfers."""
    row: dict[str, object] = {"cells across": cells, "cell": f"{1000 * LENGTH / cells:g} mm"}
    for each, name in NAMES.items():
        fronts = [found[column].front for column in plan.convergence(cells, each)]
        scatter = f" ± {np.std(fronts, ddof=1):.3f}" if len(fronts) > 1 else ""
        row[f"front, {name} [m]"] = f"{np.mean(fronts):.3f}{scatter}"
        row[f"{name}, against the finest"] = signed(deviation(cells, plan, found, each))
    return row


def draw(path: Path, plan: Plan, found: Found) -> None:
    """Fronts over stiffness, a line per step and transfer; and over the cells."""
    with figure(path, columns=2, size=(5.5, 4.4)) as axes:
        left, right = axes[0]
        for each, name in NAMES.items():
            style = "o-" if each == DEFAULT else "s--"
            for step, colour in zip(plan.steps, (BLUE, ORANGE, GREEN), strict=False):
                some = [c for c in plan.grid(plan.coarse, each) if (c.step, c.interval) == (step, USUAL)]
                stiffnesses, fronts = [YOUNG * c.stiffness for c in some], [found[c].front for c in some]
                left.plot(stiffnesses, fronts, style, color=colour, markersize=4, label=f"{name}, step {step:g}")
            fronts = [mean(plan.convergence(cells, each), found) for cells in plan.cells]
            right.plot(plan.cells, fronts, style, label=name)
        left.set(xlabel=f"Young's modulus [Pa], {plan.coarse} cells across the column", ylabel="front [m]")
        right.set(xlabel="cells across the column")
        for axis in (left, right):
            axis.set_xscale("log")
            axis.set_ylim(bottom=0.0)
            axis.legend()
        right.set_xticks(plan.cells, [f"{cells}" for cells in plan.cells])
        right.minorticks_off()
