"""python -m validation.bench.columns.paper_columns --out DIR: the paper's four columns in our MPM, beside the paper's runouts."""

import dataclasses
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.command_line import run
from datasets.files import write_text
from datasets.library import read_scene
from datasets.measures import front, runout
from datasets.scene import Domain, Scene
from inverse.report.markdown import table
from validation.bench.accuracy.page import paragraph, percent
from validation.bench.columns.paper import read_paper
from validation.report.machine import machine
from validation.runs import Run, RunStore

DAMPINGS = (0.12, 0.05, 0.0)
CELL, FINE = 0.01, 0.005
"""Cells [m]: the paper's, and half of it."""
STEP, SHORT = 0.9, 0.4
"""Steps as fractions of cell / wave speed."""
CLOSE = 0.05
"""Root mean square deviation from the paper's runouts that is asked for [-]."""


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
class Outcome:
    """What a variant came to."""

    runouts: Mapping[str, NDArray[np.float64]]
    """d [m] by column, one per seed."""
    fronts: Mapping[str, NDArray[np.float64]]
    """Front [m] by column, one per seed."""

    def rms(self, stated: Mapping[str, float]) -> float:
        """Root mean square deviation of the mean runouts from `stated` [m], relative."""
        return math.sqrt(np.mean([(self.runouts[name].mean() / d - 1.0) ** 2 for name, d in stated.items()]))

    def mean(self, stated: Mapping[str, float]) -> float:
        """Mean relative deviation: whether columns run too far."""
        return float(np.mean([self.runouts[name].mean() / d - 1.0 for name, d in stated.items()]))


def variants(cell: float, fine: float) -> list[Variant]:
    """Each damping at both steps and on both cells, then APIC."""
    tried = [
        each
        for damping in DAMPINGS
        for each in (
            Variant(damping=damping, cell=cell),
            Variant(damping=damping, cell=cell, step=SHORT),
            Variant(damping=damping, cell=fine),
        )
    ]
    return [*tried, *(Variant(damping=damping, cell=cell, apic=True) for damping in DAMPINGS)]


def carry_out(
    tried: Sequence[Variant], names: Sequence[str], seeds: int, finest_seeds: int, folder: Path
) -> dict[Variant, Outcome]:
    """Run what `folder` does not have yet; the finest cells with fewer jitters."""
    finest = min(each.cell for each in tried)
    runs = {
        (each, name): [
            Run(scene=each.scene(read_scene(f"column-{name}"), seed))
            for seed in range(finest_seeds if each.cell == finest else seeds)
        ]
        for each in tried
        for name in names
    }
    store = RunStore(folder)
    store.run([one for group in runs.values() for one in group])
    last = {key: [flow.positions[-1] for flow in store.run(group)] for key, group in runs.items()}
    return {
        each: Outcome(
            runouts={name: np.array([runout(x) for x in last[each, name]]) for name in names},
            fronts={name: np.array([front(x) for x in last[each, name]]) for name in names},
        )
        for each in tried
    }


def command(*, out: Path, keep: Path = Path("runs/columns"), seeds: int = 4, quick: bool = False) -> None:
    """Compare the runout of the paper's four columns with ours: three dampings, two cells, two steps, APIC.

    Parameters
    ----------
    out
        Folder for columns.md.
    keep
        Folder for the deposits; what is there is not run again.
    seeds
        Jitters per column, half as many on the finer grid; the table gives mean and standard deviation.
    quick
        On coarse cells, to try the command; the figures mean nothing.
    """
    stated = {scenario.name: scenario.runout for scenario in read_paper().scenarios}
    tried = variants(4.0 * CELL, 2.0 * CELL) if quick else variants(CELL, FINE)
    found = carry_out(tried, list(stated), 2 if quick else seeds, max(1, seeds // 2), keep)
    write_text(out / "columns.md", text(found, stated, seeds))


def text(found: Mapping[Variant, Outcome], stated: Mapping[str, float], seeds: int) -> str:
    """columns.md."""
    rows = [["the paper", "", f"{CELL:g}", "", *(f"{d:.4f}" for d in stated.values()), ""]]
    for each, outcome in found.items():
        rows.append(
            [
                "APIC" if each.apic else "default",
                f"{each.damping:g}",
                f"{each.cell:g}",
                f"{each.step:g}",
                *(spread(outcome.runouts[name], 4) for name in stated),
                percent(outcome.rms(stated)),
            ]
        )
    best = closest(found, stated)
    return "\n".join(
        [
            "# The paper's columns",
            "",
            *conclusion(found, stated),
            *paragraph(f"""
                `python -m validation.bench.columns.paper_columns --seeds {seeds} --out docs`. Runout d [m] (largest x) at 1 s, mean ±
                standard deviation over {seeds} jitters, half as many on the finer grid; step as a fraction of cell /
                wave speed. The default transfer is AFLIP with a relaxation time. The paper states neither its damping
                nor the friction of its floor; ours is 0.385.
            """),
            *table(["transfer", "damping", "cell [m]", "step", *stated, "rms deviation"], rows),
            "",
            f"Front (99.5 % of the particles behind) at damping {best.damping:g}, cell {best.cell:g} m, step"
            f" {best.step:g}:",
            "",
            *table(["column", "front [m]"], [[name, spread(x, 4)] for name, x in found[best].fronts.items()]),
            "",
        ]
    )


def spread(values: NDArray[np.float64], digits: int) -> str:
    """Mean ± standard deviation."""
    width = f" ± {values.std(ddof=1):.{digits}f}" if len(values) > 1 else ""
    return f"{values.mean():.{digits}f}{width}"


def closest(found: Mapping[Variant, Outcome], stated: Mapping[str, float]) -> Variant:
    """The default transfer at the damping that comes closest on the paper's cell, at the usual step."""
    cell = max(each.cell for each in found)
    return min(
        (each for each in found if not each.apic and (each.cell, each.step) == (cell, STEP)),
        key=lambda each: found[each].rms(stated),
    )


def conclusion(found: Mapping[Variant, Outcome], stated: Mapping[str, float]) -> list[str]:
    """What was found, in a few lines, each from its numbers."""
    best = closest(found, stated)
    lines = []
    for damping in DAMPINGS:
        coarse, short, apic = (
            dataclasses.replace(best, damping=damping, **change) for change in ({}, {"step": SHORT}, {"apic": True})
        )
        fine = dataclasses.replace(best, damping=damping, cell=min(each.cell for each in found))
        outcome = found[coarse]
        way = "far" if outcome.mean(stated) > 0.0 else "short"
        lines.append(
            f"- Damping {damping:g}: {percent(outcome.rms(stated))} rms from the paper's runouts, on average"
            f" {percent(abs(outcome.mean(stated)))} too {way}; at step {SHORT:g} {percent(found[short].rms(stated))},"
            f" on cells of {1000 * fine.cell:g} mm {percent(found[fine].rms(stated))}; by APIC"
            f" {percent(found[apic].rms(stated))}."
        )
    least = found[best].rms(stated)
    lines.append(
        f"- The closest is {best.damping:g}, with {percent(least)} rms: within {percent(CLOSE)}"
        f" {'it is' if least <= CLOSE else '**it is not**'}."
    )
    return [*lines, f"- {machine()}.", ""]


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.bench.columns.paper_columns"))
