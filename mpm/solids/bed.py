"""The bed of a terrain in 3D: elevations and friction of its raster on a lattice in plan, half a cell apart.

Contact uses the B-spline of the bed (`mpm.solids.terrain`). A node has the elevation of the raster's triangles there
(`datasets.geometry.ground`) or, if posts are closer than nodes, their mean over the square around it; planes stay
exact. Friction is bilinear between posts.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from datasets.geometry.contact_surface import HeightField
from datasets.geometry.ground import linear, on_triangles
from datasets.scene import Domain
from mpm.arrays.layout import BED_FIRST, BED_PER_CELL, PADDING, Offset, TerrainNumber, node_shape

Array = NDArray[Any]
Floats = NDArray[np.float64]
MOST_SAMPLES = 4  # along each side of the square around a node of the lattice
PORTION = 2**20  # nodes of the lattice whose elevations are found together


@dataclass(frozen=True, kw_only=True, eq=False)
class Bed:
    """Elevations of a height field on the lattice of a box; X times Z nodes."""

    field: HeightField
    spacing: float  # between the nodes [m]
    x: Floats  # of the nodes [m], shape [X]
    z: Floats  # [m], shape [Z]
    heights: Floats  # [m], shape [X, Z]

    def at_nodes(self, at_posts: Floats) -> Floats:
        """Values of the posts interpolated at the nodes, shape [X, Z]."""
        along, across = self.from_posts
        return np.asarray(along @ at_posts @ across.T)

    def to_posts(self, adjoint: Floats) -> Floats:
        """The reverse of `at_nodes`."""
        along, across = self.from_posts
        return np.asarray(along.T @ adjoint @ across)

    @cached_property
    def from_posts(self) -> tuple[Any, Any]:
        """Weights of the posts along x and along z at the nodes, shapes [X, posts] and [Z, posts]."""
        return self.weights(self.x, self.field.x), self.weights(self.z, self.field.z)

    def weights(self, nodes: Floats, posts: Floats) -> Any:
        """Weights of the posts at the nodes along one axis, linear between posts."""
        matrix = sparse.csr_array((len(nodes), len(posts)))
        offsets = sample_offsets(self.spacing, posts)
        for offset in offsets:
            index, part = linear(posts, nodes + offset)
            row = np.arange(len(nodes))
            both = np.concatenate([1.0 - part, part]) / len(offsets), (np.tile(row, 2), np.append(index, index + 1))
            matrix = matrix + sparse.csr_array(both, matrix.shape)
        return matrix.tocsr()

    def contact(self, points: Floats, frictions: Floats) -> tuple[Floats, Floats, Floats]:
        """d [m], n and friction [-] at points [m], [N, 3], as in the kernel, from `frictions`; [N], [N, 3], [N]."""
        i, wx, sx = spline(points[:, 0], self.x, self.spacing)
        k, wz, sz = spline(points[:, 2], self.z, self.spacing)
        around = i[:, None, None] + np.arange(3)[:, None], k[:, None, None] + np.arange(3)
        rise = self.heights[around] - points[:, 1, None, None]
        height, along, across = (np.einsum("nij,ni,nj->n", rise, *pair) for pair in ((wx, wz), (sx, wz), (wx, sz)))
        length = np.sqrt(1.0 + along**2 + across**2)
        normal = np.stack([-along, np.ones_like(along), -across], axis=1) / length[:, None]
        friction = np.full(len(points), float(frictions.flat[0]))
        if frictions.size > 1:
            friction = np.einsum("nij,ni,nj->n", frictions[around], wx, wz)
        return -height / length, normal, friction

    def column_heights(self) -> Floats:
        """H [m] at the columns of nodes of the grid, in a row."""
        heights = self.heights
        for _ in range(2):
            count = (len(heights) - 3) // BED_PER_CELL + 1
            rows = [heights[first::BED_PER_CELL][:count] for first in range(3)]
            heights = (0.125 * rows[0] + 0.75 * rows[1] + 0.125 * rows[2]).T
        return heights.ravel()


def sample_offsets(spacing: float, posts: Floats) -> Floats:
    """Offsets of samples around a node of the lattice [m]: a single one if posts are no closer than nodes."""
    closest = float(np.diff(posts).min())
    count = max(1, min(MOST_SAMPLES, math.ceil(spacing / closest - 1.0e-6)))
    return np.asarray(spacing * ((np.arange(count) + 0.5) / count - 0.5))


def spline(at: Floats, nodes: Floats, spacing: float) -> tuple[NDArray[np.int64], Floats, Floats]:
    """The first of the three nodes around each place, shape [N], their weights and slopes [1/m], shape [N, 3]."""
    first = np.clip(np.floor((at - nodes[0]) / spacing - 0.5).astype(np.int64), 0, len(nodes) - 3)
    f = (at - nodes[first]) / spacing
    weights = np.stack([0.5 * (1.5 - f) ** 2, 0.75 - (f - 1.0) ** 2, 0.5 * (f - 0.5) ** 2], axis=1)
    return first, weights, np.stack([f - 1.5, 2.0 - 2.0 * f, f - 0.5], axis=1) / spacing


@lru_cache(maxsize=4)
def bed_of(field: HeightField, domain: Domain) -> Bed:
    """The bed of a height field in a box; the same for the same field and box."""
    spacing = domain.cell / BED_PER_CELL
    counts = [BED_PER_CELL * (nodes - 1 - 2 * PADDING) + 2 * BED_FIRST + 1 for nodes in node_shape(domain)[::2]]
    x, z = (np.asarray(spacing * (np.arange(count) - BED_FIRST), np.float64) for count in counts)
    heights = np.zeros((len(x), len(z)))
    offsets = [sample_offsets(spacing, posts) for posts in (field.x, field.z)]
    for dz in offsets[1].tolist():
        k, v = linear(field.z, z + dz)
        for dx in offsets[0].tolist():
            i, u = linear(field.x, x + dx)
            rows = max(1, PORTION // len(z))
            for first in range(0, len(x), rows):
                part = slice(first, first + rows)
                heights[part] += on_triangles(field.heights, i[part, None], k, u[part, None], v)
    return Bed(field=field, spacing=spacing, x=x, z=z, heights=heights / (len(offsets[0]) * len(offsets[1])))


@lru_cache(maxsize=4)
def frictions_of(bed: Bed, most: float) -> Floats:
    """Frictions at the nodes of a bed [-], shape [X, Z], with at most `most` at the posts; [1, 1] if uniform."""
    at_posts = np.minimum(bed.field.friction, most)
    return at_posts if at_posts.size == 1 else bed.at_nodes(at_posts)


def bed_arrays(
    beds: Sequence[Bed | None], mosts: Sequence[float], faces: int, offsets: NDArray[np.int32], real: np.dtype[Any]
) -> tuple[Array, Array]:
    """The numbers of all beds, and their elevations at columns of nodes; their places go to `offsets`.

    mosts: the largest Coulomb coefficient in each scene [-]; faces: how many are listed. Scenes with the same bed share
    its numbers."""
    numbers, columns, places = [np.zeros(1, real)], [np.zeros(1, real)], dict[tuple[Bed, float], tuple[int, int]]()
    offsets[:, Offset.TERRAIN_FACE] = faces
    for offset, bed, most in zip(offsets, beds, mosts, strict=False):
        if bed is None:
            continue
        varied = bed.field.friction.size > 1
        if (bed, most) not in places:
            places[bed, most] = sum(map(len, numbers)), sum(map(len, columns))
            header, frictions = np.zeros(len(TerrainNumber)), frictions_of(bed, most)
            header[TerrainNumber.NEARNESS] = 1.0 / math.hypot(1.0, bed.field.steepest)
            header[TerrainNumber.FRICTION] = frictions.flat[0]
            parts = [header, bed.heights, *([frictions] if varied else [])]
            numbers += [part.ravel().astype(real) for part in parts]
            columns.append(bed.column_heights().astype(real))
        offset[Offset.TERRAIN], offset[Offset.COLUMNS] = places[bed, most]
        offset[Offset.TERRAIN_SOLID], offset[Offset.TERRAIN_FRICTION] = bed.field.solid, varied
    return np.concatenate(numbers), np.concatenate(columns)
