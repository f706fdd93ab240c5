"""The nearest point of a segment and of a triangle, as weights of their corners."""

import taichi as ti

TINY = 1.0e-20
"""Keeps quotients finite."""


@ti.func
def foot_on_segment(x, a, b):
    """Weights of the corners at the point of a segment nearest to `x` [m]; 0: inside it, 1, 2: that corner."""
    t = (x - a).dot(b - a) / (b - a).dot(b - a)
    part = 0
    if t <= 0.0:
        t, part = 0.0 * t, 1
    elif t >= 1.0:
        t, part = 0.0 * t + 1.0, 2
    return ti.Vector([1.0 - t, t]), part


@ti.func
def foot_on_triangle(x, a, b, c):
    """Weights of the corners at the point of a triangle nearest to `x` [m] (Ericson 2005, section 5.1.5).

    0: inside it; 1, 2, 3: that corner; 4, 5, 6: the edge from corner 1 to 2, 2 to 3, 3 to 1.
    """
    ab, ac = b - a, c - a
    d1, d2 = ab.dot(x - a), ac.dot(x - a)
    d3, d4 = ab.dot(x - b), ac.dot(x - b)
    d5, d6 = ab.dot(x - c), ac.dot(x - c)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    part = 0
    w = ti.Vector([va, vb, vc]) / ti.max(va + vb + vc, TINY)
    if d1 <= 0.0 and d2 <= 0.0:
        w, part = ti.Vector([1.0, 0.0, 0.0]) + 0.0 * w, 1
    elif d3 >= 0.0 and d4 <= d3:
        w, part = ti.Vector([0.0, 1.0, 0.0]) + 0.0 * w, 2
    elif d6 >= 0.0 and d5 <= d6:
        w, part = ti.Vector([0.0, 0.0, 1.0]) + 0.0 * w, 3
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        t = d1 / (d1 - d3)
        w, part = ti.Vector([1.0 - t, t, 0.0]), 4
    elif va <= 0.0 and d4 >= d3 and d5 >= d6:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        w, part = ti.Vector([0.0, 1.0 - t, t]), 5
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = d2 / (d2 - d6)
        w, part = ti.Vector([1.0 - t, 0.0, t]), 6
    return w, part
