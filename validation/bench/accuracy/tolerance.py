"""python -m validation.bench.accuracy.tolerance --out DIR: whether --tolerance keeps its promise on scenes it was not measured on."""

import dataclasses
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from datasets.command_line import run
from datasets.errors import InputError
from datasets.files import write_text
from datasets.records import from_mapping, read_toml
from datasets.scene import Scene
from inverse.report.markdown import table
from mpm.resolution import COVERAGE, MEASURED, Measurements, Resolved, at, resolved
from validation.bench.accuracy.flows import UNSEEN, shortened
from validation.bench.accuracy.page import paragraph, percent
from validation.bench.accuracy.scores import score, truth
from validation.bench.accuracy.studies import own
from validation.report.machine import machine
from validation.runs import Run, RunStore

TOLERANCES = (0.1, 0.05, 0.03)
BAR = 18 / 20
"""Share of the scenes that are to keep within the tolerance."""
REFERENCE = {2: 80.0, 3: 24.0}
"""Cells across the smallest side, by dimension."""
QUICK_REFERENCE = {2: 12.0, 3: 7.0}
DEAREST = 0.35
"""What is tried costs at most this share of the reference's particle-steps."""
SEED = 7
"""Of what is tried: not one of those that were measured."""


@dataclass(frozen=True, kw_only=True)
class Held:
    """A scene at what a tolerance picked for it, against its reference."""

    name: str
    dimension: int
    asked: float
    picked: Resolved
    error: float
    """Over the reach [-]."""

    @property
    def kept(self) -> bool:
        """Whether the error is within what was asked."""
        return self.error <= self.asked


def command(*, out: Path, keep: Path = Path("runs/accuracy"), measured: Path = MEASURED, quick: bool = False) -> None:
    """Run 20 scenes at what --tolerance picks for 10, 5 and 3 %, each against its own reference.

    Parameters
    ----------
    out
        Folder for tolerance.md.
    keep
        Folder for the deposits; what is there is not run again.
    measured
        What --tolerance picks from.
    quick
        Two scenes per dimension, cut short, against coarse references, to try the command; figures mean nothing.
    """
    scenes = {
        (dimension, name): (shortened(flow, 0.2) if quick else flow).scene()
        for dimension, flows in UNSEEN.items()
        for name, flow in list(flows.items())[: 2 if quick else None]
    }
    held, refused = carry_out(scenes, measured, keep, QUICK_REFERENCE if quick else REFERENCE)
    write_text(out / "tolerance.md", text(held, refused, len(scenes)))


def carry_out(
    scenes: Mapping[tuple[int, str], Scene], path: Path, folder: Path, references: Mapping[int, float]
) -> tuple[list[Held], list[tuple[float, int, str]]]:
    """What was held, and for which tolerance and dimension why nothing was tried."""
    known = from_mapping(Measurements, read_toml(path)).measured
    picks: list[tuple[int, str, float, Resolved]] = []
    refused: dict[tuple[float, int], str] = {}
    for (dimension, name), scene in scenes.items():
        for asked in TOLERANCES:
            try:
                found = resolved(scene, asked, known)
            except InputError:
                refused[asked, dimension] = "no resolution that was measured promises it"
                continue
            best = at(scene, own(references[dimension]))
            # Particles times steps go with the cells to the dimension plus one.
            if (best.domain.cell / found.scene.domain.cell) ** (dimension + 1) > DEAREST:
                refused[asked, dimension] = "so fine a grid that the reference is no judge of it"
                continue
            picks.append((dimension, name, asked, found))
    best_runs = {key: Run(scene=at(scene, own(references[key[0]]))) for key, scene in scenes.items()}
    runs = [trial(found) for *_, found in picks]
    store = RunStore(folder)
    store.run([*runs, *best_runs.values()])
    truths = {key: truth(store.run([each])) for key, each in best_runs.items()}
    held = [
        Held(
            name=name,
            dimension=dimension,
            asked=asked,
            picked=found,
            error=score(store.run([trial(found)]), truths[dimension, name]).largest,
        )
        for dimension, name, asked, found in picks
    ]
    return held, [(asked, dimension, why) for (asked, dimension), why in refused.items()]


def trial(found: Resolved) -> Run:
    """One run of a scene as it was resolved."""
    return Run(scene=dataclasses.replace(found.scene, seed=SEED), precision=found.precision)


def text(held: Sequence[Held], refused: Sequence[tuple[float, int, str]], scenes: int) -> str:
    """tolerance.md."""
    lines = ["# Whether `--tolerance` keeps its promise", ""]
    for asked in TOLERANCES:
        some = [each for each in held if each.asked == asked]
        if some:
            kept, worst = sum(each.kept for each in some), max(some, key=lambda each: each.error)
            verdict = "met" if kept >= BAR * len(some) else "**missed**"
            lines.append(
                f"- Asked for {100 * asked:g} %: {kept} of {len(some)} scenes are within it (bar: {100 * BAR:.0f} %,"
                f" {verdict}); the worst, {worst.name}, is off by {percent(worst.error)}."
            )
    lines += [f"- {100 * asked:g} % in {dimension}D: {why}." for asked, dimension, why in refused]
    lines += [f"- {machine()}.", ""]
    lines += paragraph(f"""
        `python -m validation.bench.accuracy.tolerance --out docs`. {scenes} scenes that `--tolerance` was not measured on
        (`UNSEEN` in `validation/bench/accuracy/flows.py`), each run once, with a jitter of its own, at what `--tolerance` picks, and
        held against the same scene on {REFERENCE[2]:g} cells across the smallest side in 2D and {REFERENCE[3]:g} in
        3D. The promise is that at least {COVERAGE * 10:.0f} of 10 scenes are within what was asked, of the reach; how
        it is made: [accuracy.md](accuracy.md). Errors beyond what was asked are bold.
    """)
    names = list(dict.fromkeys((each.dimension, each.name) for each in held))
    rows = []
    for dimension, name in names:
        mine = {each.asked: each for each in held if (each.dimension, each.name) == (dimension, name)}
        rows.append([f"{dimension}D", name, *(cell(mine.get(asked)) for asked in TOLERANCES)])
    lines += table(["", "scene", *(f"asked {100 * asked:g} %: found (cells)" for asked in TOLERANCES)], rows)
    return "\n".join([*lines, ""])


def cell(each: Held | None) -> str:
    """An entry of the table."""
    if each is None:
        return "-"
    found = percent(each.error)
    return f"{found if each.kept else f'**{found}**'} ({each.picked.cells:.3g})"


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.bench.accuracy.tolerance"))
