"""What the accuracy of the MPM is measured on: scenes, resolutions, the reference; the runs; and what they promise."""

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from scipy import stats

from datasets.scene import Scene
from mpm.resolution import COVERAGE, Measured, Resolution, at
from validation.bench.accuracy.flows import MEASURED, OWN_STEP
from validation.bench.accuracy.scores import Outcome, Truth, score, truth
from validation.runs import Run, RunStore

OWN_PARTICLES = 2
"""Particles per axis of the reference and of most that is tried."""
OTHER_PARTICLES, OTHER_STEP = 3, 0.4
"""What else is tried, on `Study.checked`."""


@dataclass(frozen=True, kw_only=True)
class Study:
    """Scenes of one dimension, and what is tried on them."""

    dimension: int
    scenes: Mapping[str, Scene]
    cells: tuple[float, ...]
    """Across the smallest side."""
    checked: tuple[float, ...]
    """Where another step and other particles per axis are tried too."""
    reference: float
    """Cells of the reference."""
    seeds: int
    """Jitters of what is tried."""

    def tried(self) -> Iterator[Resolution]:
        """Every resolution that is compared with the reference, the coarse ones first."""
        for cells in self.cells:
            yield own(cells)
        for cells in self.checked:
            yield own(cells, step_fraction=OTHER_STEP)
            yield own(cells, particles_per_axis=OTHER_PARTICLES)


def own(cells: float, *, step_fraction: float = OWN_STEP, particles_per_axis: int = OWN_PARTICLES) -> Resolution:
    """A resolution with the reference's step and particles per axis, unless told."""
    return Resolution(cells=cells, particles_per_axis=particles_per_axis, step_fraction=step_fraction, precision="f32")


def full() -> tuple[Study, ...]:
    """What ships is measured by."""
    return (
        Study(
            dimension=2,
            scenes={name: flow.scene() for name, flow in MEASURED[2].items()},
            cells=(5.0, 7.0, 10.0, 14.0, 20.0, 28.0, 40.0),
            checked=(7.0, 14.0),
            reference=80.0,
            seeds=3,
        ),
        Study(
            dimension=3,
            scenes={name: flow.scene() for name, flow in MEASURED[3].items()},
            cells=(4.0, 5.0, 7.0, 10.0, 14.0, 18.0),
            checked=(5.0,),
            reference=24.0,
            seeds=2,
        ),
    )


def quick() -> tuple[Study, ...]:
    """The same on a few cells of a few scenes, to try the command."""
    return tuple(
        dataclasses.replace(
            study,
            scenes=dict(list(study.scenes.items())[:3]),
            cells=study.cells[:2],
            checked=study.cells[:1],
            reference=10.0 if study.dimension == 2 else 7.0,
            seeds=2,
        )
        for study in full()
    )


@dataclass(frozen=True, kw_only=True)
class Findings:
    """What a study found."""

    study: Study
    truths: Mapping[str, Truth]
    outcomes: Sequence[Outcome]

    def at(self, resolution: Resolution) -> Outcome:
        """The outcome at a resolution that was tried."""
        return next(each for each in self.outcomes if each.resolution == resolution)

    def lasting(self, resolution: Resolution) -> dict[str, float]:
        """The largest error of each scene here and on all finer grids that differ in nothing else.

        Where errors of both signs cancel, one is small by luck; on finer grids it shows.
        """
        finer = [
            each
            for each in self.outcomes
            if each.resolution.cells >= resolution.cells
            and dataclasses.replace(each.resolution, cells=resolution.cells) == resolution
        ]
        return {name: max(each.scores[name].largest for each in finer) for name in self.study.scenes}

    def promised(self, resolution: Resolution) -> float:
        """The error that a further scene of this kind is promised to stay within: see `promise`."""
        return promise(list(self.lasting(resolution).values()))


def promise(errors: Sequence[float]) -> float:
    """The error that one more scene stays within with probability COVERAGE, from those of the measured scenes.

    The upper prediction limit for one further normal variable (Hahn & Meeker 1991), m + t s sqrt(1 + 1/n) with m and s
    the mean and standard deviation of n errors and t Student's quantile for n - 1 degrees of freedom; and no less than
    the largest of them, which a share n / (n + 1) of further scenes stays within whatever the distribution.
    """
    count = len(errors)
    if count < 2:
        return max(errors)
    t = float(stats.t.ppf(COVERAGE, count - 1))
    limit = float(np.mean(errors)) + t * float(np.std(errors, ddof=1)) * math.sqrt(1.0 + 1.0 / count)
    return max(limit, *errors)


def trials(scene: Scene, resolution: Resolution, seeds: int) -> list[Run]:
    """Runs of `scene` at a resolution, one per seed."""
    finer = at(scene, resolution)
    return [Run(scene=dataclasses.replace(finer, seed=seed), precision=resolution.precision) for seed in range(seeds)]


def all_runs(study: Study) -> list[Run]:
    """What a study asks for."""
    pairs = product(study.scenes.values(), study.tried())
    tried = [run for scene, each in pairs for run in trials(scene, each, study.seeds)]
    best = [run for scene in study.scenes.values() for run in references(study, scene)]
    return tried + best


def references(study: Study, scene: Scene) -> list[Run]:
    """The reference run of a scene."""
    return trials(scene, own(study.reference), 1)


def carry_out(study: Study, folder: Path) -> Findings:
    """Make all runs of a study that `folder` does not have yet, and score them."""
    store = RunStore(folder)
    store.run(all_runs(study))
    truths = {name: truth(store.run(references(study, scene))) for name, scene in study.scenes.items()}
    return Findings(
        study=study,
        truths=truths,
        outcomes=[
            Outcome(
                resolution=each,
                scores={
                    name: score(store.run(trials(scene, each, study.seeds)), truths[name])
                    for name, scene in study.scenes.items()
                },
            )
            for each in study.tried()
        ],
    )


def measured(findings: Sequence[Findings]) -> tuple[Measured, ...]:
    """What `--tolerance` picks from."""
    return tuple(
        Measured(
            dimension=each.study.dimension,
            resolution=outcome.resolution,
            expected=float(f"{outcome.error:.3g}"),
            promised=float(f"{each.promised(outcome.resolution):.3g}"),
            particle_steps=float(f"{outcome.particle_steps:.3g}"),
        )
        for each in findings
        for outcome in each.outcomes
    )
