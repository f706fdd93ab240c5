"""Deposits of MPM runs, kept on disk: a study that was cut short goes on where it was, and a second one is cheap.

A file holds the last frame of a run as a trajectory of one frame (`datasets.trajectory`), with its scene and summary,
and is found again by the scene and the precision. It does not know that the solver has changed since: then the folder
has to go.
"""

import dataclasses
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from tqdm import tqdm

from datasets.particles import particle_count
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from mpm import simulate_many
from mpm.arrays.layout import Precision
from mpm.output.request import LAST
from mpm.process import processors
from mpm.resolution import particle_steps
from mpm.simulation import LARGE


@dataclass(frozen=True, kw_only=True)
class Run:
    """A run that a study asks for."""

    scene: Scene
    precision: Precision = "f32"
    until_rest: bool = False

    @property
    def large(self) -> bool:
        """Whether it takes all threads; small runs go side by side, one per thread."""
        return particle_count(self.scene) >= LARGE

    def path(self, folder: Path) -> Path:
        """Where its deposit is kept."""
        # What a scene leaves at its default says nothing, so that a new key of scenes leaves the old deposits findable.
        told = {
            each.name: getattr(self.scene, each.name)
            for each in dataclasses.fields(self.scene)
            if getattr(self.scene, each.name) != each.default
        }
        text = f"{sorted(told.items())} {self.precision} {'until rest' if self.until_rest else ''}"
        return folder / f"{hashlib.sha256(text.encode()).hexdigest()[:20]}.npz"


def missing(runs: Sequence[Run], folder: Path) -> list[Run]:
    """Those of `runs`, each once, that `folder` does not have yet."""
    return [run for run in dict.fromkeys(runs) if not run.path(folder).exists()]


def compute(runs: Sequence[Run], folder: Path) -> None:
    """Make the deposits of `runs` that `folder` does not have yet, with a bar that counts particle-steps.

    Runs that need the same kernel follow one another, cheap ones first; those side by side cost about the same.
    """
    left = sorted(missing(runs, folder), key=lambda run: (kernel_key(run), particle_steps(run.scene)))
    total = sum(particle_steps(run.scene) for run in left)
    with tqdm(total=total, unit="particle-step", unit_scale=True, disable=total == 0) as bar:
        for key, group in groupby(left, key=kernel_key):
            alike = list(group)
            size = 1 if key[0] else processors()
            for first in range(0, len(alike), size):
                batch = alike[first : first + size]
                flows = simulate_many(
                    [run.scene for run in batch],
                    precision=batch[0].precision,
                    record=dataclasses.replace(LAST, until_rest=batch[0].until_rest),
                )
                for run, flow in zip(batch, flows, strict=True):
                    flow.save(run.path(folder))
                    bar.update(particle_steps(run.scene))


def kernel_key(run: Run) -> tuple[bool, bool, str, int, bool, bool, bool, bool, bool]:
    """What decides which kernel a run needs; large runs first."""
    scene = run.scene
    return (
        run.large,
        run.until_rest,
        run.precision,
        scene.dimension,
        scene.relaxation > 0.0,
        scene.damping > 0.0,
        scene.material.cohesion > 0.0,
        bool(scene.baffles),
        scene.remembers_gaps,
    )


def read_all(runs: Sequence[Run], folder: Path) -> list[Trajectory]:
    """The deposits of runs that `compute` has made: one frame each."""
    return [Trajectory.load(run.path(folder)) for run in runs]
