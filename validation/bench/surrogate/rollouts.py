"""Rollouts of the surrogate from rest or from the MPM's first frames, and the models that make them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import gns
from datasets.errors import InputError
from datasets.scene import Scene
from datasets.trajectory import Floats, Trajectory
from gns.inference import models
from gns.initial import initial_state
from gns.model import checkpoint
from gns.model.settings import ModelSettings
from gns.model.simulator import Simulator


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
    found = list(paths) or models()
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
    frames: Trajectory | None = None
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


def roll_out(simulator: Simulator, scene: Scene, frames: Trajectory | None = None) -> Rollout:
    """Roll out a scene from rest or from the MPM's first frames; always the same particles of a scene."""
    flow = gns.simulate(scene, model=simulator, start=frames)
    assert flow.volume is not None
    return Rollout(
        positions=flow.positions,
        step=flow.scene.frame_dt,
        velocity0=flow.velocity0,
        volume=flow.volume,
        indices=initial_state(scene, simulator.settings, frames).indices,
        seconds=flow.summary["wall_s"],
    )


def run_task(task: RolloutTask) -> Rollout:
    """Roll out a task, in whichever process."""
    return roll_out(loaded(task.model), task.scene, task.frames)


@cache
def loaded(path: Path) -> Simulator:
    """A model, read once per process."""
    return gns.load(path)
