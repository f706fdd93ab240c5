"""Scenes -> trajectories, side by side, each in the kernel that it would get alone."""

from collections.abc import Collection, Mapping

from tqdm import tqdm

from datasets.command_line import WorkFailed
from datasets.particles import initial_particles
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from mpm.batch import features_of
from mpm.layout import Features, Precision
from mpm.simulate import Options, simulate, simulate_many

Flow = Trajectory | WorkFailed
"""What a scene came to: a trajectory with fields, or the message of a run that blew up."""


def simulate_scenes(
    scenes: Mapping[str, Scene], precision: Precision, bar: "tqdm[None]", until_rest: Collection[str] = ()
) -> dict[str, Flow]:
    """What each scene came to; `bar` counts them, those named in `until_rest` end when they rest.

    A batch compiles what any of its scenes needs, and a scene without cohesion would not run in the code that it is
    meant to test. So scenes with the same needs run together.
    """
    groups: dict[Features, dict[str, Scene]] = {}
    for name, scene in scenes.items():
        needs = features_of([scene], [initial_particles(scene)], precision, fields=True, until_rest=name in until_rest)
        groups.setdefault(needs, {})[name] = scene
    flows: dict[str, Flow] = {}
    for needs, group in groups.items():
        options: Options = {"precision": precision, "fields": True, "until_rest": needs.rests}
        try:
            trajectories = simulate_many(list(group.values()), **options)
            flows.update(zip(group, trajectories, strict=True))
        except WorkFailed:
            # It does not say which.
            flows.update({name: simulate_one(scene, options) for name, scene in group.items()})
        bar.update(len(group))
    return {name: flows[name] for name in scenes}


def simulate_one(scene: Scene, options: Options) -> Flow:
    """What one scene came to."""
    try:
        options["threads"] = 1
        return simulate(scene, **options)
    except WorkFailed as error:
        return error
