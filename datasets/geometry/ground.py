"""The ground: lines and height fields of terrain, beyond the sides of the box, and their elevation anywhere in plan."""

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.geometry.margins import BEYOND, TOUCHING, Box
from datasets.geometry.solid import Solid

if TYPE_CHECKING:
    from datasets.scene import Scene

Floats = NDArray[np.float64]


def elevation(solids: tuple[Solid, ...], box: Box, plan: Floats) -> Floats:
    """Elevation [m] of the highest terrain, or of the floor y = 0, at places in plan [m], [N, D - 1]; shape [N]."""
    height = np.zeros(len(plan))
    for index, solid in enumerate(solids):
        if solid.kind != "terrain":
            continue
        key = f"solids[{index}]"
        if box.dimension == 2:
            points, _ = ground_line(solid, key, box)
            height = np.maximum(height, np.interp(plan[:, 0], points[:, 0], points[:, 1]))
        else:
            x, z, heights, _ = ground_grid(solid, key, box)
            height = np.maximum(height, interpolated(x, z, heights, plan))
    return height


def ground_raster(scene: "Scene", spacing: float) -> tuple[Floats, Floats]:
    """Elevation [m] and Coulomb coefficient [-] of the ground of `scene`, `spacing` [m] apart from the box's corner on.

    Both of shape [X], in 3D [X, Z], to the first place at or beyond the end of the box. Where no terrain is, it is the
    floor.
    """
    height, friction, _ = _ground_at(scene, spacing)
    return height, friction


def topmost(scene: "Scene", spacing: float) -> NDArray[np.int64]:
    """Number of the solid that is the ground at each place of `ground_raster`, -1 for the floor; shape [X(, Z)]."""
    return _ground_at(scene, spacing)[2]


def _ground_at(scene: "Scene", spacing: float) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Elevation [m], Coulomb coefficient [-] and number of the solid that is the ground, each of shape [X(, Z)]."""
    size, dimension = scene.domain.size, scene.dimension
    box = Box(size, scene.domain.cell)
    axes = [spacing * np.arange(math.ceil(size[axis] / spacing - 1.0e-6) + 1) for axis in range(dimension) if axis != 1]
    grids = np.meshgrid(*axes, indexing="ij")
    plan = np.stack([grid.ravel() for grid in grids], axis=1)
    height, friction = np.zeros(len(plan)), np.full(len(plan), scene.floor_friction)
    top = np.full(len(plan), -1)
    for index, solid in enumerate(scene.solids):
        if solid.kind != "terrain":
            continue
        if dimension == 2:
            points, rough = ground_line(solid, f"solids[{index}]", box)
            own, mu = (np.interp(plan[:, 0], points[:, 0], values) for values in (points[:, 1], rough))
        else:
            x, z, heights, roughs = ground_grid(solid, f"solids[{index}]", box)
            own, mu = interpolated(x, z, heights, plan), interpolated(x, z, roughs, plan)
        higher = own >= height
        friction, top = np.where(higher, mu, friction), np.where(higher, index, top)
        height = np.maximum(height, own)
    shape = grids[0].shape
    return height.reshape(shape), friction.reshape(shape), top.reshape(shape)


def ground_line(solid: Solid, key: str, box: Box) -> tuple[Floats, Floats]:
    """Points [P, 2] of a ground line [m] and friction at them [P], to some cells beyond the box. Raises InputError."""
    points = np.array(solid.points, dtype=np.float64)
    friction = np.broadcast_to(np.asarray(solid.friction, np.float64), len(points)).copy()
    length = box.size[0]
    for gap, name in ((points[0, 0], "start at x = 0"), (length - points[-1, 0], f"end at x = {length:g}")):
        if gap > box.cell + TOUCHING:
            raise InputError(
                f"expected a ground line over the whole box, to {name} or within a cell of it, "
                f"got x from {points[0, 0]:g} to {points[-1, 0]:g}",
                key=f"{key}.points",
            )
    return lengthened(points, friction, length, BEYOND * box.cell)


def lengthened(points: Floats, friction: Floats, length: float, beyond: float) -> tuple[Floats, Floats]:
    """A ground line that begins before -beyond and ends after length + beyond.

    To the sides of the box, 0 and `length`, it goes on level; from there on as it arrives, where it does so at a side.
    """
    for limit, outer, first in ((0.0, -beyond, True), (length, length + beyond, False)):
        end, other = (0, 1) if first else (-1, -2)
        inner = (points[end, 0] > outer) if first else (points[end, 0] < outer)
        if not inner:
            continue
        run = points[end, 0] - points[other, 0]
        on_side = abs(points[end, 0] - limit) <= TOUCHING and abs(run) > TOUCHING
        slope = (points[end, 1] - points[other, 1]) / run if on_side else 0.0
        new = np.array([[outer, points[end, 1] + slope * (outer - points[end, 0])]])
        points = np.concatenate([new, points] if first else [points, new])
        friction = np.concatenate([friction[:1], friction] if first else [friction, friction[-1:]])
    return points, friction


def ground_grid(solid: Solid, key: str, box: Box) -> tuple[Floats, Floats, Floats, Floats]:
    """x [X], z [Z] and elevations [X, Z] of a terrain [m], its friction [X, Z], to some cells beyond the box."""
    heights = np.array(solid.heights, dtype=np.float64)
    friction = np.broadcast_to(np.asarray(solid.friction, np.float64), heights.shape)
    axes: list[Floats] = []
    for number, (axis, name) in enumerate(((0, "x"), (2, "z"))):
        origin, spacing = (solid.origin or ())[number], (solid.spacing or ())[number]
        coordinates = origin + spacing * np.arange(heights.shape[number])
        length, beyond = box.size[axis], BEYOND * box.cell
        slack = max(box.cell, spacing) + TOUCHING
        if coordinates[0] > slack or coordinates[-1] < length - slack:
            raise InputError(
                f"expected heights over the whole box, {name} from 0 to {length:g} or within a cell of it, "
                f"got {coordinates[0]:g} to {coordinates[-1]:g}",
                key=f"{key}.heights",
            )
        h, mu = np.moveaxis(heights, number, 0), np.moveaxis(friction, number, 0)
        for limit, outer, first in ((0.0, -beyond, True), (length, length + beyond, False)):
            end, other = (0, 1) if first else (-1, -2)
            if coordinates[end] <= outer if first else coordinates[end] >= outer:
                continue
            slope = (h[end] - h[other]) / (coordinates[end] - coordinates[other])
            on_side = abs(coordinates[end] - limit) <= TOUCHING
            new = h[end] + (slope * (outer - coordinates[end]) if on_side else 0.0)
            coordinates = np.concatenate([[outer], coordinates] if first else [coordinates, [outer]])
            h = np.concatenate([new[None], h] if first else [h, new[None]])
            mu = np.concatenate([mu[:1], mu] if first else [mu, mu[-1:]])
        axes.append(np.asarray(coordinates, np.float64))
        heights, friction = np.moveaxis(h, 0, number), np.moveaxis(mu, 0, number)
    return axes[0], axes[1], heights, friction


def first_diagonal(values: Floats) -> NDArray[np.bool_]:
    """Whether the triangles of each cell of a grid [X, Z] meet along its first corner's diagonal, [X - 1, Z - 1].

    They do along the diagonal whose ends differ less, so that mirror images have mirrored triangles.
    """
    return np.asarray(np.abs(values[:-1, :-1] - values[1:, 1:]) <= np.abs(values[1:, :-1] - values[:-1, 1:]))


def interpolated(x: Floats, z: Floats, values: Floats, plan: Floats) -> Floats:
    """Values of a grid [X, Z] at `plan` [N, 2], linear on its triangles; beyond the grid those of its edge; [N]."""
    i = np.clip(np.searchsorted(x, plan[:, 0], side="right") - 1, 0, len(x) - 2)
    k = np.clip(np.searchsorted(z, plan[:, 1], side="right") - 1, 0, len(z) - 2)
    u = np.clip((plan[:, 0] - x[i]) / (x[i + 1] - x[i]), 0.0, 1.0)
    v = np.clip((plan[:, 1] - z[k]) / (z[k + 1] - z[k]), 0.0, 1.0)
    a, b, c, d = values[i, k], values[i + 1, k], values[i + 1, k + 1], values[i, k + 1]
    along = np.where(u >= v, a + u * (b - a) + v * (c - b), a + v * (d - a) + u * (c - d))
    across = np.where(u + v <= 1.0, a + u * (b - a) + v * (d - a), c + (1.0 - u) * (d - c) + (1.0 - v) * (b - c))
    return np.asarray(np.where(first_diagonal(values)[i, k], along, across))
