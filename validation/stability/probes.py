"""Why a row is red: the same scene at half the step, in 2D on half the cell, and without its volume correction."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

from tqdm import tqdm

from datasets.scene import Domain, Scene
from validation.stability.case import Case
from validation.stability.flows import simulate_scenes
from validation.stability.verdict import Verdict, judge


@dataclass(frozen=True, kw_only=True)
class Probe:
    """A red row, changed."""

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


def probe(cases: Sequence[Case], bar: "tqdm[None]") -> list[Probe]:
    """Every case at half the step and, in 2D, on half the cell, in f64; and without a volume correction that it has."""
    found = []
    for change, variant, dimensions in (
        ("half the step", half_step, (2, 3)),
        ("half the cell", half_cell, (2,)),
        ("no volume correction", forgetful, (2, 3)),
    ):
        changed = {case.name: variant(case.scene) for case in cases if case.scene.dimension in dimensions}
        changed = {case.name: changed[case.name] for case in cases if changed.get(case.name, case.scene) != case.scene}
        bar.total = (bar.total or 0) + len(changed)
        flows = simulate_scenes(changed, "f64", bar, {case.name for case in cases if case.until_rest})
        for case in cases:
            if case.name in flows:
                # What a row is compared with was not changed: without it.
                alone = dataclasses.replace(case, beside="", comparisons=(), precisions=())
                verdict = judge(alone, {"f32": flows, "f64": flows})
                found.append(Probe(change=change, verdict=verdict))
    return found
