"""The reverse of a material element's stress step, for tests: a block of lanes per number, as in the solver."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from mpm import runtime
from mpm.adjoint.pullback import Pullback
from mpm.adjoint.stress import plastic_return_reverse
from mpm.arrays.batch import aligned
from mpm.arrays.features import Features
from mpm.physics.stress import midpoint_increment, plastic_return, trial_stress

Array = NDArray[Any]

STRENGTHS = 6
"""As `mpm.physics.mohr_coulomb.return_principal` takes them; the last two are 0 where friction has no growth."""
CONSTANTS = STRENGTHS + 2
"""Then lambda, mu."""


def trial_after(stress: Any, a: Any, lame: Any, shear: Any, dimension: int) -> Any:
    """The trial stress after the increment `a`, traced."""
    return trial_stress(stress, midpoint_increment(a, dimension), lame, shear, dimension)


@cache
def kernels(features: Features) -> tuple[Callable[..., None], Callable[..., None]]:
    """Forwards (inputs, returned stress) and backwards (inputs, bar of that stress, bars of the inputs).

    Inputs: stress, increment A row by row, CONSTANTS; a block of lanes each.
    """
    real = ti.f32 if features.precision == "f32" else ti.f64
    blocks = ti.types.ndarray(dtype=ti.types.vector(features.lanes, real), ndim=1)
    stresses, gradients, dimension = features.stresses, features.dimension**2, features.dimension
    count = STRENGTHS if features.inertial else 4

    @ti.kernel
    def forwards(x: blocks, y: blocks):
        for e in range(y.shape[0] // stresses):
            at = e * (stresses + gradients + CONSTANTS)
            increment = midpoint_increment([x[at + stresses + k] for k in ti.static(range(gradients))], dimension)
            p = [x[at + stresses + gradients + k] for k in ti.static(range(CONSTANTS))]
            old = [x[at + k] for k in ti.static(range(stresses))]
            trial = trial_stress(old, increment, p[6], p[7], dimension)
            new = plastic_return(trial, [p[k] for k in ti.static(range(count))], p[6], p[7], features)
            for k in ti.static(range(stresses)):
                y[e * stresses + k] = new[k]

    @ti.kernel
    def backwards(x: blocks, y: blocks, result: blocks):
        for e in range(y.shape[0] // stresses):
            at = e * (stresses + gradients + CONSTANTS)
            old = [x[at + k] for k in ti.static(range(stresses))]
            a = [x[at + stresses + k] for k in ti.static(range(gradients))]
            p = [x[at + stresses + gradients + k] for k in ti.static(range(CONSTANTS))]
            elastic = ti.static([Pullback(trial_after, (old, a, p[6], p[7]), (dimension,))])[0]
            bar = [y[e * stresses + k] for k in ti.static(range(stresses))]
            strengths = [p[k] for k in ti.static(range(count))]
            trial_bar, strengths_bar, moduli_bar = plastic_return_reverse(
                bar, elastic.values, strengths, p[6], p[7], bar[0], bar[0], features
            )
            found = ti.static(elastic(trial_bar))
            for k in ti.static(range(stresses)):
                result[at + k] = found[0][k]
            for k in ti.static(range(gradients)):
                result[at + stresses + k] = found[1][k]
            at = at + stresses + gradients
            for k in ti.static(range(count)):
                result[at + k] = strengths_bar[k]
            for k in ti.static(range(2)):
                result[at + STRENGTHS + k] = moduli_bar[k] + found[2 + k]

    return forwards, backwards


def call(function: Callable[..., None], features: Features, inputs: Array, *others: Array, rows: int) -> Array:
    """`function` of E elements, given as columns of `inputs` and `others`; the last argument is `rows` by E."""
    lanes, count = features.lanes, inputs.shape[1]
    blocks = -(-count // lanes)
    real: np.dtype[Any] = np.dtype(np.float64 if features.precision == "f64" else np.float32)
    source = np.minimum(np.arange(blocks * lanes), count - 1)

    def packed(columns: Array) -> Array:
        memory = aligned((blocks, len(columns), lanes), real)
        memory[:] = np.moveaxis(columns[:, source].reshape(len(columns), blocks, lanes), 0, 1)
        return memory.reshape(-1, lanes)

    result = aligned((blocks * rows, lanes), real)
    function(*(packed(each) for each in (inputs, *others)), result)
    return np.moveaxis(result.reshape(blocks, rows, lanes), 1, 0).reshape(rows, -1)[:, :count].astype(np.float64)


def stepped(features: Features, inputs: Array) -> Array:
    """Returned stresses of E elements, shape [4 or 6, E]."""
    runtime.start(features.precision, enough=1)
    return call(kernels(features)[0], features, inputs, rows=features.stresses)


def reversed_step(features: Features, inputs: Array, bar: Array) -> Array:
    """Bars of `inputs` from those of the returned stresses, the shape of `inputs`."""
    runtime.start(features.precision, enough=1)
    return call(kernels(features)[1], features, inputs, bar, rows=len(inputs))
