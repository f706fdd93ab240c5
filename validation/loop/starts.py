"""The first inversion: of the surrogate as it is, from one starting point or from several."""

import numpy as np
from scipy.stats import qmc

from inverse.finite_difference import central
from inverse.forward.interface import Surrogate
from inverse.gradient import Evaluate, automatic
from inverse.optimise import best, minimise
from inverse.parameters.parameters import Vector
from inverse.problem import Method, Problem
from inverse.result import Minimum, Round
from validation.loop.search import Search

STEP = 0.01
"""Of a finite difference of the surrogate, as a fraction of an unknown's range: well above its rounding."""
BACKWARD = 4.0
"""What a backward pass costs, in predictions."""
SAME = 0.02
"""Two answers closer than this in every unknown, as a fraction of its range, are one."""


def invert(state: Search, first: Surrogate) -> Vector:
    """Invert `first` by the problem's optimiser; its lowest answer. What else it found stays in `state`."""
    problem = state.problem
    evaluate = cheapest(state, first)
    rates = [unknown.learning_rate for unknown in problem.unknowns]
    stages = []
    for number, start in enumerate(starting_points(problem, state)):
        title = "surrogate" if problem.optimiser.starts == 1 else f"surrogate, start {number}"
        records = minimise(evaluate, start, state.bounds, problem.optimiser, title, rates)
        stages.append(Round(number=0, evaluations=records, start=number))
    stages.sort(key=lambda stage: best(list(stage.evaluations)).loss)
    state.rounds.append(stages[0])
    state.other_starts += sorted(stages[1:], key=lambda stage: stage.start)
    found = [best(list(stage.evaluations)) for stage in stages]
    kept = found[:1]
    for other in found[1:]:
        apart = [np.max(np.abs(other.unknowns - each.unknowns) / state.bounds.range) for each in kept]
        if min(apart) > SAME:
            kept.append(other)
            state.other_minima.append(Minimum(unknowns=other.unknowns, loss=other.loss))
    return state.rounded(found[0].unknowns)


def starting_points(problem: Problem, state: Search) -> list[Vector]:
    """The problem's own start, and others that fill the bounds evenly (Sobol's sequence, scrambled)."""
    settings = problem.optimiser
    sobol = qmc.Sobol(len(problem.unknowns), seed=np.random.default_rng(settings.seed))
    count = settings.starts - 1
    # A power of two at a time is what the sequence is balanced for.
    points = sobol.random_base2(max(0, (count - 1).bit_length()))[:count] if count else []
    return [problem.initial, *(state.bounds.lower + point * state.bounds.range for point in points)]


def cheapest(state: Search, forward: Surrogate) -> Evaluate:
    """Loss and gradient of `forward`: one backward pass; for a Jacobian, differences where they cost less."""
    problem, components = state.problem, state.observation.components
    wanted = forward.wanted(state.target.values)
    if problem.optimiser.method is not Method.GAUSS_NEWTON:
        return automatic(forward, wanted, components=components)
    if 2.0 * len(problem.unknowns) > BACKWARD * len(wanted):
        return automatic(forward, wanted, components=components, with_jacobian=True)
    steps = STEP * state.bounds.range
    return central(forward, wanted, problem, components=components, with_jacobian=True, steps=steps)
