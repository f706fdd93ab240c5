"""LLVM's functions in kernels (`mpm.arrays.bitcode`) beside NumPy's."""

import numpy as np
import pytest
import taichi as ti

from mpm import runtime
from mpm.arrays.bitcode import FILE, FUNCTIONS, MOVES, ROW, SIZES, call, version
from mpm.arrays.features import NODE, REGISTER
from mpm.arrays.kernel_arguments import aligned
from mpm.arrays.layout import Precision
from mpm.arrays.nodes import zero_pair

BOTH = pytest.mark.parametrize("precision", ["f32", pytest.param("f64", marks=pytest.mark.double)])


def test_file_holds_what_stands_in_the_module() -> None:
    names = {f"{make.__name__}_{precision}_{version()}" for make in (*FUNCTIONS, *MOVES) for precision in SIZES}
    content = FILE.read_bytes()
    assert not {name for name in names if name.encode() not in content}


@BOTH
def test_blocks_turn_into_rows_and_back(precision: Precision) -> None:
    runtime.start(precision, 1)
    lanes = REGISTER // SIZES[precision][1]
    real = np.dtype(precision.replace("f", "float"))
    vectors, rows, back = aligned((ROW, lanes), real), aligned((lanes, ROW), real), aligned((ROW, lanes), real)
    vectors[:] = np.arange(vectors.size).reshape(vectors.shape)
    to_rows, to_lanes = call("to_rows", precision), call("to_lanes", precision)

    @ti.kernel
    def run(first: ti.i64, second: ti.i64, third: ti.i64):  # type: ignore[no-untyped-def]
        ti.loop_config(serialize=True)
        for _ in range(1):
            a, b, c = first, second, third
            to_rows(a, b)
            to_lanes(b, c)

    run(vectors.ctypes.data, rows.ctypes.data, back.ctypes.data)
    np.testing.assert_array_equal(rows, vectors.T)
    np.testing.assert_array_equal(back, vectors)


@BOTH
def test_sums_over_a_column_of_nodes(precision: Precision) -> None:
    runtime.start(precision, 1)
    real = np.dtype(precision.replace("f", "float"))
    number, node = (
        (ti.f32, ti.types.vector(NODE, ti.f32)) if precision == "f32" else (ti.f64, ti.types.vector(NODE, ti.f64))
    )
    rng = np.random.default_rng(1)
    grid, given, taken = aligned((4, NODE), real), aligned((2, NODE), real), aligned((3, NODE), real)
    grid[:], given[:] = rng.normal(size=grid.shape), rng.normal(size=given.shape)
    weights, before = rng.normal(size=(2, 3)).astype(real), grid.copy()
    add_to_column, column_sums = call("add_to_column", precision), call("column_sums", precision)
    pair_of, split, add_scaled = call("pair_of", precision), call("split", precision), call("add_scaled", precision)
    add_scaled_pair, add_first_scaled = call("add_scaled_pair", precision), call("add_first_scaled", precision)

    @ti.kernel
    def run(  # type: ignore[no-untyped-def]
        place: ti.i64,
        given: ti.types.ndarray(node, 1),
        weights: ti.types.ndarray(number, 2),
        taken: ti.types.ndarray(node, 1),
    ):
        ti.loop_config(serialize=True)
        for _ in range(1):
            address, value, step = place, given[0], given[1]
            w0, w1, w2 = weights[0, 0], weights[0, 1], weights[0, 2]
            l0, l1, l2 = weights[1, 0], weights[1, 1], weights[1, 2]
            total, s0, s1, s2 = zero_pair(), zero_pair(), zero_pair(), zero_pair()
            pair_of(s0, w0, l0)
            pair_of(s1, w1, l1)
            pair_of(s2, w2, l2)
            column_sums(total, address, s0, s1, s2)
            add_scaled_pair(total, w0, total)
            first, second = taken[0], taken[1]
            split(first, second, total)
            third = taken[2]
            add_first_scaled(third, w1, total)
            add_scaled(third, w2, value)
            taken[0], taken[1], taken[2] = first, second, third
            add_to_column(address, value, step, w0, w1, w2)

    run(grid[1:].ctypes.data, given, weights, taken)
    sums = weights @ before[1:] * (1.0 + weights[0, 0])
    tolerance = 1e-5 if precision == "f32" else 1e-13
    np.testing.assert_allclose(taken[:2], sums, rtol=tolerance, atol=tolerance)
    third = weights[0, 1] * sums[0] + weights[0, 2] * given[0]
    np.testing.assert_allclose(taken[2], third, rtol=tolerance, atol=tolerance)
    added = weights[0][:, None] * (given[0] + np.arange(3)[:, None] * given[1])
    np.testing.assert_allclose(grid[1:], before[1:] + added, rtol=tolerance, atol=tolerance)
    np.testing.assert_array_equal(grid[0], before[0])
