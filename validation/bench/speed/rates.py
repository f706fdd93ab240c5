"""Million particle-steps a second of the MPM, over sizes, dimensions, threads and precisions."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from datasets.library import read_scene
from datasets.material import Material
from datasets.particles import particle_count
from datasets.records import Record, from_mapping, read_toml
from datasets.scene import Domain, Mass, Scene
from mpm.arrays.layout import Precision
from mpm.simulation import LARGE
from validation.bench.speed.timing import Spread, TimedRun, Timing, spread
from validation.report.page import Row

CUBE = 0.375
"""Edge of the 3D column [m]."""


@dataclass(frozen=True, kw_only=True)
class RateCase:
    """A column on some grid, alone or with copies side by side."""

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
    def particles(self) -> int:
        """Of one scene."""
        return particle_count(column(self.dimension, self.cells, 1))

    @property
    def large(self) -> bool:
        """Whether it is one scene that runs on all threads."""
        return self.scenes == 1 and self.particles >= LARGE


@dataclass(frozen=True, kw_only=True)
class Mode:
    """A precision and a number of threads."""

    precision: Precision
    threads: int


CASES = (
    RateCase(dimension=2, cells=100, scenes=1, frames=400, aim=25.0, limit=98.0),
    RateCase(dimension=2, cells=100, scenes=2, frames=400, aim=55.0, limit=180.0),
    RateCase(dimension=2, cells=100, scenes=8, frames=200, aim=55.0, limit=180.0),
    RateCase(dimension=2, cells=280, scenes=1, frames=20),
    RateCase(dimension=2, cells=560, scenes=1, frames=4, aim=42.0, limit=199.0),
    RateCase(dimension=2, cells=1770, scenes=1, frames=1, aim=48.0, limit=187.0),
    RateCase(dimension=3, cells=32, scenes=1, frames=100, aim=11.0, limit=40.0),
    RateCase(dimension=3, cells=32, scenes=2, frames=100, aim=14.5, limit=69.0),
    RateCase(dimension=3, cells=32, scenes=8, frames=50, aim=14.5, limit=69.0),
    RateCase(dimension=3, cells=64, scenes=1, frames=20),
    RateCase(dimension=3, cells=106, scenes=1, frames=5, aim=15.0, limit=80.0),
)
QUICK = tuple(replace(case, frames=1) for case in (*CASES[:2], *CASES[6:8]))
Rates = Mapping[tuple[RateCase, Mode], Sequence[Timing]]


@dataclass(frozen=True, kw_only=True)
class Code(Record):
    """Another code and its rates."""

    name: str
    rates: tuple[str, ...]
    """Per column of the table; a dash where nothing was measured."""


@dataclass(frozen=True, kw_only=True)
class OtherCodes(Record):
    """Rates of other codes (`speed.toml`)."""

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


def modes(case: RateCase, cores: int) -> list[Mode]:
    """How a case is run: a small scene on one thread, copies on all, a large one on one and on all."""
    most = cores if case.large or case.scenes > 1 else 1
    fewest = most if case.scenes > 1 else 1
    single = [Mode(precision="f32", threads=threads) for threads in sorted({fewest, most})]
    return [*single, Mode(precision="f64", threads=most)]


def runs(cases: Sequence[RateCase], cores: int | None = None) -> dict[tuple[RateCase, Mode], TimedRun]:
    """Every case in every mode."""
    cores = cores or os.cpu_count() or 1
    return {
        (case, mode): TimedRun(
            scenes=tuple(replace(column(case.dimension, case.cells, case.frames), seed=i) for i in range(case.scenes)),
            precision=mode.precision,
            threads=mode.threads,
        )
        for case in cases
        for mode in modes(case, cores)
    }


def rates_of(found: Rates, case: RateCase) -> dict[Mode, Spread]:
    """Million particle-steps a second of a case by mode."""
    return {mode: spread(each.rate for each in timings) for (other, mode), timings in found.items() if other == case}


def best(found: Rates, case: RateCase) -> Spread:
    """In single precision on the most threads."""
    rates = rates_of(found, case)
    return rates[max((mode for mode in rates if mode.precision == "f32"), key=lambda mode: mode.threads)]


def rate_rows(found: Rates) -> list[Row]:
    """One line per case: its rates, the aim and half of the limit."""
    cores = max(mode.threads for _, mode in found)
    rows: list[Row] = []
    for case in dict.fromkeys(case for case, _ in found):
        rates = rates_of(found, case)
        most = max(mode.threads for mode in rates)
        alone = rates.get(Mode(precision="f32", threads=1))
        double = rates[Mode(precision="f64", threads=most)].written(1)
        rows.append(
            {
                "": f"{case.dimension}D",
                "particles": f"{case.particles:,}",
                "scenes": case.scenes,
                "f32, 1 thread": alone.written(1) if alone else "-",
                f"f32, {cores} threads": best(found, case).written(1) if most > 1 else "-",
                f"f64, {cores} threads": double + ("" if most > 1 or cores == 1 else " on 1"),
                "aim": fraction_of(best(found, case), case.aim),
                "half of hand-written": fraction_of(best(found, case), case.limit and 0.5 * case.limit),
            }
        )
    return rows


def fraction_of(rate: Spread, goal: float | None) -> str:
    """A goal, and the fraction of it that the median is."""
    if goal is None:
        return "-"
    fraction = rate.median / goal
    return f"{goal:g}: {'met' if fraction >= 1.0 else f'{100.0 * fraction:.0f} %'}"


def other_rows() -> list[Row]:
    """Rates of other codes."""
    others = from_mapping(OtherCodes, read_toml(Path(__file__).with_name("speed.toml")))
    return [{"": code.name} | dict(zip(others.columns, code.rates, strict=True)) for code in others.codes]
