"""One inversion by one forward: minimise, then say what it came to."""

import time
from collections.abc import Sequence

import numpy as np

from inverse.forward.interface import Evaluation
from inverse.gradient import Evaluate
from inverse.observations.target import Target
from inverse.optimise import Bounds, best, minimise
from inverse.problem import Problem
from inverse.result import Result, Round, Verdict


def invert(problem: Problem, target: Target, evaluate: Evaluate) -> Result:
    """Minimise what `evaluate` says from the problem's start; the verdict is left to the MPM."""
    began = time.perf_counter()
    lower, upper = np.array(problem.bounds).T
    rates = [unknown.learning_rate for unknown in problem.unknowns]
    bounds = Bounds(lower=lower, upper=upper)
    records = minimise(evaluate, problem.initial, bounds, problem.optimiser, rates=rates)
    return unconfirmed(problem, target, records, time.perf_counter() - began)


def unconfirmed(problem: Problem, target: Target, records: Sequence[Evaluation], seconds: float) -> Result:
    """What `records` of one forward came to in `seconds` [s].

    The prediction of a forward that is the MPM itself counts as the surrogate's here: nobody has checked it.
    """
    found = best(list(records))
    return Result(
        problem=problem,
        target=target,
        verdict=Verdict.UNCONFIRMED,
        answer=found.unknowns,
        certainty=None,
        surrogate=found.observation,
        mpm=None,
        front_error_pct=None,
        loss_surrogate=found.loss,
        loss_mpm=None,
        rounds=[Round(number=0, evaluations=records)],
        total_seconds=seconds,
    )
