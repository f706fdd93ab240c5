"""The ground: lines and height fields of terrain, extended beyond the box, and their elevation anywhere in plan."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from datasets.errors import require
from datasets.scene.grid_field import Grid
from datasets.scene.parts import Domain, SceneLayout, Solid, coefficient

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Solids = tuple[Solid, ...]

BEYOND = 8.0
"""Cells by which a solid that reaches a side of the box continues beyond it, so that none of its faces lies there."""
TOUCHING = 1.0e-9  # distance [m] up to which lengths that a user wrote in decimals are equal
CLOSING = 1.0e-6  # half of the widest gap, in cells, that touching solids leave between them by rounding


def plan_axes(dimension: int) -> list[int]:
    """The horizontal axes: x and, in 3D, z."""
    return list(range(0, dimension, 2))


def elevation(solids: Solids, domain: Domain, plan: Floats) -> Floats:
    """Elevation [m] of the highest terrain, or of the floor y = 0, at places in plan [m], [N, D - 1]; shape [N]."""
    return highest(solids, domain, plan, 0.0)[0]


def slopes_in_plan(scene: SceneLayout, grid: Grid) -> list[Floats]:
    """dh/dx and dh/dz [-] of `elevation` at the nodes of a grid in plan, both of shape [X, Z]; 0 along a single row."""
    heights = elevation(scene.solids, scene.domain, grid.positions).reshape(grid.nodes)
    rows = enumerate(zip(grid.spacing, grid.nodes, strict=True))
    return [np.gradient(heights, step, axis=axis) if n > 1 else np.zeros_like(heights) for axis, (step, n) in rows]


def ground_raster(scene: SceneLayout, spacing: float) -> tuple[Floats, Floats, Integers]:
    """`highest` of a scene at places `spacing` [m] apart, from the box's corner to the first place at or beyond its
    end; each of shape [X], in 3D [X, Z]."""
    lengths = np.array(scene.domain.size)[plan_axes(scene.dimension)]
    axes = [spacing * np.arange(math.ceil(length / spacing - 1.0e-6) + 1) for length in lengths.tolist()]
    plan = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    shape, places = plan.shape[:-1], plan.reshape(-1, len(axes))
    height, friction, top = highest(scene.solids, scene.domain, places, coefficient(scene.floor_friction, 1.0))
    return height.reshape(shape), friction.reshape(shape), top.reshape(shape)


def turbulence_raster(scene: SceneLayout, spacing: float) -> Floats | None:
    """1 / xi [s^2/m] of the highest terrain at the same places, 0 where it has no turbulence; None if none has any."""
    if all(solid.turbulence is None for solid in scene.solids):
        return None
    drags = []
    for solid in scene.solids:
        drag = np.array(0.0 if solid.turbulence is None else 1.0 / np.array(solid.turbulence))
        # Passed as a friction, it is interpolated like friction.
        drags.append(replace(solid, friction=tuple(map(tuple, drag.tolist())) if drag.ndim else float(drag)))
    return ground_raster(replace(scene, solids=tuple(drags), floor_friction=0.0), spacing)[1]


def highest(solids: Solids, domain: Domain, plan: Floats, floor_friction: float) -> tuple[Floats, Floats, Integers]:
    """Elevation [m], Coulomb coefficient [-] and index of the highest terrain at places in plan [m], [N, D - 1]; each
    of shape [N]. Where no terrain is above the floor y = 0, those of the floor, with index -1."""
    height, friction, top = np.zeros(len(plan)), np.full(len(plan), floor_friction), np.full(len(plan), -1)
    for index, solid in enumerate(solids):
        if solid.kind != "terrain":
            continue
        axes, heights, rough = ground_grid(solid, f"solids[{index}]", domain)
        level, mu = interpolated(axes, heights, plan), interpolated(axes, rough, plan)
        higher = level >= height
        friction, top = np.where(higher, mu, friction), np.where(higher, index, top)
        height = np.maximum(height, level)
    return height, friction, top


@lru_cache(maxsize=4)
def ground_grid(solid: Solid, key: str, domain: Domain) -> tuple[list[Floats], Floats, Floats]:
    """x (in 3D x and z), elevations [m] and friction of a terrain, both [X(, Z)], to some cells beyond the box; cached
    for equal terrain. Raises InputError unless it covers the box to within a cell."""
    if domain.dimension == 2:
        x, heights = np.array(solid.points, np.float64).T
        given, name, slack = [x], "points", [domain.cell]
    else:
        heights, name = np.array(solid.heights, np.float64), "heights"
        steps = list(zip(solid.origin or (), solid.spacing or (), heights.shape, strict=True))
        given = [np.asarray(origin + spacing * np.arange(count), np.float64) for origin, spacing, count in steps]
        slack = [max(domain.cell, spacing) for _, spacing, _ in steps]
    friction = np.broadcast_to(np.asarray(solid.friction, np.float64), heights.shape)
    axes: list[Floats] = []
    for number, (axis, at) in enumerate(zip(plan_axes(domain.dimension), given, strict=True)):
        length = domain.size[axis]
        expected = f"ground over the whole box, {'xyz'[axis]} from 0 to {length:g} or within a cell of it"
        whole = at[0] <= slack[number] + TOUCHING and at[-1] >= length - slack[number] - TOUCHING
        require(bool(whole), f"{key}.{name}", expected, f"{at[0]:g} to {at[-1]:g}")
        at, h, place = extended(at, np.moveaxis(heights, number, 0), length, BEYOND * domain.cell)
        axes.append(at)
        heights, friction = np.moveaxis(h, 0, number), np.take(friction, place, axis=number)
    return axes, heights, friction


def extended(at: Floats, values: Floats, length: float, beyond: float) -> tuple[Floats, Floats, Integers]:
    """Coordinates [N] and values [N, ...] extended from before -beyond to after length + beyond [m], and the index of
    the given place whose other properties each has. They are level up to the sides of the box, 0 and `length`; if the
    given ones end at a side, they continue beyond it with their slope."""
    place = np.arange(len(at))
    for limit, outer, first in ((0.0, -beyond, True), (length, length + beyond, False)):
        end, other = (0, 1) if first else (-1, -2)
        if at[end] <= outer if first else at[end] >= outer:
            continue
        run = at[end] - at[other]
        on_side = abs(at[end] - limit) <= TOUCHING and abs(run) > TOUCHING
        slope = (values[end] - values[other]) / run if on_side else 0.0
        new = values[end] + slope * (outer - at[end])
        where = 0 if first else len(at)
        at, values = np.insert(at, where, outer), np.insert(values, where, new, axis=0)
        place = np.insert(place, where, place[end])
    return at, values, place


def lowest_ground(domain: Domain, solid: Solid, key: str) -> float:
    """The smallest elevation of a terrain in the box [m], in 3D at its posts. Raises InputError as `ground_grid`."""
    axes, heights, _ = ground_grid(solid, key, domain)
    if domain.dimension == 2:
        return float(np.interp(np.clip(axes[0], 0.0, domain.size[0]), axes[0], heights).min())
    within = [(axis >= 0.0) & (axis <= length) for axis, length in zip(axes, domain.size[::2], strict=True)]
    return float(heights[np.ix_(*within)].min(initial=0.0))


def grid_triangles(values: Floats) -> Integers:
    """The two triangles of every cell of a grid [X, Z], by node index, anticlockwise from above; [T, 3]. They meet
    along the diagonal whose ends differ less, so that mirror images have mirrored triangles."""
    number = np.arange(values.size).reshape(values.shape)
    a, b, c, d = (corner.ravel() for corner in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    height = values.ravel()
    first = (np.abs(height[a] - height[c]) <= np.abs(height[b] - height[d]))[:, None]
    return np.where(first, np.stack([a, c, b, a, d, c], axis=1), np.stack([a, d, b, b, d, c], axis=1)).reshape(-1, 3)


def interpolated(axes: Sequence[Floats], values: Floats, plan: Floats) -> Floats:
    """Values of a line [X] or a grid [X, Z] at `plan` [N, D - 1], linear on its segments or triangles, beyond it those
    of its edge; shape [N]."""
    if len(axes) == 1:
        return np.asarray(np.interp(plan[:, 0], axes[0], values))
    (i, u), (k, v) = (linear(axis, plan[:, number]) for number, axis in enumerate(axes))
    return on_triangles(values, i, k, u, v)


def linear(axis: Floats, at: Floats) -> tuple[Integers, Floats]:
    """The segment of an axis on which each place lies, and its relative position on it; limited to the ends."""
    index = np.clip(np.searchsorted(axis, at, side="right") - 1, 0, len(axis) - 2)
    return index, np.clip((at - axis[index]) / (axis[index + 1] - axis[index]), 0.0, 1.0)


def on_triangles(values: Floats, i: Integers, k: Integers, u: Floats, v: Floats) -> Floats:
    """Values of a grid [X, Z] at relative positions `u`, `v` in its cells `i`, `k`, linear on their triangles."""
    a, b, c, d = values[i, k], values[i + 1, k], values[i + 1, k + 1], values[i, k + 1]
    along = np.where(u >= v, a + u * (b - a) + v * (c - b), a + v * (d - a) + u * (c - d))
    across = np.where(u + v <= 1.0, a + u * (b - a) + v * (d - a), c + (1.0 - u) * (d - c) + (1.0 - v) * (b - c))
    return np.asarray(np.where(np.abs(a - c) <= np.abs(b - d), along, across))
