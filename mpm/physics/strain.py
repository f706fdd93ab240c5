"""The increment of a step, measured in the configuration halfway (Hughes & Winget 1980).

A particle's displacement over a step has the gradient A = dt C in the configuration before it, so G = A (I + A / 2)^-1
in that halfway. To second order

    G = A - A A / 2

whose symmetric part is the strain increment and whose skew part the spin. A itself would not do: the particles of a
body that spins by w in a step move along tangents, which makes it larger by 1 + w^2 / 2, and sym(A) = 0 does not see
that. The body would grow, by 5 % of its moment of inertia in three turns at a step of 0.5 ms and one turn a second.
"""

import taichi as ti


@ti.func
def midpoint_increment(a: ti.template(), dimension: ti.template()):
    """G [-] of the increment `a` = dt * velocity gradient [-], both row by row, shape [D * D]."""
    return [
        a[i] - 0.5 * row_times_column(a, ti.static(i // dimension), ti.static(i % dimension), dimension)
        for i in ti.static(range(dimension * dimension))
    ]


@ti.func
def row_times_column(a: ti.template(), row: ti.template(), column: ti.template(), dimension: ti.template()):
    """(A A)_ij of a matrix given row by row."""
    value = a[row * dimension] * a[column]
    for k in ti.static(range(1, dimension)):
        value = value + a[row * dimension + k] * a[k * dimension + column]
    return value
