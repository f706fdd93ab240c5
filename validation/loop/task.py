"""What a loop is given, and runs of the MPM at chosen parameters, compared with the target."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from datasets.errors import InputError
from datasets.scene import Scene
from inverse.answer import MpmRun, Purpose
from inverse.forward import Simulate
from inverse.observations import Values
from inverse.observations.target import Target
from inverse.parameters import Vector
from inverse.posterior import Matrix
from inverse.problem import Bounds, Problem
from mpm import ALL, LAST, Recording, simulate_many
from validation.runs import SHARE, RunStore


@dataclass(frozen=True, kw_only=True)
class Task:
    """What a loop is given: nothing in it changes on the way."""

    problem: Problem
    target: Target
    folder: Path
    """Where runs of the MPM are stored."""
    simulate: Simulate = simulate_many

    @cached_property
    def bounds(self) -> Bounds:
        """The box of the parameters."""
        return self.problem.box

    @cached_property
    def scatter(self) -> Values:
        """Expected standard deviation of each number from flow to flow, shape [M]."""
        return self.target.observation.prior_scatter(self.target.values)

    @property
    def budget(self) -> int:
        """Runs of the MPM that the loop may spend."""
        return self.problem.loop.budget(len(self.problem.parameters))

    @property
    def recorded(self) -> Recording:
        """What an observation requires of a run: the last frame, unless it is one over time."""
        return ALL if self.target.observation.over_time else LAST

    def at(self, points: Matrix) -> list[Vector]:
        """Parameters at points [S, U] of the unit box, to a millionth of the range: a run is found again by them."""
        digits = 6 - np.ceil(np.log10(self.bounds.range)).astype(int)
        return [
            self.bounds.clip(
                np.array([round(float(each), int(count)) for each, count in zip(row, digits, strict=True)])
            )
            for row in self.bounds.at(points)
        ]

    def run(self, points: Matrix, first: int, purpose: Purpose) -> tuple[MpmRun, ...]:
        """Runs at points [S, U] of the unit box, each with a jitter seed of its own; first: number of the first."""
        locations = self.at(points)
        scenes = [self.problem.scene_at(each, self.seed(first + index)) for index, each in enumerate(locations)]
        return self.compared(locations, scenes, purpose)

    def compared(self, locations: Sequence[Vector], scenes: Sequence[Scene], purpose: Purpose) -> tuple[MpmRun, ...]:
        """Runs of `scenes`, which have the parameters `locations`, compared with the target."""
        store = RunStore(self.folder, self.simulate, label=f"{purpose}-")
        flows = store(scenes, record=self.recorded)
        files = [f"{self.folder.name}/{store.file(each, self.recorded).name}" for each in flows]
        return tuple(
            MpmRun(
                purpose=purpose,
                parameters=location,
                trajectory=flow,
                target=self.target,
                seconds=float(flow.summary[SHARE]),
                file=file,
            )
            for location, flow, file in zip(locations, flows, files, strict=True)
        )

    def on_cells(self, scene: Scene, factor: float) -> Scene:
        """`scene` on cells so many times as large. Raises InputError where particles are compared or none fit."""
        if self.target.observation.every_particle:
            raise InputError("expected no deposit, whose particles are others on other cells", key="observations")
        return scene.with_cell(factor * scene.domain.cell)

    def seed(self, number: int) -> int:
        """Jitter seed of a run by its number."""
        return int(np.random.SeedSequence([self.problem.scene.seed, number]).generate_state(1)[0])

    def generator(self, number: int) -> np.random.Generator:
        """Random numbers of a step, the same after a restart."""
        return np.random.default_rng([self.problem.optimiser.seed, number])
