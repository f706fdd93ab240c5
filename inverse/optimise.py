"""Minimising the loss inside bounds: the paper's gradient descent and Adam, L-BFGS-B, Gauss-Newton.

Every evaluation is kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.optimize
import torch
from numpy.typing import NDArray
from tqdm import tqdm

from inverse.forward.interface import Evaluation
from inverse.gradient import Evaluate
from inverse.parameters.parameters import Vector
from inverse.problem import Method, OptimiserSettings

RESOLUTION = 5.0e-4
"""A step shorter than this fraction of every unknown's range is not worth a simulation."""
LONGEST_FIRST_STEP = 0.5
"""Of L-BFGS-B, as a fraction of the range: one gradient at the start says little of what lies far off."""
DESCENT_RATE = 500.0
"""Learning rate of gradient descent where none is given: the paper's [deg^2/m^2]."""
ADAM_SHARE = 0.02
"""Learning rate of Adam where none is given, as a fraction of an unknown's range."""


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """The box in which the unknowns lie."""

    lower: Vector
    upper: Vector

    @property
    def range(self) -> Vector:
        """Width of the box, shape [U]."""
        return self.upper - self.lower

    @property
    def middle(self) -> Vector:
        """Centre of the box, shape [U]."""
        return 0.5 * (self.lower + self.upper)

    def clip(self, unknowns: Vector) -> Vector:
        """The nearest point of the box."""
        return np.clip(unknowns, self.lower, self.upper)

    def around(self, centre: Vector, reach: Vector) -> "Bounds":
        """The part of the box within `reach` of `centre`."""
        return Bounds(lower=np.maximum(self.lower, centre - reach), upper=np.minimum(self.upper, centre + reach))


class _Enough(Exception):
    """The search is over."""


class _Recorder:
    """Evaluates, keeps every evaluation and says when it is enough."""

    def __init__(self, evaluate: Evaluate, settings: OptimiserSettings, bounds: Bounds, progress: str) -> None:
        self.evaluate, self.settings, self.bounds = evaluate, settings, bounds
        self.records: list[Evaluation] = []
        self.bar = tqdm(total=settings.max_iterations, desc=progress, unit="it", leave=False, disable=None)

    def __call__(self, unknowns: Vector) -> Evaluation:
        # Adam runs its course: it turns where it overshoots, and its steps grow short there.
        near = (0.0 if self.settings.method is Method.ADAM else RESOLUTION) * self.bounds.range
        for record in self.records:
            if np.all(np.abs(record.unknowns - unknowns) <= 1e-12 * self.bounds.range):
                return record
            if np.all(np.abs(record.unknowns - unknowns) < near):
                raise _Enough
        if len(self.records) >= self.settings.max_iterations:
            raise _Enough
        record = self.evaluate(unknowns)
        self.records.append(record)
        self.bar.set_postfix_str(f"loss {record.loss:.2e} at {np.array2string(unknowns, precision=2)}")
        self.bar.update()
        if record.loss < self.settings.stop_below or not np.isfinite(record.loss):
            raise _Enough
        return record


def minimise(
    evaluate: Evaluate,
    start: Vector,
    bounds: Bounds,
    settings: OptimiserSettings,
    progress: str = "inversion",
    rates: Sequence[float | None] | None = None,
) -> list[Evaluation]:
    """Every evaluation from `start` to the end, in order; the answer is the one of least loss (`best`).

    It ends below `stop_below`, after `max_iterations` evaluations, or when the method itself finds a minimum.
    rates: learning rate of each unknown that has its own. Gauss-Newton wants evaluations with their Jacobian.
    """
    recorder = _Recorder(evaluate, settings, bounds, progress)
    try:
        match settings.method:
            case Method.GRADIENT_DESCENT:
                _gradient_descent(recorder, bounds.clip(start), bounds, _rates(settings, bounds, rates))
            case Method.ADAM:
                _adam(recorder, bounds.clip(start), bounds, _rates(settings, bounds, rates))
            case Method.LBFGSB:
                _lbfgsb(recorder, bounds.clip(start), bounds)
            case Method.GAUSS_NEWTON:
                _gauss_newton(recorder, bounds.clip(start), bounds)
    except _Enough:
        pass
    finally:
        recorder.bar.close()
    return recorder.records


def best(records: list[Evaluation]) -> Evaluation:
    """The evaluation of least loss."""
    return min(records, key=lambda record: record.loss if np.isfinite(record.loss) else np.inf)


def _rates(settings: OptimiserSettings, bounds: Bounds, own: Sequence[float | None] | None) -> Vector:
    """Learning rate of each unknown, shape [U]."""
    if settings.learning_rate is not None:
        shared = np.full_like(bounds.range, settings.learning_rate)
    elif settings.method is Method.ADAM:
        shared = ADAM_SHARE * bounds.range
    else:
        shared = np.full_like(bounds.range, DESCENT_RATE)
    return np.array([rate or other for rate, other in zip(own or [None] * len(shared), shared, strict=True)])


def _gradient_descent(recorder: _Recorder, start: Vector, bounds: Bounds, rates: Vector) -> None:
    """u <- u - rate * d(loss)/du, projected onto the bounds (the paper, section "Inverse problem")."""
    before, unknowns = None, start
    while before is None or np.any(unknowns != before):
        before, unknowns = unknowns, bounds.clip(unknowns - rates * recorder(unknowns).slope)


def _adam(recorder: _Recorder, start: Vector, bounds: Bounds, rates: Vector) -> None:
    """Adam (Kingma & Ba 2015) as torch has it, projected onto the bounds after each step; a step per evaluation."""
    values = [torch.tensor(value, dtype=torch.float64) for value in start]
    groups = [{"params": [value], "lr": float(rate)} for value, rate in zip(values, rates, strict=True)]
    adam = torch.optim.Adam(groups)
    for _ in range(recorder.settings.max_iterations):
        record = recorder(np.array([value.item() for value in values]))
        for value, slope in zip(values, record.slope, strict=True):
            value.grad = torch.tensor(slope, dtype=torch.float64)
        adam.step()
        for value, lower, upper in zip(values, bounds.lower, bounds.upper, strict=True):
            value.clamp_(float(lower), float(upper))


def _lbfgsb(recorder: _Recorder, start: Vector, bounds: Bounds) -> None:
    """L-BFGS-B (Byrd, Lu, Nocedal & Zhu 1995) in variables scaled so that its first step is a sensible one.

    Its first model has curvature one: the first trial goes as far as the gradient is long. Loss and unknowns are
    scaled so that this is 2 f / |f'|, which for a single observation that can be met is the Gauss-Newton step.
    """
    first = recorder(start)
    # Steepest descent in fractions of the range, so that unknowns of different units count alike.
    slope = first.slope * bounds.range
    steepness = float(np.linalg.norm(slope))
    if steepness == 0.0:
        return
    length = min(2.0 * first.loss / steepness, LONGEST_FIRST_STEP)
    unit, scale = bounds.range * length, steepness * length

    def scaled(x: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        record = recorder(bounds.clip(start + x * unit))
        return record.loss / scale, record.slope * unit / scale

    scipy.optimize.minimize(
        scaled,
        np.zeros_like(start),
        jac=True,
        method="L-BFGS-B",
        bounds=list(zip((bounds.lower - start) / unit, (bounds.upper - start) / unit, strict=True)),
        options={"ftol": 1e-12, "gtol": 1e-6},
    )


def _gauss_newton(recorder: _Recorder, start: Vector, bounds: Bounds) -> None:
    """Least squares by the Jacobian: SciPy's trust region reflective method (Branch, Coleman & Li 1999)."""

    def residual(unknowns: Vector) -> Vector:
        found = recorder(bounds.clip(unknowns)).residual
        assert found is not None
        return found

    def slopes(unknowns: Vector) -> NDArray[np.float64]:
        found = recorder(bounds.clip(unknowns)).jacobian
        assert found is not None
        return found

    scipy.optimize.least_squares(
        residual, start, slopes, bounds=(bounds.lower, bounds.upper), x_scale=bounds.range, method="trf"
    )
