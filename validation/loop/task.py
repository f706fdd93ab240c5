"""The forward model of the loop: runs of the MPM at chosen parameters, compared with the target."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from datasets.errors import InputError
from datasets.flow.trajectory import Trajectory
from datasets.scene import Scene
from inverse.answer import MpmRun, Purpose
from inverse.forward import Simulate
from inverse.observations import Values
from inverse.observations.observation import recording
from inverse.observations.target import Target
from inverse.parameters import Vector
from inverse.posterior import Matrix
from inverse.problem import Problem
from inverse.search.inference import Inference
from inverse.search.waves import WaveSearch, jitter_seed
from mpm import simulate_many
from validation.run_store import SHARE, Run, RunStore

Loop = WaveSearch[MpmRun, Inference]


@dataclass(frozen=True, kw_only=True)
class Task:
    """The input of a loop, which never changes it."""

    problem: Problem
    target: Target
    folder: Path  # of the stored MPM runs
    simulate: Simulate = simulate_many

    @cached_property
    def scatter(self) -> Values:
        """Expected standard deviation of each number from flow to flow, shape [M]."""
        return self.target.observation.prior_scatter(self.target.values)

    def at(self, points: Matrix) -> list[Vector]:
        """Parameters at points [S, U] of the unit box, rounded to a millionth of the range: they identify a run."""
        box = self.problem.box
        digits = (6 - np.ceil(np.log10(box.range)).astype(int)).tolist()
        rounded = [[*map(round, row, digits)] for row in box.at(points).tolist()]
        return [*np.clip(np.reshape(rounded, points.shape), box.lower, box.upper)]

    def __call__(self, points: Matrix, first: int, *, purpose: Purpose = Purpose.WAVE) -> tuple[MpmRun, ...]:
        """Runs at points [S, U] of the unit box, each with its own jitter seed; first: number of the first run."""
        locations, problem = self.at(points), self.problem
        seeds = [jitter_seed(problem.scene.seed, first + index) for index in range(len(locations))]
        return self.compared(locations, [*map(problem.scene_at, locations, seeds)], purpose)

    def compared(self, locations: Sequence[Vector], scenes: Sequence[Scene], purpose: Purpose) -> tuple[MpmRun, ...]:
        """Runs of `scenes`, which have the parameters `locations`, compared with the target."""
        store = RunStore(self.folder, self.simulate, label=f"{purpose}-")
        runs = [Run(scene=scene, record=recording([self.target.observation])) for scene in scenes]
        flows = store.run(runs)
        files = [f"{self.folder.name}/{store.path(run).name}" for run in runs]
        return tuple(self.run(*triple, purpose) for triple in zip(locations, flows, files, strict=True))

    def run(self, location: Vector, flow: Trajectory, file: str = "", purpose: Purpose = Purpose.KNOWN) -> MpmRun:
        """A flow with the parameters `location` [U], compared with the target; file: where it is stored."""
        seconds = float(flow.summary.get(SHARE, 0.0)) if file else 0.0
        return MpmRun.of(flow, location, self.problem, self.target, purpose=purpose, seconds=seconds, file=file)

    def on_cells(self, scene: Scene, factor: float) -> Scene:
        """`scene` on cells `factor` times as large. Raises InputError if particles are compared or no cells fit."""
        if self.target.observation.every_particle:
            raise InputError("expected no deposit, whose particles are others on other cells", key="observations")
        return scene.with_cell(factor * scene.domain.cell)

    def search(self, known: tuple[MpmRun, ...] = (), runs: tuple[MpmRun, ...] = ()) -> Loop:
        """The search by runs of the MPM; known: runs for other targets; runs: those already made for this one."""
        inference = Inference(problem=self.problem, target=self.target, scatter=self.scatter)
        seed, budget = self.problem.optimiser.seed, self.problem.loop.budget(len(self.problem.parameters))
        return WaveSearch(model=self, knowledge=inference, seed=seed, budget=budget, known=known, runs=runs)
