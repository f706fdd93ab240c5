"""Minimising the misfit inside bounds: L-BFGS-B, Gauss-Newton, secants.

Every evaluation is kept. A method is a function of `evaluate`, the start and the bounds, and reads like its equation.
"""

from collections.abc import Callable, Sequence

import numpy as np
import scipy.optimize
from numpy.typing import NDArray
from tqdm import tqdm

from inverse.forward.interface import Evaluation
from inverse.jacobian import Evaluate
from inverse.parameters import Vector
from inverse.problem import Bounds
from inverse.secants import secants
from inverse.settings import Method, OptimiserSettings

ITERATIONS = 20
"""Evaluations of a search, at most, where the problem says nothing else."""
RESOLUTION = 5.0e-4
"""A step shorter than this fraction of every parameter's range ends the search."""
LONGEST_FIRST_STEP = 0.5
"""Of L-BFGS-B, as a fraction of the range: one gradient at the start says little of the rest of the range."""
STATIONARY = 0.25
"""Where the gradient at the start promises less than this part of the loss in the whole box, it shows no way down."""


class _Finished(Exception):
    """The search is over."""


class _Recorder:
    """Evaluates, keeps every evaluation and ends the search."""

    def __init__(self, evaluate: Evaluate, settings: OptimiserSettings, bounds: Bounds, progress: str) -> None:
        self.evaluate, self.settings, self.bounds = evaluate, settings, bounds
        self.records: list[Evaluation] = []
        self.most = settings.max_iterations or ITERATIONS
        self.bar = tqdm(total=self.most, desc=progress, unit="it", leave=False, disable=None)

    def __call__(self, parameters: Vector) -> Evaluation:
        near = RESOLUTION * self.bounds.range
        for record in self.records:
            if np.all(np.abs(record.parameters - parameters) <= 1e-12 * self.bounds.range):
                return record
            if np.all(np.abs(record.parameters - parameters) < near):
                raise _Finished
        if len(self.records) >= self.most:
            raise _Finished
        record = self.evaluate(parameters)
        self.records.append(record)
        self.bar.set_postfix_str(f"loss {record.loss:.2e} at {np.array2string(parameters, precision=2)}")
        self.bar.update()
        if record.loss < self.settings.stop_below or not np.isfinite(record.loss):
            raise _Finished
        return record


def minimise(
    evaluate: Evaluate,
    start: Vector,
    bounds: Bounds,
    settings: OptimiserSettings,
    progress: str = "inversion",
    sample: Sequence[Evaluation] = (),
) -> list[Evaluation]:
    """Every evaluation from `start` to the end, in order; the answer is that of least loss (`inverse.secants.lowest`).

    It ends below `stop_below`, after `max_iterations` evaluations, or when the method itself finds a minimum.
    sample: of the secants (`inverse.secants.sample`), which start at its best. Gauss-Newton requires evaluations with
    their Jacobian.
    """
    recorder = _Recorder(evaluate, settings, bounds, progress)
    start = bounds.clip(start)
    try:
        match settings.method:
            case Method.LBFGSB:
                _lbfgsb(recorder, start, bounds)
            case Method.GAUSS_NEWTON:
                _gauss_newton(recorder, start, bounds)
            case Method.SECANTS:
                secants(recorder, sample, bounds)
    except _Finished:
        pass
    finally:
        recorder.bar.close()
    return recorder.records


def _lbfgsb(evaluate: Evaluate, start: Vector, bounds: Bounds) -> None:
    """L-BFGS-B (Byrd, Lu, Nocedal & Zhu 1995) in variables scaled so that its first step is a sensible one.

    Its first model has curvature one: the first trial goes as far as the gradient is long. Loss and parameters
    are scaled so that this is 2 f / |f'|, which for a single number that can be fitted is the Gauss-Newton step.
    A start on a ridge or a plateau, such as sand at rest against a wall of which neither velocity is downhill, is left
    for the middle of the box.
    """
    first = evaluate(start)
    promised = np.maximum(first.slope * (start - bounds.lower), first.slope * (start - bounds.upper)).sum()
    if promised < STATIONARY * first.loss:
        start = bounds.middle
        first = evaluate(start)
    # Steepest descent in fractions of the range, so that parameters of different units count alike.
    slope = first.slope * bounds.range
    steepness = float(np.linalg.norm(slope))
    if steepness == 0.0:
        return
    length = min(2.0 * first.loss / steepness, LONGEST_FIRST_STEP)
    unit, scale = bounds.range * length, steepness * length

    def scaled(x: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        record = evaluate(bounds.clip(start + x * unit))
        return record.loss / scale, record.slope * unit / scale

    scipy.optimize.minimize(
        scaled,
        np.zeros_like(start),
        jac=True,
        method="L-BFGS-B",
        bounds=list(zip((bounds.lower - start) / unit, (bounds.upper - start) / unit, strict=True)),
        options={"ftol": 1e-12, "gtol": 1e-6},
    )


def _gauss_newton(evaluate: Evaluate, start: Vector, bounds: Bounds) -> None:
    """Least squares by the Jacobian: SciPy's trust region reflective method (Branch, Coleman & Li 1999)."""

    def part(name: str) -> Callable[[Vector], NDArray[np.float64]]:
        return lambda parameters: np.asarray(getattr(evaluate(bounds.clip(parameters)), name))

    scipy.optimize.least_squares(
        part("residual"),
        start,
        part("jacobian"),
        bounds=(bounds.lower, bounds.upper),
        x_scale=bounds.range,
        method="trf",
    )
