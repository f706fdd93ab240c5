"""One inversion by one forward: minimise, then say what it came to."""

import time

import numpy as np

from inverse.gradient import Evaluate
from inverse.optimise import Bounds, best, minimise
from inverse.problem import Problem
from inverse.result import Result, Round, Verdict
from inverse.target import Target


def invert(problem: Problem, target: Target, evaluate: Evaluate) -> Result:
    """Minimise what `evaluate` says from the problem's start; the verdict is left to the MPM.

    The prediction of a forward that is the MPM itself counts as the surrogate's here: nobody has checked it.
    """
    began = time.perf_counter()
    lower, upper = np.array(problem.bounds).T
    start = np.array([unknown.initial for unknown in problem.unknowns])
    records = minimise(evaluate, start, Bounds(lower=lower, upper=upper), problem.optimiser)
    found = best(records)
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
        total_seconds=time.perf_counter() - began,
    )
