"""Seconds of the surrogate beside those of the MPM, one thread each, nothing beside them."""

import dataclasses
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import torch
from tqdm import tqdm

from datasets import measures
from datasets.library import read_scene
from datasets.particles import particle_count
from datasets.scene import Scene
from gns.unroll import step_activation_bytes, unroll
from inverse.forward.gns import MEMORY_GIB
from inverse.observations import build
from inverse.settings import ObservationSettings
from validation.bench.surrogate.held_out import coarsely
from validation.bench.surrogate.models import Model
from validation.bench.surrogate.rollouts import problem, roll
from validation.bench.surrogate.scenes import BAFFLES, on_cells, scaled
from validation.report import timing
from validation.report.timing import Run, Spread, turns

TALL = "column-tall-42"
CELLS = (56, 100, 200, 400, 560)
"""Across the box of 1 m: about 1, 3, 13, 51 and 100 thousand points."""
FACTORS = (0.5, 2.0)
"""How many times as large the column is made, on the same cells."""
FINER = 2
"""How many times finer the MPM is run in 3D, too."""
MPM = "MPM"


@dataclass(frozen=True, kw_only=True)
class WholeSecond:
    """The tall column for its whole second."""

    mpm: Spread
    """[s]."""
    forward: Mapping[str, Spread]
    """By model [s]."""
    gradient: Mapping[str, Spread]
    """Forward and backward, by model [s]."""
    points: Mapping[str, int]
    kept_steps: Mapping[str, int]
    """Steps whose activations stay in memory, of all of them."""


@dataclass(frozen=True, kw_only=True)
class Lap:
    """A model on a scene."""

    points: int
    seconds: float
    front: float
    """[m]."""


@dataclass(frozen=True, kw_only=True)
class Race:
    """A scene at one resolution of the MPM."""

    series: str
    """Which scenes it belongs to: of one series, all are the same flow on other cells."""
    points: int
    """Of the MPM."""
    cell: float
    """Of the MPM [m]."""
    seconds: float
    """Of the MPM [s]."""
    front: float
    """Of the MPM [m]."""
    laps: Mapping[str, Lap]
    """By model."""


def whole_second(models: Sequence[Model], rounds: int) -> WholeSecond:
    """Time the MPM, the rollouts and the gradients in turn."""
    torch.set_num_threads(1)
    scene = read_scene(TALL)
    work = {(MPM, ""): partial(mpm_seconds, scene)}
    points, kept = {}, {}
    for model in models:
        start = problem(model.simulator, scene, None)
        points[model.name] = len(start.indices)
        kept[model.name] = kept_steps(model, scene)
        work[model.name, "forward"] = partial(forward_seconds, model, scene)
        work[model.name, "gradient"] = partial(gradient_seconds, model, scene, kept[model.name])
    took = {key: Spread.of(values) for key, values in turns(work, rounds, "a whole second").items()}
    return WholeSecond(
        mpm=took[MPM, ""],
        forward={model.name: took[model.name, "forward"] for model in models},
        gradient={model.name: took[model.name, "gradient"] for model in models},
        points=points,
        kept_steps=kept,
    )


def mpm_seconds(scene: Scene) -> float:
    """Of one run."""
    return timing.timed(Run(scenes=(scene,))).seconds


def forward_seconds(model: Model, scene: Scene) -> float:
    """Of one rollout."""
    return roll(model.simulator, scene).seconds


def kept_steps(model: Model, scene: Scene) -> int:
    """How many steps keep their activations in the memory that the inversion allows."""
    start = problem(model.simulator, scene, None)
    size = step_activation_bytes(model.simulator, start.state, start.conditions)
    return min(start.steps, int(MEMORY_GIB * 2**30 / size))


def gradient_seconds(model: Model, scene: Scene, kept: int) -> float:
    """Of the front and its slope over tan(phi)."""
    start = problem(model.simulator, scene, None)
    observation = build(ObservationSettings(kind="front"), scene)
    clock = time.perf_counter()
    friction = torch.tensor(scene.material.friction, requires_grad=True)
    conditions = dataclasses.replace(start.conditions, friction=friction.expand_as(start.conditions.friction))
    deposit = unroll(model.simulator, start.state, conditions, start.steps, kept_steps=kept)[-1]
    (front,) = observation.smooth(deposit, start.conditions.volume)
    torch.autograd.grad(front, friction)
    return time.perf_counter() - clock


def races_2d(models: Sequence[Model], cells: Sequence[int] = CELLS, factors: Sequence[float] = FACTORS) -> list[Race]:
    """The tall column: the MPM on other cells, and columns of other sizes on the same cells."""
    tall = read_scene(TALL)
    laps = {model.name: lap(model, tall) for model in models}
    with tqdm(total=len(cells) + len(factors), desc="against the MPM, 2D", unit="scene", dynamic_ncols=True) as bar:
        found = []
        for number in cells:
            found.append(race(f"`{TALL}`", coarsely(on_cells(tall, number)), laps))
            bar.update()
        for factor in factors:
            scene = scaled(tall, factor)
            name = f"`{TALL}`, {factor:g} times as large"
            found.append(race(name, scene, {model.name: lap(model, scene) for model in models}))
            bar.update()
    return found


def races_3d(models: Sequence[Model], names: Sequence[str] = BAFFLES, finer: int = FINER) -> list[Race]:
    """The flows against baffles: the MPM on their own cells and on finer ones."""
    found = []
    with tqdm(total=2 * len(names), desc="against the MPM, 3D", unit="scene", dynamic_ncols=True) as bar:
        for name in names:
            scene = read_scene(name)
            laps = {model.name: lap(model, scene) for model in models}
            own = round(scene.domain.size[0] / scene.domain.cell)
            for cells in dict.fromkeys((own, finer * own)):
                found.append(race(f"`{name}`", coarsely(on_cells(scene, cells)), laps))
                bar.update()
    return found


def lap(model: Model, scene: Scene) -> Lap:
    """Roll out a scene from rest."""
    rollout = roll(model.simulator, scene)
    return Lap(points=len(rollout.indices), seconds=rollout.seconds, front=measures.front(rollout.positions[-1]))


def race(series: str, scene: Scene, laps: Mapping[str, Lap]) -> Race:
    """Run the MPM beside."""
    took = timing.timed(Run(scenes=(scene,)))
    return Race(
        series=series,
        points=particle_count(scene),
        cell=scene.domain.cell,
        seconds=took.seconds,
        front=took.front,
        laps=laps,
    )
