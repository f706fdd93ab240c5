"""Least squares without derivatives: a Jacobian from predictions spread over the box, corrected by every prediction.

| symbol | variable | meaning |
|---|---|---|
| s | `step` | step of the parameters, in ranges of the box, shape [U] |
| r | `residual` | observation less target, shape [M] |
| B | `jacobian` | what stands for dr/ds, shape [M, U] |

Each step minimises |r + B s|^2 within the box and a trust region. The first B is the linear function of least squares
through the sample, of all such the shortest one; each prediction then corrects B along its step by the least change
that makes it exact there (Broyden, Mathematics of Computation 19, 1965):

    B <- B + (r(u + s) - r(u) - B s) s^T / s^T s

A prediction of many numbers says much of B: where the observation is every particle of a deposit, some 25 runs find
ten parameters. Beyond the number of runs of the sample B knows some directions alone; a gradient knows all.
"""

from collections.abc import Sequence

import numpy as np
import scipy.optimize
from numpy.typing import NDArray
from scipy.stats import qmc

from inverse.forward.interface import Evaluation, Forward
from inverse.jacobian import Evaluate, observed
from inverse.observations import Values
from inverse.parameters import Vector
from inverse.problem import Bounds

MORE, MOST = 6, 32
"""Predictions of a sample beyond the number of parameters, and at most."""
RIDGE = 1.0e-2
"""Variance of the noise of a sample over that of what a range of the box changes: the fit of B is damped by it."""
DAMPING = 1.0e-3
"""Of a step, over the largest singular value of B: directions that B does not know are left alone."""
RADIUS = 0.25
"""First radius of the trust region, in ranges of the box."""


def sample(forward: Forward, target: Values, start: Vector, bounds: Bounds, *, components: int = 1) -> list[Evaluation]:
    """Predictions at `start` and at points of a Sobol sequence in the box, together; then at their fit's minimum."""
    # Its points are balanced in powers of two alone; here they only have to lie apart.
    spread = qmc.Sobol(len(start), seed=0).random_base2(int(np.ceil(np.log2(MOST))))
    points = [bounds.clip(start), *(bounds.lower + bounds.range * spread)][: min(len(start) + MORE, MOST)]
    found = observed(forward, target, points, components=components)
    base = lowest(found)
    step = least_squares_step(base.residual, fitted(found, base, bounds), base.parameters, bounds, 1.0)
    return found + observed(
        forward, target, [bounds.clip(base.parameters + step * bounds.range)], components=components
    )


def secants(evaluate: Evaluate, found: Sequence[Evaluation], bounds: Bounds) -> None:
    """Minimise from the best of a sample; `evaluate` ends it. Evaluations need no gradient.

    The trust region is halved where a step brings less than a quarter of what B promised, and doubled where it ends
    such a step early.
    """
    base = lowest(found)
    jacobian, radius = fitted(found, base, bounds), RADIUS
    while True:
        step = least_squares_step(base.residual, jacobian, base.parameters, bounds, radius)
        promised = float(np.sum(base.residual**2) - np.sum((base.residual + jacobian @ step) ** 2))
        if promised <= 0.0:
            return
        record = evaluate(bounds.clip(base.parameters + step * bounds.range))
        change = record.residual - base.residual
        gain = float(np.sum(base.residual**2) - np.sum(record.residual**2)) / promised
        length = float(np.abs(step).max())
        jacobian = jacobian + np.outer(change - jacobian @ step, step) / (step @ step)
        if gain < 0.25:
            radius = 0.5 * length
        elif gain > 0.75 and length > 0.9 * radius:
            radius = 2.0 * radius
        if record.loss < base.loss:
            base = record


def fitted(found: Sequence[Evaluation], base: Evaluation, bounds: Bounds) -> NDArray[np.float64]:
    """dr/ds of the linear function through `base` and, by least squares, the others; shape [M, U]."""
    found = [each for each in found if np.isfinite(each.loss)]
    steps = np.array([(each.parameters - base.parameters) / bounds.range for each in found])
    changes = np.array([each.residual - base.residual for each in found])
    weights = np.linalg.solve(steps @ steps.T + RIDGE * np.eye(len(steps)), changes)
    return np.asarray((steps.T @ weights).T)


def least_squares_step(
    residual: Values, jacobian: NDArray[np.float64], at: Vector, bounds: Bounds, radius: float
) -> Vector:
    """The s [U] that minimises |r + B s|^2, damped, in the box and where no |s_i| exceeds `radius`."""
    q, small = np.linalg.qr(jacobian)
    damping = DAMPING * float(np.linalg.norm(small, 2)) * np.eye(len(at))
    # A point on the bound lies inside by a little, as the solver requires.
    slack = 1.0e-12
    lower = np.maximum((bounds.lower - at) / bounds.range, -radius) - slack
    upper = np.minimum((bounds.upper - at) / bounds.range, radius) + slack
    matrix, right = np.vstack([small, damping]), np.concatenate([-q.T @ residual, np.zeros(len(at))])
    return np.asarray(scipy.optimize.lsq_linear(matrix, right, bounds=(lower, upper)).x)


def lowest(found: Sequence[Evaluation]) -> Evaluation:
    """The evaluation of minimum loss."""
    return min(found, key=lambda each: each.loss if np.isfinite(each.loss) else np.inf)
