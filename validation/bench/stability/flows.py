"""Scenes -> trajectories, side by side, each in the kernel that it would get alone."""

import dataclasses
from collections.abc import Collection, Mapping

import numpy as np
from tqdm import tqdm

from datasets.command_line import WorkFailed
from datasets.measures import front
from datasets.particles import initial_particles
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from mpm import LAST, WITH_FIELDS, simulate_each, simulate_many
from mpm.arrays.features import Features, features_of
from mpm.arrays.layout import Precision
from validation.bench.stability.deposit import JITTERS

Flow = Trajectory | WorkFailed
"""What a scene came to: a trajectory with fields, or the message of a run that blew up."""


def simulate_scenes(
    scenes: Mapping[str, Scene], precision: Precision, bar: "tqdm[None]", until_rest: Collection[str] = ()
) -> dict[str, Flow]:
    """What each scene came to; `bar` counts them, those named in `until_rest` end when they rest.

    Scenes that need the same code run together, so that the bar moves in between.
    """
    groups: dict[Features, dict[str, Scene]] = {}
    for name, scene in scenes.items():
        needs = features_of(
            [scene],
            [initial_particles(scene)],
            precision,
            record=dataclasses.replace(WITH_FIELDS, until_rest=name in until_rest),
        )
        groups.setdefault(needs, {})[name] = scene
    flows: dict[str, Flow] = {}
    for needs, group in groups.items():
        outcomes = simulate_each(
            list(group.values()), precision=precision, record=dataclasses.replace(WITH_FIELDS, until_rest=needs.rests)
        )
        flows.update(zip(group, outcomes, strict=True))
        bar.update(len(group))
    return {name: flows[name] for name in scenes}


def front_scatter(scene: Scene) -> float:
    """Standard deviation of the front of `scene` over JITTERS jitters of its particles, in f64 [cells]."""
    jitters = [dataclasses.replace(scene, seed=scene.seed + number) for number in range(JITTERS)]
    fronts = [front(flow.positions[-1]) for flow in simulate_many(jitters, precision="f64", record=LAST)]
    return float(np.std(fronts, ddof=1)) / scene.domain.cell
