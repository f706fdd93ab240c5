"""Seconds of the surrogate beside those of the MPM, one thread each, nothing beside them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from tqdm import tqdm

from datasets import measures
from datasets.library import read_scene
from datasets.particles import particle_count
from datasets.scene import Scene
from validation.bench.speed.networks import SCENE, RolloutCost, rollout_cost
from validation.bench.surrogate.long_rollouts import sparse
from validation.bench.surrogate.rollouts import ShippedModel, roll_out
from validation.bench.surrogate.scenes import BAFFLES, on_cells, scaled
from validation.report import timing
from validation.report.timing import Spread, TimedRun, spread

CELLS = (56, 100, 200, 400, 560)
"""Across the box of 1 m: about 1, 3, 13, 51 and 100 thousand particles."""
FACTORS = (0.5, 2.0)
"""How many times as large the column is made, on the same cells."""
FINER = 2
"""How many times finer the MPM is run in 3D, too."""


@dataclass(frozen=True, kw_only=True)
class WholeSecond:
    """One second of the tall column by one model, beside the MPM."""

    cost: RolloutCost
    mpm: Spread
    """[s]."""


@dataclass(frozen=True, kw_only=True)
class ModelRun:
    """A rollout from rest."""

    nodes: int
    seconds: float
    front: float
    """[m]."""


@dataclass(frozen=True, kw_only=True)
class MpmRun:
    """A scene at one resolution of the MPM, beside the surrogate at its own."""

    series: str
    """Runs of one series are the same flow on other cells."""
    particles: int
    cell: float
    """[m]."""
    seconds: float
    front: float
    """[m]."""
    models: Mapping[str, ModelRun]


def whole_seconds(models: Sequence[ShippedModel], rounds: int) -> list[WholeSecond]:
    """Rollouts and gradients of the models, and runs of the MPM."""
    torch.set_num_threads(1)
    run = TimedRun(scenes=(read_scene(SCENE),))
    mpm = spread(timing.timed(run).seconds for _ in range(rounds))
    return [WholeSecond(cost=rollout_cost(each.name, each.simulator, rounds), mpm=mpm) for each in models]


def runs_2d(models: Sequence[ShippedModel], *, quick: bool) -> list[MpmRun]:
    """The tall column: the MPM on other cells, and columns of other sizes on the same cells."""
    tall = read_scene(SCENE)
    own = {model.name: model_run(model, tall) for model in models}
    found = []
    for cells in tqdm(CELLS[:3] if quick else CELLS, desc="cells of the MPM", unit="run", dynamic_ncols=True):
        found.append(mpm_run(f"`{SCENE}`", sparse(on_cells(tall, cells)), own))
    for factor in () if quick else FACTORS:
        scene = scaled(tall, factor)
        others = {model.name: model_run(model, scene) for model in models}
        found.append(mpm_run(f"`{SCENE}`, {factor:g} times as large", scene, others))
    return found


def runs_3d(models: Sequence[ShippedModel], *, quick: bool) -> list[MpmRun]:
    """The flows against baffles: the MPM on their own cells and on finer ones."""
    found = []
    for name in tqdm(BAFFLES[:1] if quick else BAFFLES, desc="baffles", unit="scene", dynamic_ncols=True):
        scene = read_scene(name)
        own = {model.name: model_run(model, scene) for model in models}
        cells = round(scene.domain.size[0] / scene.domain.cell)
        for number in (cells,) if quick else (cells, FINER * cells):
            found.append(mpm_run(f"`{name}`", sparse(on_cells(scene, number)), own))
    return found


def model_run(model: ShippedModel, scene: Scene) -> ModelRun:
    """Roll out a scene from rest."""
    rollout = roll_out(model.simulator, scene)
    front = measures.front(rollout.positions[-1])
    return ModelRun(nodes=len(rollout.indices), seconds=rollout.seconds, front=front)


def mpm_run(series: str, scene: Scene, models: Mapping[str, ModelRun]) -> MpmRun:
    """Run the MPM beside."""
    found = timing.timed(TimedRun(scenes=(scene,)))
    return MpmRun(
        series=series,
        particles=particle_count(scene),
        cell=scene.domain.cell,
        seconds=found.seconds,
        front=found.front,
        models=models,
    )
