"""Scenes by the MPM and by every model, from both starts."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import TypeVar

import numpy as np
from tqdm import tqdm

from datasets import measures
from datasets.particles import particle_count
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from mpm import simulate, simulate_many
from mpm.output.request import LAST
from mpm.simulation import LARGE
from validation.bench.surrogate.courses import Comparison, Truth, compare
from validation.bench.surrogate.models import Model
from validation.bench.surrogate.rollouts import Roller, Start, Task, first_frames

Key = TypeVar("Key")
RECORD = 3.5e8
"""The largest record of a run of which only the deposit is wanted [bytes]."""
FEWER = 20
"""How many times further apart the frames of a larger one are."""
Way = tuple[str, Start]
"""A model's name and what its rollouts start from."""


def truth(scene: Scene, seeds: int) -> Truth:
    """Run a scene and, with other jitters, its likes: small ones side by side, large ones one after the other."""
    scenes = [dataclasses.replace(scene, seed=scene.seed + number) for number in range(seeds)]
    if particle_count(scene) < LARGE:
        flows = simulate_many(scenes)
        flow, deposits = flows[0], [each.positions[-1] for each in flows]
    else:
        flow = simulate(scene)
        deposits = [flow.positions[-1], *(simulate(each, record=LAST).positions[-1] for each in scenes[1:])]
    apart = [np.square(each.astype(np.float64) - deposits[0]).sum(axis=1).mean() for each in deposits[1:]]
    return Truth(
        flow=flow,
        fronts=tuple(measures.front(each) for each in deposits),
        mse=float(np.mean(apart)) if apart else math.nan,
    )


def coarsely(scene: Scene) -> Scene:
    """`scene`, with fewer frames where all of them would not fit into `RECORD`; only its deposit is wanted.

    A frame is a whole number of steps, so that the step is a few per cent longer then, and the flow another one: what
    fits stays as it is.
    """
    size = 4.0 * scene.dimension * particle_count(scene) * scene.frames
    frame_dt = FEWER * scene.frame_dt
    frames = scene.duration / frame_dt
    if size <= RECORD or abs(frames - round(frames)) > 1e-6:
        return scene
    return dataclasses.replace(scene, frame_dt=frame_dt)


def against_mpm(
    scenes: Mapping[Key, Scene], models: Sequence[Model], seeds: int, roller: Roller, what: str
) -> dict[Key, list[Comparison]]:
    """Every scene by the MPM, and by every model from both starts; `what` is said at the bar."""
    found: dict[Key, list[Comparison]] = {}
    ways = [(model, start) for model in models for start in Start]
    with tqdm(total=len(scenes) * len(ways), desc=what, unit="rollout", dynamic_ncols=True) as bar:
        for key, scene in scenes.items():
            known = truth(scene, seeds)
            beginning = first_frames(known.flow)
            tasks = [task(model, start, scene, beginning) for model, start in ways]
            found[key] = []
            for (model, start), rollout in zip(ways, roller(tasks), strict=True):
                found[key].append(compare(model.name, start, rollout, known))
                bar.update()
    return found


def task(model: Model, start: Start, scene: Scene, beginning: Trajectory) -> Task:
    """A rollout of `scene` from `start`."""
    return Task(model=model.path, scene=scene, beginning=beginning if start is Start.FRAMES else None)


def by_way(comparisons: Sequence[Comparison]) -> dict[Way, list[Comparison]]:
    """Grouped by model and start, in the order in which they come."""
    ways: dict[Way, list[Comparison]] = {}
    for each in comparisons:
        ways.setdefault((each.model, each.start), []).append(each)
    return ways
