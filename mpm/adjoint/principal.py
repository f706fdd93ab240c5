"""Principal stresses with their axes, for vectors of lanes: Jacobi's rotations.

The step carries its return to the tensor without axes (`mpm.physics.stress`). Its reverse turns a bar into the axes,
where principal stresses that are equal or close leave the axes undetermined but not orthonormal: rotations give axes
that are orthonormal to rounding whatever the stress (Golub & Van Loan 2013, section 8.5).
"""

import taichi as ti

from mpm.arrays.access import magnitude, maximum
from mpm.physics.principal import TINY

SWEEPS = {"f32": 4, "f64": 6}
"""Sweeps of three rotations: what is left off the diagonal falls at least with its square."""


@ti.func
def rotation(app, aqq, apq):
    """(cosine, sine, tangent) of the rotation that makes the element pq of a symmetric matrix 0."""
    d, h = aqq - app, 2.0 * apq
    tangent = h / maximum(magnitude(d) + ti.sqrt(d * d + h * h), TINY)
    tangent = ti.select(d < 0.0, 0.0 - tangent, tangent)
    cosine = 1.0 / ti.sqrt(1.0 + tangent * tangent)
    return cosine, tangent * cosine, tangent


@ti.func
def principal_axes(xx, yy, zz, xy, yz, zx, precision: ti.template()):
    """Principal values s1 >= s2 >= s3, and the components of the axes of each, three after three."""
    zero = 0.0 * xx
    one = zero + 1.0
    axx, ayy, azz, axy, ayz, azx = xx + zero, yy + zero, zz + zero, xy + zero, yz + zero, zx + zero
    ux, uy, uz = one, zero, zero
    vx, vy, vz = zero, one, zero
    wx, wy, wz = zero, zero, one
    for _ in range(ti.static(SWEEPS[precision])):
        c, s, t = rotation(axx, ayy, axy)
        axx, ayy, axy = axx - t * axy, ayy + t * axy, zero
        azx, ayz = c * azx - s * ayz, s * azx + c * ayz
        ux, vx = c * ux - s * vx, s * ux + c * vx
        uy, vy = c * uy - s * vy, s * uy + c * vy
        uz, vz = c * uz - s * vz, s * uz + c * vz
        c, s, t = rotation(ayy, azz, ayz)
        ayy, azz, ayz = ayy - t * ayz, azz + t * ayz, zero
        axy, azx = c * axy - s * azx, s * axy + c * azx
        vx, wx = c * vx - s * wx, s * vx + c * wx
        vy, wy = c * vy - s * wy, s * vy + c * wy
        vz, wz = c * vz - s * wz, s * vz + c * wz
        c, s, t = rotation(axx, azz, azx)
        axx, azz, azx = axx - t * azx, azz + t * azx, zero
        axy, ayz = c * axy - s * ayz, s * axy + c * ayz
        ux, wx = c * ux - s * wx, s * ux + c * wx
        uy, wy = c * uy - s * wy, s * uy + c * wy
        uz, wz = c * uz - s * wz, s * uz + c * wz
    # In descending order.
    swap = ayy > axx
    axx, ayy = ti.select(swap, ayy, axx), ti.select(swap, axx, ayy)
    ux, vx = ti.select(swap, vx, ux), ti.select(swap, ux, vx)
    uy, vy = ti.select(swap, vy, uy), ti.select(swap, uy, vy)
    uz, vz = ti.select(swap, vz, uz), ti.select(swap, uz, vz)
    swap = azz > ayy
    ayy, azz = ti.select(swap, azz, ayy), ti.select(swap, ayy, azz)
    vx, wx = ti.select(swap, wx, vx), ti.select(swap, vx, wx)
    vy, wy = ti.select(swap, wy, vy), ti.select(swap, vy, wy)
    vz, wz = ti.select(swap, wz, vz), ti.select(swap, vz, wz)
    swap = ayy > axx
    axx, ayy = ti.select(swap, ayy, axx), ti.select(swap, axx, ayy)
    ux, vx = ti.select(swap, vx, ux), ti.select(swap, ux, vx)
    uy, vy = ti.select(swap, vy, uy), ti.select(swap, uy, vy)
    uz, vz = ti.select(swap, vz, uz), ti.select(swap, uz, vz)
    return axx, ayy, azz, ux, uy, uz, vx, vy, vz, wx, wy, wz
