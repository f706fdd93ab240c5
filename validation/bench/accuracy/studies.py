"""What the accuracy of the MPM is measured on: scenes, resolutions, references; and the bounds that follow."""

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from datasets.scene import Scene
from mpm.resolution import COVERAGE, Measured, Resolution, with_resolution
from validation.bench.accuracy.flows import MEASURED, OWN_STEP
from validation.bench.accuracy.scores import Outcome, Reference, reference, score
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
    """A resolution, by default with the reference's step and particles per axis."""
    return Resolution(cells=cells, particles_per_axis=particles_per_axis, step_fraction=step_fraction, precision="f32")


def full() -> tuple[Study, ...]:
    """The studies that the shipped `resolution.toml` comes from."""
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
    """The same on a few cells of a few scenes."""
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
    """The errors of a study."""

    study: Study
    references: Mapping[str, Reference]
    outcomes: Sequence[Outcome]

    def at(self, resolution: Resolution) -> Outcome:
        """The outcome at a resolution that was tried."""
        return next(each for each in self.outcomes if each.resolution == resolution)

    def lasting(self, resolution: Resolution) -> dict[str, float]:
        """The largest error of each scene here and on all finer grids that differ in nothing else.

        Where errors of both signs cancel, one is small by chance; on finer grids it is not.
        """
        finer = [
            each
            for each in self.outcomes
            if each.resolution.cells >= resolution.cells
            and dataclasses.replace(each.resolution, cells=resolution.cells) == resolution
        ]
        return {name: max(each.scores[name].largest for each in finer) for name in self.study.scenes}

    def bound(self, resolution: Resolution) -> float:
        """The bound on the error of a further scene of this kind: see `prediction_limit`."""
        return prediction_limit(list(self.lasting(resolution).values()))

    def reference_error(self) -> float:
        """The references' own distance from the limit, rms over the scenes, if errors are proportional to the cell [-].

        From n to N cells a front then moves by k (1 / n - 1 / N), and k / N is left.
        """
        n, finest = max(self.study.cells), self.study.reference
        moved = [score.bias for score in self.at(own(n)).scores.values()]
        return math.sqrt(np.mean(np.square(moved))) * n / (finest - n)


def prediction_limit(errors: Sequence[float]) -> float:
    """A bound on the error of one more scene with probability COVERAGE, from the errors of the measured scenes.

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


def runs(scene: Scene, resolution: Resolution, seeds: int = 1) -> list[Run]:
    """Runs of `scene` at a resolution, one per seed."""
    finer = with_resolution(scene, resolution)
    return [Run(scene=dataclasses.replace(finer, seed=seed), precision=resolution.precision) for seed in range(seeds)]


def compute(study: Study, store: RunStore) -> Findings:
    """Make all runs of a study, and score them."""
    exact = {name: runs(scene, own(study.reference)) for name, scene in study.scenes.items()}
    tried = {
        (each, name): runs(scene, each, study.seeds) for each in study.tried() for name, scene in study.scenes.items()
    }
    # All at once, so that those that need the same kernel follow one another.
    store.run([run for group in (*tried.values(), *exact.values()) for run in group])
    references = {name: reference(store.run(group)[0]) for name, group in exact.items()}
    return Findings(
        study=study,
        references=references,
        outcomes=[
            Outcome(
                resolution=each,
                scores={name: score(store.run(tried[each, name]), references[name]) for name in study.scenes},
            )
            for each in study.tried()
        ],
    )


def measured(findings: Sequence[Findings]) -> tuple[Measured, ...]:
    """What `--tolerance` reads."""
    return tuple(
        Measured(
            dimension=each.study.dimension,
            resolution=outcome.resolution,
            expected=float(f"{outcome.error:.3g}"),
            promised=float(f"{each.bound(outcome.resolution):.3g}"),
            particle_steps=float(f"{outcome.particle_steps:.3g}"),
        )
        for each in findings
        for outcome in each.outcomes
    )
