"""Columns that collapse: the reference paper's four beside its runouts, and others over their aspect ratio.

Half a column in 2D, a quarter of a cylinder in 3D, against smooth walls, on a floor as rough as the sand; no column
comes near the far walls. They differ in their aspect ratio a = H / L alone: the stiffness goes with the height,
E = 150 rho g H, so lengths and times scale with L and sqrt(H / g).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from datasets import measures
from datasets.files import read_toml
from datasets.library import read_scene
from datasets.material import Material
from datasets.measures import runout
from datasets.scene import Domain, Mass, Scene
from datasets.trajectory import Trajectory
from mpm import AT_REST
from validation.experiments.experiment import radius
from validation.report.page import Page, Row, percent, rms, signed
from validation.runs import Run, RunStore

DAMPINGS = (0.12, 0.05, 0.0)
"""That the paper's columns are tried with."""
LENGTH, GRAVITY, DENSITY, FRICTION_DEG = 0.1, 9.81, 1800.0, 30.0
"""L [m], the radius of a cylinder; [m/s^2]; [kg/m^3]; of grains and floor."""
CELLS = {2: 16, 3: 8}
"""Across the smaller of L and H, by dimension."""
ASPECTS = {2: (0.5, 1.0, 2.0, 4.0, 8.0), 3: (0.5, 1.0, 2.0, 4.0)}
EXTENT = {2: (3.0, 0.8), 3: (3.0, 0.55)}
"""Prefactor and exponent, by dimension, of a runout (d - L) / L that no column comes near: the length of the box."""
OURS, APIC = "Talus", "Talus, APIC"

PUBLISHED = Path(__file__).with_suffix(".toml")
"""Runouts of the paper, laws of the literature, fronts by other codes."""

Fronts = Mapping[tuple[int, str, float], float]
"""(d - L) / L by dimension, name and aspect ratio."""


def column(dimension: int, aspect: float, cells: int) -> Scene:
    """Half a column, or a quarter of a cylinder in slabs half a cell thick as long as the circle at their middle."""
    across = round(cells / min(1.0, aspect))
    cell, height = LENGTH / across, aspect * LENGTH
    masses = [Mass(lower=(0.0, 0.0), size=(LENGTH, height))]
    if dimension == 3:
        half = 0.5 * cell
        chords = [math.sqrt(LENGTH**2 - ((number + 0.5) * half) ** 2) for number in range(2 * across)]
        masses = [
            Mass(lower=(0.0, 0.0, number * half), size=(max(1, round(chord / half)) * half, height, half))
            for number, chord in enumerate(chords)
        ]
    factor, exponent = EXTENT[dimension]
    long = math.ceil(across * (1.5 + factor * aspect**exponent)) * cell
    high = math.ceil(across * aspect * 1.1) * cell
    time = math.sqrt(height / GRAVITY)
    return Scene(
        domain=Domain(size=(long, high) if dimension == 2 else (long, high, long), cell=cell),
        material=Material(
            friction_deg=FRICTION_DEG, density=DENSITY, young=150.0 * DENSITY * GRAVITY * height, poisson=0.3
        ),
        masses=tuple(masses),
        duration=15.0 * time,
        frame_dt=0.05 * time,
        gravity=GRAVITY,
        floor_friction=math.tan(math.radians(FRICTION_DEG)),
        step_fraction=0.9,
    )


def front(flow: Trajectory) -> float:
    """(d - L) / L, with d the radius that 99.5 % of the volume is within."""
    extent = measures.front if flow.scene.dimension == 2 else radius
    return extent(flow.positions[-1], flow.volumes) / LENGTH - 1.0


def collapse(store: RunStore, *, quick: bool) -> Fronts:
    """Columns over their aspect ratio, by the default transfer and, in 2D, by APIC."""
    kinds = [(2, OURS, None), (2, APIC, 0.0), (3, OURS, None)]
    runs = {
        (dimension, name, aspect): Run(
            scene=replace(column(dimension, aspect, CELLS[dimension]), relaxation_time=time), record=AT_REST
        )
        for dimension, name, time in kinds[: 2 if quick else 3]
        for aspect in ASPECTS[dimension][1 : 3 if quick else None]
    }
    flows = store.run(list(runs.values()))
    return {key: front(flow) for key, flow in zip(runs, flows, strict=True)}


def laws() -> Fronts:
    """Published laws at the aspect ratios that they are for."""
    return {
        (law["dimension"], law["source"], aspect): law["prefactor"] * aspect ** law["exponent"]
        for law in read_toml(PUBLISHED)["laws"]
        for aspect in ASPECTS[law["dimension"]]
        if law.get("above", 0.0) <= aspect < law.get("below", math.inf)
    }


def codes() -> Fronts:
    return {
        (2, code["name"], aspect): value
        for code in read_toml(PUBLISHED)["codes"]
        for aspect, value in zip(code["aspects"], code["fronts"], strict=True)
    }


def aspect_tables(page: Page, found: Fronts) -> None:
    page.section("Columns over their aspect ratio")
    page.text(f"""
        Columns of length (in 3D: cylinders of radius) L and height H = a L, dry sand of {FRICTION_DEG:g}° on a floor as
        rough, undamped, {CELLS[2]} cells across the smaller of L and H in 2D, {CELLS[3]} in 3D, until they rest: the
        front, (d - L) / L of 99.5 % of the volume. The laws of the literature are of the furthest grains; side walls
        brake the experiments in channels, not discs and rods. Other codes ran on the same grids.
    """)
    known = {**found, **laws(), **codes()}
    for dimension in dict.fromkeys(dimension for dimension, *_ in found):
        names = dict.fromkeys(name for d, name, _ in known if d == dimension)
        aspects = [a for d, name, a in found if (d, name) == (dimension, OURS)]
        rows: list[Row] = [
            {f"{dimension}D": name}
            | {f"a = {a:g}": f"{known[key]:.2f}" if (key := (dimension, name, a)) in known else "-" for a in aspects}
            for name in names
        ]
        page.table(rows)


def aspect_text(found: Fronts) -> str:
    """How fronts compare with other codes and with published laws, one sentence."""
    off = [abs(found[d, APIC, a] / value - 1.0) for (d, _, a), value in codes().items() if (d, APIC, a) in found]
    times = [found[d, OURS, a] / value for (d, _, a), value in laws().items() if (d, OURS, a) in found]
    return (
        f"By APIC, columns run out as in other codes within {percent(max(off))}; by the default transfer"
        f" {min(times):.2f} to {max(times):.2f} times as far as published laws say."
    )


@dataclass(frozen=True, kw_only=True)
class PaperColumns:
    """Runouts of the paper's columns [m] by damping and name, one per jitter, beside those that it states."""

    found: Mapping[tuple[float, str], Sequence[float]]
    stated: Mapping[str, float]

    def deviations(self, damping: float) -> list[float]:
        """Of the mean runouts, relative, one per column."""
        return [float(np.mean(self.found[damping, name])) / value - 1.0 for name, value in self.stated.items()]

    def __str__(self) -> str:
        off = {damping: rms(self.deviations(damping)) for damping in DAMPINGS}
        best = min(off, key=off.__getitem__)
        return (
            f"The paper's runouts come out within {percent(off[best])} rms with a damping of {best:g} that it does"
            f" not state, {signed(float(np.mean(self.deviations(0.0))))} on average without damping."
        )

    def table(self, page: Page) -> None:
        scene = read_scene("column-tall-42")
        page.section("The paper's columns")
        page.text(f"""
            The four columns of the reference paper ([references](theory/references.md)): runout (largest x) at 1 s [m]
            on its cells of {scene.domain.cell:g} m, mean over jitters. It states neither its damping nor the friction
            of its floor; ours is {scene.floor_friction:g}.
        """)
        rows: list[Row] = [
            {"damping": "the paper"}
            | {name: f"{value:.4f}" for name, value in self.stated.items()}
            | {"mean": "", "rms": ""}
        ]
        for damping in DAMPINGS:
            cells = {name: f"{np.mean(self.found[damping, name]):.4f}" for name in self.stated}
            off = self.deviations(damping)
            ends = {"mean": signed(float(np.mean(off))), "rms": percent(rms(off))}
            rows.append({"damping": f"{damping:g}"} | cells | ends)
        page.table(rows)


def paper_columns(store: RunStore, seeds: int) -> PaperColumns:
    stated = read_toml(PUBLISHED)["paper"]
    keys = [(damping, name, seed) for damping in DAMPINGS for name in stated for seed in range(seeds)]
    flows = store.run([Run(scene=replace(read_scene(f"column-{n}"), damping=d, seed=seed)) for d, n, seed in keys])
    found: dict[tuple[float, str], list[float]] = {}
    for (damping, name, _), flow in zip(keys, flows, strict=True):
        found.setdefault((damping, name), []).append(runout(flow.positions[-1]))
    return PaperColumns(found=found, stated=stated)
