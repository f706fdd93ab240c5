"""Proposals: the minimum of the surrogate as it is, then of the corrected surrogate within a trust region.

A later step minimises, in a box of `radius` around the best MPM run u_k and inside the bounds,

    |y(u) - y*|^2 / n + rho^2 |(u - u_k) / radius|^2,    rho^2 = DAMPING * |y(u_k) - y*|^2 / n

with y the corrected surrogate (`validation.loop.correct`) and n the number of things compared. The second term
(Levenberg, A method for the solution of certain non-linear problems in least squares, Quart. Appl. Math. 2 (1944)
164-168) keeps parameters that hardly change the observation from running off while the misfit is still large.
"""

import dataclasses
import time

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import qmc

from inverse.forward.interface import Evaluation, Surrogate
from inverse.jacobian import Evaluate, automatic, by_ad, central, one_sided
from inverse.observations import Values
from inverse.optimise import best, minimise
from inverse.parameters import Vector
from inverse.result import Minimum, Round
from inverse.settings import Method
from validation.loop.check import History, Task
from validation.loop.correct import Corrected, corrected

FIRST_STEP = 0.01
"""Of a finite difference of the surrogate, as a fraction of a parameter's range: well above its rounding."""
STEP = 0.02
"""The same of the corrected surrogate."""
BACKWARD = 4.0
"""Cost of a backward pass, in predictions."""
SAME = 0.02
"""Two minima closer than this in every parameter, as a fraction of its range, are one."""
DAMPING = 0.02
"""Of a step; see above."""
EVALUATIONS = 4
"""Predictions of a round besides those of its Jacobians: it starts at an MPM run."""


def first(task: Task, surrogate: Surrogate) -> tuple[Vector, History]:
    """The lowest minimum of the surrogate as it is, by the problem's optimiser from its starting points."""
    problem, settings = task.problem, task.problem.optimiser
    evaluate = cheapest(task, surrogate)
    rates = [each.learning_rate for each in problem.parameters]
    stages = []
    for number, start in enumerate(starting_points(task)):
        title = "surrogate" if settings.starts == 1 else f"surrogate, start {number}"
        records = minimise(evaluate, start, task.bounds, settings, title, rates)
        stages.append(Round(number=0, evaluations=tuple(records), start=number))
    stages.sort(key=lambda stage: best(stage.evaluations).loss)
    minima = [best(stage.evaluations) for stage in stages]
    distinct = minima[:1]
    for other in minima[1:]:
        if all(task.distance(other.parameters, each.parameters) > SAME for each in distinct):
            distinct.append(other)
    history = History(
        rounds=(stages[0],),
        other_starts=tuple(sorted(stages[1:], key=lambda stage: stage.start)),
        other_minima=tuple(Minimum(parameters=each.parameters, loss=each.loss) for each in distinct[1:]),
    )
    return task.rounded(minima[0].parameters), history


def starting_points(task: Task) -> list[Vector]:
    """The problem's own start, and others that fill the bounds evenly (Sobol's sequence, scrambled)."""
    problem, settings = task.problem, task.problem.optimiser
    sobol = qmc.Sobol(len(problem.parameters), seed=np.random.default_rng(settings.seed))
    count = settings.starts - 1
    # The sequence is balanced in powers of two.
    points = sobol.random_base2(max(0, (count - 1).bit_length()))[:count] if count else []
    return [problem.initial, *(task.bounds.lower + point * task.bounds.range for point in points)]


def cheapest(task: Task, surrogate: Surrogate) -> Evaluate:
    """Loss and gradient of `surrogate`: one backward pass; for a Jacobian, differences where they cost less."""
    target, components = surrogate.select(task.target.values), task.observation.components
    if task.problem.optimiser.method is not Method.GAUSS_NEWTON:
        return automatic(surrogate, target, components=components)
    if 2.0 * len(task.problem.parameters) > BACKWARD * len(target):
        return automatic(surrogate, target, components=components, with_jacobian=True)
    return central(surrogate, target, FIRST_STEP * task.bounds.range, components=components, with_jacobian=True)


def step(task: Task, history: History, radius: Vector) -> tuple[Vector, History]:
    """The minimum of the corrected surrogate, no further than `radius` [U] from the best check."""
    anchor, model = history.nearest, corrected(task, history)
    target, components = model.select(task.target.values), task.observation.components
    scale = np.sqrt(len(target) / components)
    rho = np.sqrt(DAMPING) * np.linalg.norm(model.shown - target) / scale
    box = task.bounds.around(anchor.parameters, radius)
    records: list[Evaluation] = []

    def residual(parameters: Vector) -> Vector:
        began = time.perf_counter()
        (observation,) = model.observe([parameters])
        misfit = observation - target
        records.append(
            Evaluation(
                parameters=parameters.copy(),
                observation=observation,
                loss=float(misfit @ misfit) / scale**2,
                gradient=None,
                forward_s=time.perf_counter() - began,
                backward_s=0.0,
            )
        )
        return np.concatenate([misfit / scale, rho * (parameters - anchor.parameters) / radius])

    def slopes(parameters: Vector) -> NDArray[np.float64]:
        began = time.perf_counter()
        index = next(index for index, each in enumerate(records) if np.array_equal(each.parameters, parameters))
        found = jacobian(task, model, parameters, records[index].observation)
        gradient = 2.0 * (records[index].observation - target) @ found / scale**2
        seconds = time.perf_counter() - began
        records[index] = dataclasses.replace(records[index], gradient=gradient, backward_s=seconds)
        return np.concatenate([found / scale, rho * np.diag(1.0 / radius)])

    least_squares(
        residual,
        anchor.parameters,
        slopes,
        bounds=(box.lower, box.upper),
        x_scale=radius,
        method="dogbox",
        max_nfev=EVALUATIONS,
    )

    def damped(record: Evaluation) -> float:
        return float(record.loss + rho**2 * np.sum(((record.parameters - anchor.parameters) / radius) ** 2))

    return task.rounded(min(records, key=damped).parameters), history.proposed(records)


def jacobian(task: Task, model: Corrected, parameters: Vector, base: Values) -> NDArray[np.float64]:
    """d(observation)/d(parameters) of the corrected surrogate, shape [m, U], by whichever costs less.

    base: its observation at `parameters`.
    """
    if BACKWARD * len(base) < len(parameters):
        return by_ad(model, parameters)
    inwards = np.where(parameters > task.bounds.middle, -1.0, 1.0)
    return one_sided(model, parameters, base, inwards * STEP * task.bounds.range)
