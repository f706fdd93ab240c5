"""Million point-steps a second of the MPM, over sizes, dimensions, threads and precisions."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from datasets.library import read_scene
from datasets.material import Material
from datasets.particles import particle_count
from datasets.records import Record, from_mapping, read_toml
from datasets.scene import Domain, Mass, Scene
from inverse.report.markdown import table
from mpm.arrays.layout import Precision
from mpm.simulation import LARGE
from validation.report.timing import Run, Spread, Took

CUBE = 0.375
"""Edge of the 3D column [m]."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A column on some grid, alone or several of it side by side."""

    dimension: int
    cells: int
    """Per metre."""
    scenes: int
    frames: int
    """That are timed, from the start of the flow."""
    aim: float | None = None
    """The rate that was set as the aim on two cores."""
    limit: float | None = None
    """The rate of vector code written by hand on two cores, on one for one small scene."""

    @property
    def large(self) -> bool:
        """Whether it is one scene that runs on all threads."""
        return self.scenes == 1 and particle_count(column(self.dimension, self.cells, 1)) >= LARGE


@dataclass(frozen=True, kw_only=True)
class Way:
    """A precision and a number of threads."""

    precision: Precision
    threads: int


CASES = (
    Case(dimension=2, cells=100, scenes=1, frames=400, aim=25.0, limit=98.0),
    Case(dimension=2, cells=100, scenes=2, frames=400, aim=55.0, limit=180.0),
    Case(dimension=2, cells=100, scenes=8, frames=200, aim=55.0, limit=180.0),
    Case(dimension=2, cells=280, scenes=1, frames=20),
    Case(dimension=2, cells=560, scenes=1, frames=4, aim=42.0, limit=199.0),
    Case(dimension=2, cells=1770, scenes=1, frames=1, aim=48.0, limit=187.0),
    Case(dimension=3, cells=32, scenes=1, frames=100, aim=11.0, limit=40.0),
    Case(dimension=3, cells=32, scenes=2, frames=100, aim=14.5, limit=69.0),
    Case(dimension=3, cells=32, scenes=8, frames=50, aim=14.5, limit=69.0),
    Case(dimension=3, cells=64, scenes=1, frames=20),
    Case(dimension=3, cells=106, scenes=1, frames=5, aim=15.0, limit=80.0),
)


@dataclass(frozen=True, kw_only=True)
class Code(Record):
    """Another code, and what it does."""

    name: str
    rates: tuple[str, ...]
    """Per column of the table; a dash where nothing was measured."""


@dataclass(frozen=True, kw_only=True)
class Others(Record):
    """What other codes do (`speed.toml`)."""

    columns: tuple[str, ...]
    codes: tuple[Code, ...]


def column(dimension: int, cells: int, frames: int) -> Scene:
    """The paper's tall column at 42 degrees, or a cube of its 3D sand at the left wall, on `cells` cells per metre."""
    if dimension == 2:
        scene = read_scene("column-tall-42")
        scene = replace(scene, domain=Domain(size=(1.0, 1.0), cell=1.0 / cells))
    else:
        edge = round(CUBE * cells) / cells
        start = round((0.5 - CUBE / 2) * cells) / cells
        scene = Scene(
            domain=Domain(size=(1.0, 1.0, 1.0), cell=1.0 / cells),
            material=Material(friction_deg=35.0),
            masses=(Mass(lower=(0.0, 0.0, start), size=(edge, edge, edge)),),
            floor_friction=0.43,
            wall_friction=0.43,
            step_fraction=0.9,
        )
    return replace(scene, duration=frames * scene.frame_dt)


def ways(case: Case, cores: int) -> list[Way]:
    """In which ways a case is run: a small scene on one thread, several on all, a large one on one and on all."""
    most = cores if case.large or case.scenes > 1 else 1
    least = most if case.scenes > 1 else 1
    return [Way(precision="f32", threads=threads) for threads in sorted({least, most})] + [
        Way(precision="f64", threads=most)
    ]


def runs(cases: Sequence[Case], cores: int | None = None) -> dict[tuple[Case, Way], Run]:
    """Every case in every way."""
    cores = cores or os.cpu_count() or 1
    return {
        (case, way): Run(
            scenes=tuple(replace(column(case.dimension, case.cells, case.frames), seed=i) for i in range(case.scenes)),
            precision=way.precision,
            threads=way.threads,
        )
        for case in cases
        for way in ways(case, cores)
    }


def rates_table(took: Mapping[tuple[Case, Way], Sequence[Took]]) -> list[str]:
    """One line per case: its rates, the aim and half of the limit."""
    cores = max(way.threads for _, way in took)
    together = f"{cores} threads"
    head = [
        "",
        "points",
        "scenes",
        "f32, 1 thread",
        f"f32, {together}",
        f"f64, {together}",
        "aim",
        "half of hand-written",
    ]
    rows = []
    for case in dict.fromkeys(case for case, _ in took):
        rates = {way: Spread.of(each.rate for each in took[case, way]) for other, way in took if other == case}
        most = max(way.threads for way in rates)
        alone = rates.get(Way(precision="f32", threads=1))
        best = rates[Way(precision="f32", threads=most)]
        rows.append(
            [
                f"{case.dimension}D",
                f"{particle_count(column(case.dimension, case.cells, 1)):,}",
                str(case.scenes),
                alone.written(1) if alone else "-",
                best.written(1) if most > 1 else "-",
                rates[Way(precision="f64", threads=most)].written(1) + ("" if most > 1 or cores == 1 else " on 1"),
                against(best, case.aim),
                against(best, case.limit and 0.5 * case.limit),
            ]
        )
    return table(head, rows)


def against(rate: Spread, goal: float | None) -> str:
    """A goal, and whether the median meets it."""
    if goal is None:
        return "-"
    share = rate.middle / goal
    return f"{goal:g}: {'met' if share >= 1.0 else f'{100.0 * share:.0f} %'}"


def others_table() -> list[str]:
    """What other codes do."""
    others = from_mapping(Others, read_toml(Path(__file__).with_name("speed.toml")))
    return table(["", *others.columns], [[code.name, *code.rates] for code in others.codes])
