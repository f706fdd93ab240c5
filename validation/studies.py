"""What the accuracy of the MPM is measured on: scenes, resolutions, the reference; and the runs themselves."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from datasets.library import read_scene
from datasets.scene import Scene
from mpm.layout import Precision
from mpm.resolution import Measured, Resolution, at, particle_steps
from validation import deposits, pareto
from validation.deposits import Run, Way
from validation.scores import Outcome, Truth, score, truth

POINTS = (1, 2, 3)
"""Material points per axis that are tried."""
STEPS = (0.9, 0.4, 0.2)
OWN_POINTS, OWN_STEP = 2, 0.9
"""Of the reference, and where the precisions are compared; the scenes' own."""
OTHER_STEP = 0.4
"""Of a second reference: how far the first one moves with its step."""
FEWEST_POINTS = 2
"""Per axis, of what a tolerance may pick: with one, columns tear apart, the more the finer the grid."""
FRAMES_AS_ONE = 10
"""The reference records this much less: a step then comes closer to its fraction, which frames round down."""


@dataclass(frozen=True, kw_only=True)
class Study:
    """Scenes of one dimension, and what is tried on them."""

    title: str
    dimension: int
    names: tuple[str, ...]
    """Of shipped scenes."""
    cells: tuple[float, ...]
    """Across the characteristic length; the reference has at least twice the finest."""
    reference: float
    """The same of the reference: a quarter of the scenes' own cell."""
    seeds: int
    """Of the reference."""
    steps: bool
    """Whether a second reference at another step is affordable."""
    dearest: float
    """What is tried costs at most this share of the reference's point-steps."""
    remark: str
    """What is to be known of the scenes, for the report."""

    def tried(self, scene: Scene) -> Iterator[Resolution]:
        """Every resolution that is compared with the reference."""
        most = self.dearest * particle_steps(at(scene, own(self.reference, "f64")))
        for cells, points, step in product(self.cells, POINTS, STEPS):
            each = Resolution(cells=cells, particles_per_axis=points, step_fraction=step, precision="f32")
            if particle_steps(at(scene, each)) <= most:
                yield each
        for cells in self.cells:
            yield own(cells, "f64")


STUDIES = (
    Study(
        title="2D: the paper's four columns",
        dimension=2,
        names=("column-short-21", "column-short-42", "column-tall-21", "column-tall-42"),
        cells=(5.0, 10.0, 15.0, 20.0, 30.0, 40.0),
        reference=80.0,
        seeds=3,
        steps=True,
        dearest=0.3,
        remark="""
            Sand of 42 degrees with cohesion breaks along bands that have no width of their own, only the grid's, which
            is the likely reason why the front of the short column goes on moving.
        """,
    ),
    Study(
        title="3D: a mass thrown at two baffles",
        dimension=3,
        names=("baffles-2",),
        cells=(4.0, 5.0, 6.4, 8.0, 10.0, 12.8),
        reference=25.6,
        seeds=1,
        steps=False,
        dearest=0.08,
        remark="""
            The furthest points of this flow stand at the far wall, 2 m from the other one, which holds them there. It
            is one scene: what holds for it may not for another.
        """,
    ),
)


@dataclass(frozen=True, kw_only=True)
class Findings:
    """What a study found."""

    study: Study
    scenes: Mapping[str, Scene]
    truths: Mapping[str, Truth]
    other_step: Mapping[str, Truth]
    """The reference at `OTHER_STEP`, where the study affords it."""
    outcomes: Sequence[Outcome]

    def at_own(self, cells: float, precision: Precision, step_fraction: float = OWN_STEP) -> Outcome:
        """The outcome with the reference's points and, unless told, its step."""
        what = own(cells, precision, step_fraction)
        return next(each for each in self.outcomes if each.resolution == what)


def own(cells: float, precision: Precision, step_fraction: float = OWN_STEP) -> Resolution:
    """A resolution with the reference's points per axis and, unless told, its step."""
    return Resolution(cells=cells, particles_per_axis=OWN_POINTS, step_fraction=step_fraction, precision=precision)


def trials(scene: Scene, each: Resolution, seeds: int) -> list[Run]:
    """Runs of `scene` at a resolution, one per seed; the first has the machine to itself and is timed."""
    finer = at(scene, each)
    return [
        Run(
            scene=dataclasses.replace(finer, seed=seed),
            precision=each.precision,
            way=Way.TOGETHER if seed else Way.ALONE,
        )
        for seed in range(seeds)
    ]


def references(scene: Scene, cells: float, step_fraction: float, seeds: int) -> list[Run]:
    """The reference runs of `scene`, one per seed, on frames of their own."""
    frame_dt = scene.frame_dt * FRAMES_AS_ONE
    frames = scene.duration / frame_dt
    if abs(frames - round(frames)) > 1e-6:
        frame_dt = scene.frame_dt
    finest = dataclasses.replace(at(scene, own(cells, "f64", step_fraction)), frame_dt=frame_dt)
    return [Run(scene=dataclasses.replace(finest, seed=seed), precision="f64", way=Way.WIDE) for seed in range(seeds)]


def carry_out(study: Study, seeds: int, folder: Path) -> Findings:
    """Make all runs of a study that `folder` does not have yet, and score them."""
    scenes = {name: read_scene(name) for name in study.names}
    tried = [list(study.tried(scene)) for scene in scenes.values()]
    common = [each for each in tried[0] if all(each in others for others in tried)]
    runs = {(name, each): trials(scene, each, seeds) for name, scene in scenes.items() for each in common}
    best = {name: references(scene, study.reference, OWN_STEP, study.seeds) for name, scene in scenes.items()}
    other = {name: references(scene, study.reference, OTHER_STEP, 1) for name, scene in scenes.items() if study.steps}
    wanted = [*runs.values(), *best.values(), *other.values()]
    deposits.compute([run for group in wanted for run in group], folder)
    truths = {name: truth(deposits.read_all(group, folder)) for name, group in best.items()}
    return Findings(
        study=study,
        scenes=scenes,
        truths=truths,
        other_step={name: truth(deposits.read_all(group, folder)) for name, group in other.items()},
        outcomes=[
            Outcome(
                resolution=each,
                scores={name: score(deposits.read_all(runs[name, each], folder), truths[name]) for name in scenes},
            )
            for each in common
        ],
    )


def worth(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """The Pareto front: what nothing cheaper beats, by a tenth of a per cent or more."""
    return pareto.front(outcomes, lambda each: each.seconds, lambda each: round(each.error, 3))


def measured(findings: Sequence[Findings]) -> tuple[Measured, ...]:
    """What `--tolerance` picks from."""
    return tuple(
        Measured(
            dimension=each.study.dimension,
            resolution=outcome.resolution,
            error=float(f"{outcome.error:.3g}"),
            worst=float(f"{outcome.worst:.3g}"),
            seconds=float(f"{outcome.seconds:.3g}"),
        )
        for each in findings
        for outcome in each.outcomes
        if outcome.resolution.particles_per_axis >= FEWEST_POINTS
    )
