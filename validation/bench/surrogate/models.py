"""The models that are compared, and rollouts by them."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

import gns
from datasets.command_line import WorkFailed
from datasets.errors import InputError
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from gns.inference import model_path, models
from gns.model import checkpoint
from gns.model.settings import ModelSettings
from gns.model.simulator import Simulator
from gns.training.convergence import total_updates


@dataclass(frozen=True, kw_only=True)
class Model:
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

    @cached_property
    def digest(self) -> str:
        """Of the file: what is stored of one model is not found for another."""
        return hashlib.sha256(self.path.read_bytes()).hexdigest()[:16]

    @property
    def updates(self) -> int:
        """Updates of its training and of the models that it began with."""
        return total_updates(self.provenance)


def load(names: Sequence[Path]) -> list[Model]:
    """The models of these files or names, or those that ship. Raises InputError."""
    found = [model_path(name) for name in names] or models()
    stems = [path.stem for path in found]
    if not found or len(set(stems)) < len(stems):
        raise InputError(f"expected models of different names, got {', '.join(stems) or 'none'}", key="--model")
    stored = {path: checkpoint.load(path) for path in found}
    return [
        Model(path=path, simulator=each.simulator.requires_grad_(False), provenance=each.provenance)
        for path, each in stored.items()
    ]


@dataclass(frozen=True, kw_only=True)
class RolloutTask:
    """A rollout from the scene's start, to be made in another process."""

    model: Path
    scene: Scene


def roll_out(task: RolloutTask) -> Trajectory:
    """The rollout of a task, in whichever process; its summary has the seconds of its steps, `wall_s`.

    Raises WorkFailed for positions that are not finite.
    """
    found = gns.simulate(task.scene, model=loaded(task.model))
    if not np.isfinite(found.positions).all():
        raise WorkFailed(f"a rollout by {task.model} is not finite")
    return found


@cache
def loaded(path: Path) -> Simulator:
    """A model, read once per process."""
    return gns.load(path)
