"""Why a row is red: the same scene at half the step and, in 2D, on half the cell; and any without volume correction."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

from tqdm import tqdm

from datasets.scene import Domain, Scene
from validation.bench.stability.case import Case
from validation.bench.stability.flows import simulate_scenes
from validation.bench.stability.verdict import Verdict, judge

HALF_STEP, HALF_CELL, FORGETFUL = "half the step", "half the cell", "no volume correction"
"""What can be changed."""


@dataclass(frozen=True, kw_only=True)
class Probe:
    """A row, changed."""

    change: str
    verdict: Verdict


def half_step(scene: Scene) -> Scene:
    """The scene at half its step."""
    return dataclasses.replace(scene, step_fraction=0.5 * scene.step_fraction)


def half_cell(scene: Scene) -> Scene:
    """The scene on half its cell."""
    return dataclasses.replace(scene, domain=Domain(size=scene.domain.size, cell=0.5 * scene.domain.cell))


def forgetful(scene: Scene) -> Scene:
    """The scene without the volume correction that it has."""
    return dataclasses.replace(scene, volume_correction=False) if scene.remembers_gaps else scene


def probe(cases: Sequence[Case], red: Sequence[Case], bar: "tqdm[None]") -> list[Probe]:
    """In f64: red cases at half the step and, in 2D, on half the cell; all without the volume correction they have."""
    flat = [case for case in red if case.scene.dimension == 2]
    found = []
    for change, variant, group in (
        (HALF_STEP, half_step, red),
        (HALF_CELL, half_cell, flat),
        (FORGETFUL, forgetful, cases),
    ):
        changed = {case.name: variant(case.scene) for case in group}
        changed = {case.name: changed[case.name] for case in group if changed[case.name] != case.scene}
        bar.total = (bar.total or 0) + len(changed)
        flows = simulate_scenes(changed, "f64", bar, {case.name for case in group if case.until_rest})
        for case in group:
            if case.name in flows:
                # What a row is compared with was not changed: without it.
                alone = dataclasses.replace(case, beside="", comparisons=(), precisions=())
                verdict = judge(alone, {"f32": flows, "f64": flows})
                found.append(Probe(change=change, verdict=verdict))
    return found
