"""The target of an inversion: from a problem's observations to one operator, its numbers and their errors."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from datasets import measures
from datasets.errors import InputError, naming
from datasets.particles import particle_count
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from inverse.observations import KINDS
from inverse.observations.measured import Context
from inverse.observations.observation import Joint, Measurement, Part, Values
from inverse.posterior import Matrix
from inverse.problem import Problem


@dataclass(frozen=True, kw_only=True)
class Target(Measurement):
    """What the inversion is given: an operator, its numbers and their errors. What follows reports alone use."""

    front: float = math.nan
    """Front of the deposit [m], with which that of an MPM run is compared; nan where it is not known."""
    cell: float | None = None
    """Of the grid that the observed flow was simulated on [m]; None of a measured one."""
    deposit: NDArray[np.floating] | None = None
    """Where known: positions of the deposit [m], shape [N, D]."""
    truth: dict[str, float] | None = None
    """Where known: the true numbers."""

    def misfit(self, values: Values) -> float:
        """Misfit of `values` [M]; see `Observation.misfit`."""
        return self.observation.misfit(values, self.values)

    def front_error(self, run: Trajectory) -> float:
        """Relative error of the front of the deposit of `run`; nan where the target has none."""
        return (measures.front(run.positions[-1], run.volumes) - self.front) / self.front

    def errors_of(self, combinations: Matrix) -> Matrix:
        """Covariance [r, r] of `combinations` [M, r] of the values by errors of the measurement."""
        if self.covariance is not None:
            return np.asarray(combinations.T @ self.covariance @ combinations)
        return np.asarray((combinations.T * self.deviation**2) @ combinations)


def read_target(problem: Problem, simulate: Callable[[Scene], Trajectory]) -> Target:
    """The target of `problem`; `simulate` makes a twin's flow, its noise is drawn. Raises InputError."""
    measurements = read_each(problem)
    run, truth = None, None
    if problem.target.twin:
        scene = problem.twin_scene
        run, truth = simulate(scene), {each.name: each.kind.read(scene) for each in problem.numbers}
    elif problem.target.trajectory is not None:
        run = read_run(problem, measurements)
    measurements = measurements if run is None else read_each(problem, run)
    target = dataclasses.replace(assembled(problem, measurements, run), truth=truth or None)
    if not problem.target.twin or not target.deviation.any():
        return target
    rng = np.random.default_rng(problem.target.seed)
    if target.covariance is None:
        drawn = target.deviation * rng.standard_normal(len(target.values))
    else:
        variances, axes = np.linalg.eigh(target.covariance)
        drawn = axes @ (np.sqrt(np.maximum(variances, 0.0)) * rng.standard_normal(len(variances)))
    return dataclasses.replace(target, values=target.values + drawn)


def read_each(problem: Problem, run: Trajectory | None = None) -> list[Measurement]:
    """Every observation of `problem` with its numbers, or those of a `run`. Raises InputError, with key or file."""
    context, found = Context(scene=problem.scene, folder=problem.folder, released=problem.released, run=run), []
    for index, settings in enumerate(problem.observations):
        try:
            found.append(KINDS[settings.kind].read(settings, context))
        except InputError as error:
            if settings.csv is not None and error.key in ("", "x", "times", "values"):
                raise error if error.where else error.at(str(problem.folder / settings.csv)) from None
            key = f"observations[{index}].{error.key}".removesuffix(".")
            raise error if error.where else InputError(error.message, key=key) from None
    return found


def read_run(problem: Problem, measurements: Sequence[Measurement]) -> Trajectory:
    """The observed trajectory of a file. Raises InputError, which names it."""
    path = problem.folder / str(problem.target.trajectory)
    run = Trajectory.load(path)
    with naming(path):
        if run.scene.dimension != problem.scene.dimension:
            expected = f"a {problem.scene.dimension}D trajectory as the scene's"
            raise InputError(f"expected {expected}, got {run.scene.dimension}D")
        count = particle_count(problem.scene)
        if run.positions.shape[1] != count and any(each.observation.every_particle for each in measurements):
            got = f"got {run.positions.shape[1]}"
            raise InputError(f"expected the {count} particles of the problem's scene for a deposit, {got}")
    return run


def assembled(problem: Problem, measurements: Sequence[Measurement], run: Trajectory | None) -> Target:
    """The target of measurements; run: the flow that was observed, where it is known."""
    parts: list[Part] = []
    for settings, each in zip(problem.observations, measurements, strict=True):
        same = [part.observation.kind for part in parts].count(settings.kind)
        name = settings.name or (f"{settings.kind} {same + 1}" if same else settings.kind)
        first = parts[-1].numbers.stop if parts else 0
        numbers = slice(first, first + len(each.values))
        parts.append(Part(name=name, observation=each.observation, numbers=numbers))
    only = measurements[0]
    whole = only if len(parts) == 1 else joined(measurements, parts)
    front = math.nan
    if run is not None:
        front = measures.front(run.positions[-1], run.volumes)
    elif whole is only:
        front = only.observation.front(only.values)
    return Target(
        **vars(whole),
        front=front,
        cell=None if run is None else run.scene.domain.cell,
        deposit=None if run is None else run.positions[-1],
    )


def joined(measurements: Sequence[Measurement], parts: Sequence[Part]) -> Measurement:
    """Several observations as one (`Joint`). Raises InputError for numbers without any standard deviation."""
    noise = np.concatenate([each.deviation for each in measurements])
    prior = np.concatenate([each.observation.prior_scatter(each.values) for each in measurements])
    scale = np.hypot(noise, prior)
    for part in parts:
        if not np.all(scale[part.numbers] > 0.0):
            raise InputError(f"expected a noise above 0 for {part.name}, whose numbers are all 0", key="observations")
    blocks = [np.diag(each.deviation**2) if each.covariance is None else each.covariance for each in measurements]
    return Measurement(
        observation=Joint(parts, scale, prior),
        values=np.concatenate([each.values for each in measurements]) / scale,
        deviation=noise / scale,
        covariance=block_diag(*blocks) / np.outer(scale, scale),
        roughness=max(each.roughness for each in measurements),
    )
