"""`python -m validation.bench columns`: the paper's four columns in our MPM, beside the paper's runouts."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.library import read_scene
from datasets.measures import front, runout
from datasets.scene import Domain, Scene
from validation.bench.columns.paper import read_paper
from validation.report.page import Page, percent, signed
from validation.runs import Run, RunStore

DAMPINGS = (0.12, 0.05, 0.0)
CELL, FINE = 0.01, 0.005
"""Cells [m]: the paper's, and half of it."""
STEP, SHORT = 0.9, 0.4
"""Steps as fractions of cell / wave speed."""
CLOSE = 0.05
"""Criterion of the root mean square deviation from the paper's runouts [-]."""

Lengths = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Variant:
    """How the columns are computed."""

    damping: float
    cell: float = CELL
    step: float = STEP
    apic: bool = False

    def scene(self, scene: Scene, seed: int) -> Scene:
        """`scene` so computed, with another jitter."""
        return dataclasses.replace(
            scene,
            domain=Domain(size=scene.domain.size, cell=self.cell),
            step_fraction=self.step,
            damping=self.damping,
            relaxation_time=0.0 if self.apic else None,
            seed=seed,
        )


@dataclass(frozen=True, kw_only=True)
class Columns:
    """The deposits of the columns by a variant."""

    runouts: Mapping[str, Lengths]
    """d [m] by column, one per seed."""
    fronts: Mapping[str, Lengths]
    """Front [m] by column, one per seed."""

    def deviations(self, stated: Mapping[str, float]) -> Lengths:
        """Of the mean runouts from `stated` [m], relative, one per column."""
        return np.array([self.runouts[name].mean() / d - 1.0 for name, d in stated.items()])

    def rms(self, stated: Mapping[str, float]) -> float:
        """Root mean square of the deviations."""
        return math.sqrt(np.mean(self.deviations(stated) ** 2))


def variants(cell: float, fine: float) -> list[Variant]:
    """Each damping at both steps and on both cells, then APIC."""
    default = [
        Variant(damping=damping, cell=size, step=step)
        for damping in DAMPINGS
        for size, step in ((cell, STEP), (cell, SHORT), (fine, STEP))
    ]
    return [*default, *(Variant(damping=damping, cell=cell, apic=True) for damping in DAMPINGS)]


def compute(tried: Sequence[Variant], names: Sequence[str], seeds: int, store: RunStore) -> dict[Variant, Columns]:
    """Run the columns `names` by each variant, half as many jitters on the finest cells."""
    finest = min(each.cell for each in tried)
    runs = {
        (each, name): [
            Run(scene=each.scene(read_scene(f"column-{name}"), seed))
            for seed in range(max(1, seeds // 2) if each.cell == finest else seeds)
        ]
        for each in tried
        for name in names
    }
    store.run([run for group in runs.values() for run in group])
    last = {key: [flow.positions[-1] for flow in store.run(group)] for key, group in runs.items()}
    return {
        each: Columns(
            runouts={name: np.array([runout(x) for x in last[each, name]]) for name in names},
            fronts={name: np.array([front(x) for x in last[each, name]]) for name in names},
        )
        for each in tried
    }


def bench(out: Path, *, quick: bool, keep: Path, seeds: int = 4) -> str:
    """Compare the paper's four columns with ours: columns.md. quick: coarse cells. seeds: jitters per column."""
    stated = {scenario.name: scenario.runout for scenario in read_paper().scenarios}
    tried = variants(4.0 * CELL, 2.0 * CELL) if quick else variants(CELL, FINE)
    seeds = 2 if quick else seeds
    found = compute(tried, list(stated), seeds, RunStore(keep))
    return write(out / "columns.md", found, stated, seeds, quick=quick)


def write(
    path: Path, found: Mapping[Variant, Columns], stated: Mapping[str, float], seeds: int, *, quick: bool = False
) -> str:
    """Write the page, and return its conclusion."""
    best = closest(found, stated)
    page = Page(
        "The paper's columns",
        command=f"python -m validation.bench columns --seeds {seeds} --out docs",
        conclusion=conclusion(found, stated),
        quick=quick,
    )
    page.text(f"""
        Runout d [m] (largest x) at 1 s, mean ± standard deviation over {seeds} jitters, half as many on the finer grid;
        step as a fraction of cell / wave speed. The default transfer is AFLIP with a relaxation time. The paper states
        neither its damping nor the friction of its floor; ours is {read_scene("column-tall-42").floor_friction:g}.
    """)
    paper: dict[str, object] = {"transfer": "the paper", "damping": None, "cell [m]": CELL, "step": None}
    rows = [paper | {name: f"{d:.4f}" for name, d in stated.items()} | {"rms deviation": None}]
    for each, columns in found.items():
        kind: dict[str, object] = {"transfer": "APIC" if each.apic else "default", "damping": f"{each.damping:g}"}
        runouts = {name: spread(columns.runouts[name]) for name in stated}
        grid = {"cell [m]": each.cell, "step": each.step}
        rows.append(kind | grid | runouts | {"rms deviation": percent(columns.rms(stated))})
    page.table(rows)
    page.text(
        f"Front (99.5 % of the particles behind) at damping {best.damping:g}, cell {best.cell:g} m, step {best.step:g}:"
    )
    page.table([{"column": name, "front [m]": spread(x)} for name, x in found[best].fronts.items()])
    return page.write(path)


def spread(values: Lengths) -> str:
    """Mean ± standard deviation."""
    return f"{values.mean():.4f}" + (f" ± {values.std(ddof=1):.4f}" if len(values) > 1 else "")


def closest(found: Mapping[Variant, Columns], stated: Mapping[str, float]) -> Variant:
    """The default transfer at the damping with the smallest deviation, on the paper's cell, at the usual step."""
    cell = max(each.cell for each in found)
    usual = (each for each in found if not each.apic and (each.cell, each.step) == (cell, STEP))
    return min(usual, key=lambda each: found[each].rms(stated))


def conclusion(found: Mapping[Variant, Columns], stated: Mapping[str, float]) -> list[str]:
    """What was found, each sentence from its numbers."""
    best, fine = closest(found, stated), min(each.cell for each in found)
    smallest = found[best].rms(stated)
    lines = [
        f"The damping closest to the paper's runouts is {best.damping:g}, with {percent(smallest)}"
        f" rms (criterion {percent(CLOSE)}: {'met' if smallest <= CLOSE else '**missed**'})."
    ]
    for damping in DAMPINGS:
        usual = dataclasses.replace(best, damping=damping)
        changed = (
            dataclasses.replace(usual, step=SHORT),
            dataclasses.replace(usual, cell=fine),
            dataclasses.replace(usual, apic=True),
        )
        rms, short, finer, apic = (percent(found[each].rms(stated)) for each in (usual, *changed))
        lines.append(
            f"Damping {damping:g}: {rms} rms, {signed(found[usual].deviations(stated).mean())} on average; at step"
            f" {SHORT:g} {short} rms, on cells of {1000 * fine:g} mm {finer}, by APIC {apic}."
        )
    return lines
