"""The gradient of a misfit in the velocities of a column's blocks: by AD, and by differences of coarse and fine MPM.

The paper's ten layers, whole and each cut into ten blocks (`validation.bench.efficiency.gradients`); the observation is
the position of every particle of the deposit. The reference is the mean over pairs of jitter seeds, one of the run and
one of its target, of central differences of the MPM on fine cells.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from datasets.records import Record
from inverse.forward.gns import GnsSource
from inverse.forward.interface import Simulate
from inverse.forward.mpm import MpmForward
from inverse.jacobian import automatic
from inverse.observations.reading import read_target
from inverse.observations.target import Target
from inverse.parameters import Vector
from inverse.problem import Problem
from mpm import LAST, simulate_many
from validation.bench.efficiency.gradients import blocks_problem, differences, sampled
from validation.bench.surrogate.models import Model
from validation.bench.surrogate.price import coarse, mpm_method
from validation.bench.surrogate.records import Records, digest
from validation.runs import RunStore

CUTS = ((1, 10), (10, 10))
"""Blocks along x and along y."""
CRITERIA = {10: 0.98, 100: 0.95}
"""Of the cosine, by number of unknowns."""
REFERENCE_CELLS = 56
"""Across the height of the column: the 5 mm of the training data."""
CELLS = (5, 7, 10, 14, 20, 28)
"""Of the coarse MPM."""
WARM_UP_S = 0.1


@dataclass(frozen=True, kw_only=True)
class Slope(Record):
    """A gradient of the misfit."""

    seconds: float
    """Of all unknowns, on one thread [s]; of more than are computed, multiplied."""
    values: tuple[float, ...]
    """In the unknowns that are compared [m^2 / (m/s)]."""

    @property
    def vector(self) -> Vector:
        """The values."""
        return np.array(self.values)


@dataclass(frozen=True, kw_only=True)
class Compared:
    """A gradient beside the reference."""

    method: str
    seconds: float
    """[s]."""
    cosine: float
    """Of the angle between the two [-]."""
    length: float
    """Over that of the reference [-]."""


@dataclass(frozen=True, kw_only=True)
class Gradients:
    """All gradients in some number of unknowns."""

    unknowns: int
    compared: int
    """Unknowns whose derivatives are compared."""
    cells: int
    """Of the reference, across the column."""
    own: float
    """Mean cosine between the gradient of one pair of seeds and the mean of the others; nan of one pair [-]."""
    models: Sequence[Compared]
    mpm: Sequence[Compared]
    """Differences of one pair of seeds, coarse cells first."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What is measured."""

    cuts: Sequence[tuple[int, int]] = CUTS
    reference_cells: int = REFERENCE_CELLS
    cells: Sequence[int] = CELLS
    pairs: int = 4
    """Of jitter seeds."""


def problem_on(columns: int, layers: int, cells: int, pair: int = 0, *, duration: float | None = None) -> Problem:
    """The velocities of the blocks on so many cells across the column, with a pair of jitter seeds."""
    problem = blocks_problem(columns, layers, duration=duration)
    return dataclasses.replace(
        problem,
        scene=dataclasses.replace(coarse(problem.scene, cells), seed=2 * pair),
        target=dataclasses.replace(problem.target, seed=2 * pair + 1),
    )


def target_of(problem: Problem, simulate: Simulate) -> Target:
    """The deposit at the true velocities."""
    return read_target(problem, lambda scene: simulate([scene], record=LAST)[0])


def by_differences(problem: Problem, simulate: Simulate) -> Slope:
    """The gradient by central differences of the MPM."""
    target = target_of(problem, simulate)
    forward = MpmForward(problem, target.observation, simulate)
    components = target.observation.components
    seconds, slope = differences(forward, target.values, problem, sampled(len(problem.parameters)), components)
    return Slope(seconds=seconds, values=tuple(slope.tolist()))


def by_model(problem: Problem, model: Model, target: Target) -> Slope:
    """The gradient by automatic differentiation of a rollout, against the MPM's target."""
    forward = GnsSource(model.simulator, problem, target.observation).start(None)
    components = target.observation.components
    found = automatic(forward, forward.select(target.values), components=components)(problem.initial)
    chosen = sampled(len(problem.parameters))
    return Slope(seconds=found.forward_s + found.backward_s, values=tuple(found.slope[chosen].tolist()))


def measure(models: Sequence[Model], keep: Path, plan: Plan) -> list[Gradients]:
    """All gradients of all cuts; runs and gradients that `keep` has are not made again."""
    torch.set_num_threads(1)
    store = RunStore(keep / "velocities")
    stored = Records(keep / "velocities.json", Slope)
    one_thread: Simulate = partial(simulate_many, threads=1)
    found = []
    for columns, layers in tqdm(plan.cuts, desc="velocities", unit="cut", dynamic_ncols=True):
        fine = [problem_on(columns, layers, plan.reference_cells, pair) for pair in range(plan.pairs)]
        slopes = [by_differences(problem, store).vector for problem in fine]
        target = target_of(fine[0], store)
        short = problem_on(columns, layers, plan.reference_cells, duration=WARM_UP_S)
        rows: dict[str, Slope] = {}
        for model in models:
            key = digest(model.digest, fine[0].scene, fine[0].target.seed)
            if key not in stored.found:
                # Kernels are compiled, or read from their cache, at a first call.
                by_model(short, model, target_of(short, store))
            rows[model.name] = stored.made(key, partial(by_model, fine[0], model, target))
        for cells in plan.cells:
            problem = problem_on(columns, layers, cells)
            key = digest(problem.scene, problem.target.seed)
            rows[mpm_method(cells)] = stored.made(key, partial(by_differences, problem, one_thread))
        names = [model.name for model in models]
        found.append(gradients(len(fine[0].parameters), slopes, rows, names, plan.reference_cells))
    return found


def gradients(
    unknowns: int, slopes: Sequence[Vector], rows: dict[str, Slope], models: Sequence[str], cells: int
) -> Gradients:
    """Gradients by method beside the mean of the `slopes` of all pairs of seeds, on so many cells."""
    reference = np.mean(slopes, axis=0)
    compared = [
        Compared(
            method=method,
            seconds=row.seconds,
            cosine=cosine(row.vector, reference),
            length=float(np.linalg.norm(row.vector) / np.linalg.norm(reference)),
        )
        for method, row in rows.items()
    ]
    total = np.sum(slopes, axis=0)
    alone = [cosine(slope, total - slope) for slope in slopes] if len(slopes) > 1 else [float("nan")]
    return Gradients(
        unknowns=unknowns,
        compared=len(reference),
        cells=cells,
        own=float(np.mean(alone)),
        models=[each for each in compared if each.method in models],
        mpm=[each for each in compared if each.method not in models],
    )


def cosine(a: Vector, b: Vector) -> float:
    """Of the angle between two vectors [-]."""
    return float(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)))
