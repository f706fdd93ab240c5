"""Reverse mode of a traced function: each operation against its derivative by hand."""

from typing import Any

import numpy as np
import pytest
import taichi as ti

from mpm import runtime
from mpm.adjoint.pullback import Pullback
from mpm.arrays.access import clamp
from mpm.arrays.batch import aligned

pytestmark = pytest.mark.double

LANES = 8
BLOCKS = ti.types.ndarray(dtype=ti.types.vector(LANES, ti.f64), ndim=1)


@ti.func
def inner(values: ti.template(), scale):
    """Called by the traced function: a list of two, a loop that writes what it has read, a constant."""
    total = 0.0 * values[0]
    for k in ti.static(range(2)):
        total = total + scale * values[k] * values[k]
    return total


@ti.func
def outer(values: ti.template(), scale, power: ti.template()):
    """All operations: + - * / from both sides, powers, roots, a choice, a result that is used twice."""
    a, b = values
    length = ti.sqrt(inner(values, scale))
    return [2.0 - a / b + 3.0 / length, clamp(a - b, -1.0, 1.0) * length, b**power - (length + 1.0)]


def test_every_operation_by_hand() -> None:
    runtime.start("f64", enough=1)

    @ti.kernel
    def run(x: BLOCKS, y: BLOCKS):
        for _ in range(1):
            step = ti.static([Pullback(outer, ([x[0], x[1]],), (2.0, 3))])[0]
            for k in ti.static(range(3)):
                y[k] = step.values[k]
            values_bar = ti.static(step([x[2], x[3], x[4]]))
            y[3] = values_bar[0][0]
            y[4] = values_bar[0][1]

    random = np.random.default_rng(0)
    x, y = (aligned((5, LANES), np.dtype(np.float64)) for _ in range(2))
    x[:] = random.uniform(0.5, 2.5, (5, LANES))
    run(x, y)

    def by_numpy(a: Any, b: Any) -> Any:
        length = np.sqrt(2.0 * a * a + 2.0 * b * b)
        return np.array([2.0 - a / b + 3.0 / length, np.clip(a - b, -1.0, 1.0) * length, b**3 - (length + 1.0)])

    a, b, bars = x[0], x[1], x[2:]
    np.testing.assert_allclose(y[:3], by_numpy(a, b), rtol=1e-14)
    h = 1e-30
    for row, moved in ((3, (a + 1j * h, b + 0j)), (4, (a + 0j, b + 1j * h))):
        # The derivative by a complex step; NumPy clips complex numbers by their real part alone.
        inside = np.abs(a - b) < 1.0
        slope = by_numpy(*moved).imag / h
        slope[1] = np.where(
            inside, slope[1], (np.clip(a - b, -1, 1) * np.sqrt(2.0 * moved[0] ** 2 + 2.0 * moved[1] ** 2)).imag / h
        )
        np.testing.assert_allclose(y[row], (slope * bars).sum(axis=0), rtol=1e-12)
