"""Rollouts of the surrogate from rest or from the MPM's first frames, and the models that make them."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.scene import Scene
from datasets.trajectory import Floats, Trajectory
from gns.model import checkpoint
from gns.model.settings import ModelSettings
from gns.model.simulator import Simulator
from gns.rollout import SHIPPED
from gns.score import START
from gns.start import InitialValueProblem, after_frames, at_rest
from gns.unroll import unroll
from inverse.forward.gns import THINNING_SEED


class Start(StrEnum):
    """What a rollout is given."""

    REST = "from rest"
    """Positions and velocities at time 0."""
    FRAMES = "from first frames"
    """The MPM's frames up to `gns.score.START`."""


@dataclass(frozen=True, kw_only=True)
class ShippedModel:
    """A model on disk."""

    path: Path
    simulator: Simulator
    provenance: Mapping[str, Any]

    @property
    def name(self) -> str:
        """The file's name without its ending."""
        return self.path.stem

    @property
    def settings(self) -> ModelSettings:
        """Resolution and sizes."""
        return self.simulator.settings

    @property
    def updates(self) -> int:
        """Of its training and of the models that it began with."""
        count, at = 0, self.provenance
        while at:
            count += at.get("log", {}).get("updates", 0)
            at = at.get("begin") or {}
        return count


def load(paths: Sequence[Path]) -> list[ShippedModel]:
    """The models at `paths`, or those that ship. Raises InputError."""
    found = list(paths) or sorted(SHIPPED.parent.glob("*.pt"))
    names = [path.stem for path in found]
    if not found or len(set(names)) < len(names):
        raise InputError(f"expected models of different names, got {', '.join(names) or 'none'}", key="--models")
    stored = {path: checkpoint.load(path) for path in found}
    return [
        ShippedModel(path=path, simulator=each.simulator.requires_grad_(False), provenance=each.provenance)
        for path, each in stored.items()
    ]


@dataclass(frozen=True, kw_only=True)
class RolloutTask:
    """A rollout to be made, perhaps in another process."""

    model: Path
    scene: Scene
    beginning: Trajectory | None = None
    """The MPM's first frames; without them it starts from rest."""


@dataclass(frozen=True, kw_only=True)
class Rollout:
    """Positions that the surrogate predicts."""

    positions: Floats
    """One step apart from time 0 to the end, given ones included [m], shape [K + 1, n, D]."""
    step: float
    """[s]."""
    velocity0: Floats
    """At time 0 [m/s], shape [n, D]."""
    volume: Floats
    """Initial volume of each node [m^D], shape [n]."""
    indices: NDArray[np.int64]
    """Which particles of the scene they are, shape [n]."""
    seconds: float
    """Of the steps alone [s]."""


def initial(simulator: Simulator, scene: Scene, beginning: Trajectory | None = None) -> InitialValueProblem:
    """The start of a rollout; always of the same particles of a scene."""
    rng = np.random.default_rng(THINNING_SEED)
    if beginning is None:
        return at_rest(scene, simulator.settings, rng)
    return after_frames(beginning, scene, simulator.settings, rng)


def roll_out(simulator: Simulator, scene: Scene, beginning: Trajectory | None = None) -> Rollout:
    """Roll out a scene."""
    start = initial(simulator, scene, beginning)
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
    """The frames of the MPM's run that a rollout is given."""
    frames = round(START / flow.scene.frame_dt) + 1
    # Copied, so that no more than these goes to another process.
    return Trajectory(
        positions=flow.positions[:frames].copy(),
        time=flow.time[:frames].copy(),
        velocity0=flow.velocity0,
        friction=flow.friction,
        scene=flow.scene,
    )


def run_task(task: RolloutTask) -> Rollout:
    """Roll out a task, in whichever process."""
    return roll_out(loaded(task.model), task.scene, task.beginning)


@cache
def loaded(path: Path) -> Simulator:
    """A model, read once per process."""
    return checkpoint.load(path).simulator.requires_grad_(False)
