"""Rollouts of the surrogate: from rest or from the MPM's first frames, one alone or many side by side."""

import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch

from datasets.scene import Scene
from datasets.trajectory import Floats, Trajectory
from gns.initial import MPM_SECONDS, InitialState, initial_state
from gns.model import checkpoint
from gns.model.simulator import Simulator
from gns.unroll import unroll
from inverse.forward.gns import THINNING_SEED
from mpm.generate import pool


class Start(StrEnum):
    """What a rollout is given."""

    REST = "from rest"
    """Positions and velocities at time 0."""
    FRAMES = "from first frames"
    """The MPM's frames up to `gns.initial.MPM_SECONDS`."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """A rollout that is wanted."""

    model: Path
    scene: Scene
    beginning: Trajectory | None = None
    """The MPM's first frames; without them it starts from rest."""


@dataclass(frozen=True, kw_only=True)
class Rollout:
    """What the surrogate saw."""

    positions: Floats
    """Positions one step apart from time 0 to the end, given ones included [m], shape [K + 1, n, D]."""
    step: float
    """[s]."""
    velocity0: Floats
    """At time 0 [m/s], shape [n, D]."""
    volume: Floats
    """Initial volume of each point [m^D], shape [n]."""
    indices: np.ndarray
    """Which points of the scene they are, shape [n]."""
    seconds: float
    """Of the steps alone [s]."""


def problem(simulator: Simulator, scene: Scene, beginning: Trajectory | None) -> InitialState:
    """Where a rollout begins; always the same points of a scene."""
    return initial_state(scene, simulator.settings, beginning, seed=THINNING_SEED)


def roll(simulator: Simulator, scene: Scene, beginning: Trajectory | None = None) -> Rollout:
    """Roll out a scene."""
    start = problem(simulator, scene, beginning)
    clock = time.perf_counter()
    with torch.no_grad():
        moved = unroll(simulator, start.state, start.conditions, start.steps).numpy()
    return Rollout(
        positions=np.concatenate((start.known, moved[1:])),
        step=simulator.settings.step,
        velocity0=start.velocity0,
        volume=start.conditions.volume.numpy(),
        indices=start.indices,
        seconds=time.perf_counter() - clock,
    )


def first_frames(flow: Trajectory) -> Trajectory:
    """What a rollout is given of the MPM's run."""
    frames = round(MPM_SECONDS / flow.scene.frame_dt) + 1
    # Copied, so that what goes to another process is no more than these.
    return Trajectory(
        positions=flow.positions[:frames].copy(),
        time=flow.time[:frames].copy(),
        velocity0=flow.velocity0,
        friction=flow.friction,
        scene=flow.scene,
    )


class Roller:
    """Rolls tasks out side by side."""

    def __init__(self, executor: Executor | None) -> None:
        self.executor = executor

    def __call__(self, tasks: Sequence[Task]) -> Iterable[Rollout]:
        """The rollouts of `tasks`, in their order, each as soon as it is there."""
        return map(carry_out, tasks) if self.executor is None else self.executor.map(carry_out, tasks)


@contextmanager
def roller(jobs: int) -> Iterator[Roller]:
    """Rolls out on `jobs` processes, with one in this one."""
    if jobs == 1:
        yield Roller(None)
        return
    with pool(jobs) as executor:
        yield Roller(executor)


def carry_out(task: Task) -> Rollout:
    """Roll out a task, in whichever process."""
    return roll(loaded(task.model), task.scene, task.beginning)


@lru_cache(maxsize=4)
def loaded(path: Path) -> Simulator:
    """A model, read once per process."""
    return checkpoint.load(path).simulator.requires_grad_(False)
