"""Deposits of MPM runs, kept on disk: a study that was cut short goes on where it was, and a second one is cheap.

A file holds the last frame of a run as a trajectory of one frame (`datasets.trajectory`), with its scene and summary,
and is found again by the scene and the precision. It does not know that the solver has changed since: then the folder
has to go.
"""

import dataclasses
import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import groupby
from pathlib import Path

from tqdm import tqdm

from datasets.scene import Scene
from datasets.trajectory import Trajectory
from mpm.layout import Precision
from mpm.recording import LAST
from mpm.resolution import particle_steps
from mpm.simulate import simulate, simulate_many


class Way(IntEnum):
    """How a run uses the machine."""

    ALONE = 0
    """On one thread, nothing beside it: its wall time is what the run costs."""
    TOGETHER = 1
    """Others on the other threads; its wall time means nothing."""
    WIDE = 2
    """One scene on all threads."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """A run that a study asks for."""

    scene: Scene
    precision: Precision
    way: Way

    def path(self, folder: Path) -> Path:
        """Where its deposit is kept."""
        # What a scene leaves at its default says nothing, so that a new key of scenes leaves the old deposits findable.
        told = {
            each.name: getattr(self.scene, each.name)
            for each in dataclasses.fields(self.scene)
            if getattr(self.scene, each.name) != each.default
        }
        text = f"{sorted(told.items())} {self.precision} {'timed' if self.way is Way.ALONE else ''}"
        return folder / f"{hashlib.sha256(text.encode()).hexdigest()[:20]}.npz"


def compute(runs: Sequence[Run], folder: Path) -> None:
    """Make the deposits of `runs` that `folder` does not have yet, with a bar that counts point-steps."""
    missing = [run for run in dict.fromkeys(runs) if not run.path(folder).exists()]
    # Taichi starts anew for another precision or another number of threads: few changes, cheap runs first.
    missing.sort(key=lambda run: (run.way, run.precision))
    total = sum(particle_steps(run.scene) for run in missing)
    with tqdm(total=total, unit="point-step", unit_scale=True, disable=total == 0) as bar:
        for (way, precision), group in groupby(missing, key=lambda run: (run.way, run.precision)):
            alike = list(group)
            size = (os.cpu_count() or 1) if way is Way.TOGETHER else 1
            for first in range(0, len(alike), size):
                batch = alike[first : first + size]
                scenes = [run.scene for run in batch]
                if way is Way.TOGETHER:
                    flows = simulate_many(scenes, precision=precision, record=LAST)
                else:
                    threads = 1 if way is Way.ALONE else None
                    flows = [simulate(scenes[0], precision=precision, threads=threads, record=LAST)]
                for run, flow in zip(batch, flows, strict=True):
                    flow.save(run.path(folder))
                    bar.update(particle_steps(run.scene))


def read_all(runs: Sequence[Run], folder: Path) -> list[Trajectory]:
    """The deposits of runs that `compute` has made: one frame each."""
    return [Trajectory.load(run.path(folder)) for run in runs]
