"""The loop's search for several unknowns: least squares on the corrected surrogate, a step per MPM run.

A step minimises, inside a box of `reach` around the best MPM run u_k and inside the bounds,

    |y(u) - y*|^2 / n + rho^2 |(u - u_k) / reach|^2,    rho^2 = damping * |y(u_k) - y*|^2 / n

with y the corrected surrogate (`validation.loop.correction`) and n the number of things compared. The second term
(Levenberg, A method for the solution of certain non-linear problems in least squares, Quart. Appl. Math. 2 (1944)
164-168) keeps what the observation hardly tells from running off while the misfit is still large, and goes with it.
"""

import time

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from inverse.finite_difference import one_sided
from inverse.forward.interface import Evaluation
from inverse.gradient import jacobian as by_backward_passes
from inverse.observations.deposit import Values, loss
from inverse.parameters.parameters import Vector
from inverse.result import Round
from validation.loop.correction import Corrected
from validation.loop.search import STUCK, Checked, Search, reserved
from validation.loop.starts import BACKWARD

DAMPING = 0.02
"""Of a step; see above."""
EVALUATIONS = 4
"""Predictions of a round besides those of its Jacobians: it starts where the MPM has just been."""
STEP = 0.02
"""Of a difference of the corrected surrogate, as a fraction of an unknown's range."""
SETTLED = 0.005
"""A proposal this close to the best MPM run, as a fraction of the range, is left to the ensemble."""
PATIENCE = 2
"""Proposals in a row that improve a design by no more than the scatter, after which it is done."""


def search(state: Search, proposal: Vector) -> None:
    """Let the MPM correct the surrogate, whose answer was `proposal`, until it meets the target or knows no way on."""
    reach = state.problem.loop.trust * state.bounds.range
    while True:
        before = state.nearest if state.checked else None
        state.check(proposal)
        anchor = state.nearest
        if state.fits(anchor) or state.budget <= reserved(state.problem):
            return
        if anchor is before:
            reach = reach / 2.0  # The step made it worse: believe the corrected surrogate less far.
        proposal = propose(state, reach)
        if moved(state, proposal, anchor) <= SETTLED:
            return


def improve(state: Search, proposal: Vector) -> None:
    """The search of a design: as little as possible, from `proposal` and the problem's own start, whichever is less."""
    state.check(proposal)
    state.check(state.problem.initial)
    reach, idle = state.problem.loop.trust * state.bounds.range, 0
    while state.budget > 0 and idle < PATIENCE:
        before = state.nearest
        proposal = propose(state, reach)
        if moved(state, proposal, before) <= STUCK:
            return
        gain = before.observation[0] - state.check(proposal).observation[0]
        if gain <= state.scatter:
            idle += 1
            reach = reach / 2.0
        else:
            idle = 0


def moved(state: Search, unknowns: Vector, run: Checked) -> float:
    """The longest way from `run` to `unknowns`, as a fraction of an unknown's range."""
    return float(np.max(np.abs(unknowns - run.unknowns) / state.bounds.range))


def propose(state: Search, reach: Vector) -> Vector:
    """Where the corrected surrogate is nearest to the target, no further than `reach` [U] from the best MPM run."""
    anchor, model = state.nearest, state.corrected()
    wanted = model.surrogate.wanted(state.target.values)
    components = state.observation.components
    scale = np.sqrt(len(wanted) / components)
    rho = np.sqrt(DAMPING * loss(model.shown, wanted, components))
    box = state.bounds.around(anchor.unknowns, reach)
    records: list[Evaluation] = []

    def residual(unknowns: Vector) -> Vector:
        began = time.perf_counter()
        (seen,) = model.observe([unknowns])
        records.append(
            Evaluation(
                unknowns=unknowns.copy(),
                observation=seen,
                loss=loss(seen, wanted, components),
                gradient=None,
                forward_s=time.perf_counter() - began,
                backward_s=0.0,
            )
        )
        return np.concatenate([(seen - wanted) / scale, rho * (unknowns - anchor.unknowns) / reach])

    def slopes(unknowns: Vector) -> NDArray[np.float64]:
        began = time.perf_counter()
        place = next(number for number, each in enumerate(records) if np.array_equal(each.unknowns, unknowns))
        record = records[place]
        found = jacobian(state, model, unknowns, record.observation)
        gradient = 2.0 * (record.observation - wanted) @ found / scale**2
        spent = time.perf_counter() - began
        records[place] = Evaluation(
            unknowns=record.unknowns,
            observation=record.observation,
            loss=record.loss,
            gradient=gradient,
            forward_s=record.forward_s,
            backward_s=spent,
        )
        return np.concatenate([found / scale, rho * np.diag(1.0 / reach)])

    least_squares(
        residual,
        anchor.unknowns,
        slopes,
        bounds=(box.lower, box.upper),
        x_scale=reach,
        method="dogbox",
        max_nfev=EVALUATIONS,
    )
    state.rounds.append(Round(number=len(state.rounds), evaluations=records))

    def damped(record: Evaluation) -> float:
        return float(record.loss + rho**2 * np.sum(((record.unknowns - anchor.unknowns) / reach) ** 2))

    return state.rounded(min(records, key=damped).unknowns)


def jacobian(state: Search, model: Corrected, unknowns: Vector, base: Values) -> NDArray[np.float64]:
    """d(observation)/d(unknowns) of the corrected surrogate, shape [m, U], by whichever costs less.

    base: its observation at `unknowns`.
    """
    if BACKWARD * len(base) < len(unknowns):
        return by_backward_passes(model, unknowns)
    inwards = np.where(unknowns > state.bounds.middle, -1.0, 1.0)
    return one_sided(model, unknowns, base, inwards * STEP * state.bounds.range)
