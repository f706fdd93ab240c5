"""`python -m validation.bench tolerance`: whether --tolerance holds on scenes that it was not measured on."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from datasets.errors import InputError
from datasets.records import from_mapping, read_toml
from datasets.scene import Scene
from mpm.resolution import COVERAGE, MEASURED, Measurements, Resolved, resolved
from validation.bench.accuracy.flows import UNSEEN, shortened
from validation.bench.accuracy.scores import reference, score
from validation.bench.accuracy.studies import own, runs
from validation.report.page import Page, percent
from validation.runs import Run, RunStore

TOLERANCES = (0.1, 0.05, 0.03)
REFERENCE = {2: 80.0, 3: 24.0}
"""Cells across the smallest side, by dimension."""
QUICK_REFERENCE = {2: 30.0, 3: 20.0}
MOST = 0.35
"""What is tried costs at most this share of the reference's particle-steps."""
SEED = 7
"""Of what is tried: not one of those that were measured."""

SceneKey = tuple[int, str]
"""Dimension and name of a scene."""


@dataclass(frozen=True, kw_only=True)
class Trial:
    """A scene at the resolution that a tolerance selected for it, against its reference."""

    scene: SceneKey
    tolerance: float
    cells: float
    error: float
    """Over the extent [-]."""

    @property
    def within(self) -> bool:
        """Whether the error is within the tolerance."""
        return self.error <= self.tolerance


def bench(out: Path, *, quick: bool, keep: Path, measured: Path = MEASURED) -> str:
    """Run 20 scenes at what --tolerance selects for 10, 5 and 3 %, each against its own reference: tolerance.md.

    quick: two scenes per dimension, cut short, against coarse references. measured: what --tolerance reads.
    """
    scenes = {
        (dimension, name): (shortened(flow, 0.2) if quick else flow).scene()
        for dimension, flows in UNSEEN.items()
        for name, flow in list(flows.items())[: 2 if quick else None]
    }
    references = QUICK_REFERENCE if quick else REFERENCE
    trials, untried = compute(scenes, measured, RunStore(keep), references)
    return write(out / "tolerance.md", trials, untried, references, len(scenes), quick=quick)


def compute(
    scenes: Mapping[SceneKey, Scene], path: Path, store: RunStore, references: Mapping[int, float]
) -> tuple[list[Trial], dict[tuple[float, int], str]]:
    """The trials, and for which tolerance and dimension why nothing was tried."""
    known = from_mapping(Measurements, read_toml(path)).measured
    selected: list[tuple[SceneKey, float, Resolved]] = []
    untried: dict[tuple[float, int], str] = {}
    for key, scene in scenes.items():
        for tolerance in TOLERANCES:
            try:
                found = resolved(scene, tolerance, known)
            except InputError:
                untried[tolerance, key[0]] = "no measured resolution has a bound within it"
                continue
            # Particles times steps go with the cells to the dimension plus one.
            if (found.cells / references[key[0]]) ** (key[0] + 1) > MOST:
                untried[tolerance, key[0]] = "the grid is too close to the reference's"
                continue
            selected.append((key, tolerance, found))
    exact = {key: runs(scene, own(references[key[0]])) for key, scene in scenes.items()}
    tried = [Run(scene=dataclasses.replace(r.scene, seed=SEED), precision=r.precision) for *_, r in selected]
    store.run([*tried, *(run for group in exact.values() for run in group)])
    solutions = {key: reference(store.run(group)[0]) for key, group in exact.items()}
    return [
        Trial(scene=key, tolerance=tolerance, cells=found.cells, error=score(store.run([run]), solutions[key]).largest)
        for (key, tolerance, found), run in zip(selected, tried, strict=True)
    ], untried


def write(
    path: Path,
    trials: Sequence[Trial],
    untried: Mapping[tuple[float, int], str],
    references: Mapping[int, float],
    scenes: int,
    *,
    quick: bool = False,
) -> str:
    """Write the page, and return its conclusion."""
    lines = []
    for tolerance in TOLERANCES:
        if some := [each for each in trials if each.tolerance == tolerance]:
            within, largest = sum(each.within for each in some), max(some, key=lambda each: each.error)
            met = "met" if within >= COVERAGE * len(some) else "**missed**"
            lines.append(
                f"**{percent(tolerance)}**: {within} of {len(some)} scenes are within it (criterion"
                f" {percent(COVERAGE)}: {met}); the largest error is {percent(largest.error)}, {largest.scene[1]}."
            )
    why = [f"{percent(tolerance)} in {dimension}D: {reason}" for (tolerance, dimension), reason in untried.items()]
    page = Page(
        "Whether `--tolerance` holds",
        command="python -m validation.bench tolerance --out docs",
        conclusion=lines + ([f"Not tried: {'; '.join(why)}."] if why else []),
        quick=quick,
    )
    page.text(f"""
        {scenes} scenes that `--tolerance` was not measured on (`UNSEEN` in `validation/bench/accuracy/flows.py`), each
        run once, with a jitter of its own, at what `--tolerance` selects, against the same scene on {references[2]:g}
        cells across the smallest side in 2D and {references[3]:g} in 3D. The bound is for at least
        {COVERAGE * 10:.0f} of 10 scenes, over the extent; how it is measured: [accuracy.md](accuracy.md). Errors beyond
        the tolerance are bold.
    """)
    rows: dict[SceneKey, dict[str, str]] = {}
    heads = {tolerance: f"{percent(tolerance)}: error (cells)" for tolerance in TOLERANCES}
    for each in trials:
        start = {"": f"{each.scene[0]}D", "scene": each.scene[1]} | dict.fromkeys(heads.values(), "-")
        error = percent(each.error) if each.within else f"**{percent(each.error)}**"
        rows.setdefault(each.scene, start)[heads[each.tolerance]] = f"{error} ({each.cells:.3g})"
    page.table(list(rows.values()))
    return page.write(path)
