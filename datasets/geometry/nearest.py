"""The nearest place of a surface and the signed distance from it, for the initial particles of a scene.

The sign is that of the offset along the pseudonormal of the face, edge or corner on which the foot lies, which is
correct for every closed surface (Baerentzen & Aanaes 2005, https://doi.org/10.1109/TVCG.2005.49).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from datasets.geometry.ground import Floats, Integers
from datasets.geometry.surface import Surface

PAIRS = 1_000_000  # pairs of a point and a face that are computed together
CLASSES = 2.0  # factor in size between the classes of faces that are searched together
ROUNDING = 1.0e-12  # distance over the extent of the surface that counts as 0
INTERIOR = 1.0e-12  # share of a face within which a foot lies on its edge


class Nearest(NamedTuple):
    """The nearest places of a surface for N points in D dimensions."""

    distance: Floats  # signed distance [m], negative inside the solid, shape [N]
    foot: Floats  # the nearest place [m], shape [N, D]
    normal: Floats  # out of the solid at the foot: along the offset, on the surface the pseudonormal; shape [N, D]
    face: Integers  # the face on which the foot lies, shape [N]


def nearest(surface: Surface, points: Floats, within: float = np.inf) -> Nearest:
    """The nearest places of `surface` for `points` [m], shape [N, D]. For points farther than `within` [m] the distance
    may be inf, which costs less; their foot is then some nearby place."""
    points = np.atleast_2d(np.asarray(points, np.float64))
    search, portion = Search(surface), PAIRS // 50
    firsts = range(0, max(1, len(points)), portion)
    parts = [search.nearest(points[first : first + portion], within) for first in firsts]
    return Nearest(*map(np.concatenate, zip(*parts, strict=True)))


def inside(surface: Surface, points: Floats) -> NDArray[np.bool_]:
    """Which `points` [m], shape [N, D], lie in the solid, shape [N]."""
    flat = surface.corners.reshape(-1, surface.dimension)
    within = np.asarray(((points >= flat.min(axis=0)) & (points <= flat.max(axis=0))).all(axis=1))
    within[within] = nearest(surface, points[within]).distance < 0.0
    return within


class Search:
    """Finds the faces near points by their centres, in classes of faces of similar size."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface
        self.centres = 0.5 * (surface.corners.min(axis=1) + surface.corners.max(axis=1))
        radii = self.radii = np.linalg.norm(surface.corners - self.centres[:, None], axis=-1).max(axis=1)
        order = np.floor(np.log(radii / radii.max()) / np.log(CLASSES)).astype(int)
        self.classes = []
        for number in np.unique(order):
            faces = np.flatnonzero(order == number)
            self.classes.append((faces, cKDTree(self.centres[faces]), float(radii[faces].max())))

    def nearest(self, points: Floats, within: float) -> Nearest:
        """The nearest places for `points` [N, D]; some nearby place for points farther than `within` [m]."""
        # Upper and lower bounds of the distance [m], and the face of the upper one.
        bound, nearest_centre, best = np.full((3, len(points)), np.inf)
        face = np.zeros(len(points), np.int64)
        for faces, tree, radius in self.classes:
            centre, number = tree.query(points)
            _, distance, _ = feet(self.surface.corners[faces[number]], points)
            face = np.where(distance < bound, faces[number], face)
            bound = np.minimum(bound, distance)
            nearest_centre = np.minimum(nearest_centre, centre - radius)
        close = np.flatnonzero(nearest_centre <= within)
        for point, candidate in self.pairs(points[close], bound[close]):
            point = close[point]
            _, distance, _ = feet(self.surface.corners[candidate], points[point])
            order = np.lexsort((candidate, distance, point))
            first = order[np.unique(point[order], return_index=True)[1]]
            chosen = first[distance[first] < best[point[first]]]
            best[point[chosen]], face[point[chosen]] = distance[chosen], candidate[chosen]
        foot, distance, weights = feet(self.surface.corners[face], points)
        pseudonormal = normals_at(self.surface, face, weights)
        offset = points - foot
        sign = np.where((offset * pseudonormal).sum(-1) < 0.0, -1.0, 1.0)
        apart = distance > ROUNDING * np.abs(self.surface.corners).max()
        direction = sign[:, None] * offset / np.where(apart, distance, 1.0)[:, None]
        normal = np.where(apart[:, None], direction, pseudonormal)
        signed = np.where(nearest_centre <= within, sign * distance, np.inf)
        return Nearest(distance=signed, foot=foot, normal=normal, face=face)

    def pairs(self, points: Floats, bound: Floats) -> list[tuple[Integers, Integers]]:
        """Points and faces that may lie within `bound` of them, in portions."""
        portions = []
        for faces, tree, radius in self.classes:
            lists = tree.query_ball_point(points, (bound + radius) * (1.0 + 1.0e-9), return_sorted=False)
            counts = np.fromiter(map(len, lists), np.int64, len(lists))
            groups = np.split(np.arange(len(points)), np.flatnonzero(np.diff(np.cumsum(counts) // PAIRS)) + 1)
            for group in groups:
                if counts[group].sum():
                    members = faces[np.concatenate([lists[index] for index in group]).astype(np.int64)]
                    point = np.repeat(group, counts[group])
                    # A face lies within its own radius of its centre, which is mostly smaller than its class's largest.
                    off = np.linalg.norm(points[point] - self.centres[members], axis=1)
                    kept = off <= (bound[point] + self.radii[members]) * (1.0 + 1.0e-9)
                    portions.append((point[kept], members[kept]))
        return portions


def normals_at(surface: Surface, face: Integers, weights: Floats) -> Floats:
    """Pseudonormals [N, D] at places of faces [N] by their barycentric coordinates `weights` [N, D]."""
    zero = weights <= INTERIOR
    normal = surface.normals[face]
    if surface.dimension == 3:
        for edge in range(3):  # weight k + 2 vanishes on edge k
            on_edge = zero[:, (edge + 2) % 3]
            normal = np.where(on_edge[:, None], surface.edge_normals[face, edge], normal)
    for corner in range(surface.dimension):
        at_corner = weights[:, corner] >= 1.0 - INTERIOR
        normal = np.where(at_corner[:, None], surface.corner_normals[face, corner], normal)
    return normal


def feet(corners: Floats, points: Floats) -> tuple[Floats, Floats, Floats]:
    """Nearest places of faces [N, D, D] for points [N, D]: places [m], distances [m] and barycentric coordinates."""
    if corners.shape[-1] == 2:
        along = corners[:, 1] - corners[:, 0]
        share = ((points - corners[:, 0]) * along).sum(-1) / (along * along).sum(-1)
        share = np.clip(share, 0.0, 1.0)
        weights = np.stack([1.0 - share, share], axis=-1)
    else:
        weights = triangle_weights(corners, points)
    foot = np.einsum("nk,nkd->nd", weights, corners)
    # Distances are measured to the foot, so that an inexact weight does not make a corner or an edge appear nearer.
    return foot, np.linalg.norm(points - foot, axis=-1), weights


def triangle_weights(corners: Floats, points: Floats) -> Floats:
    """Barycentric coordinates [N, 3] of the nearest places of triangles [N, 3, 3] (Ericson 2005, section 5.1.5)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac = b - a, c - a
    d1, d2 = ((points - a) * ab).sum(-1), ((points - a) * ac).sum(-1)
    d3, d4 = ((points - b) * ab).sum(-1), ((points - b) * ac).sum(-1)
    d5, d6 = ((points - c) * ab).sum(-1), ((points - c) * ac).sum(-1)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2

    def quotient(top: Floats, bottom: Floats) -> Floats:
        return np.asarray(np.divide(top, bottom, out=np.zeros_like(top), where=bottom != 0.0))

    whole = va + vb + vc
    zero, one = np.zeros_like(va), np.ones_like(va)
    on_ab, on_ac = quotient(d1, d1 - d3), quotient(d2, d2 - d6)
    on_bc = quotient(d4 - d3, (d4 - d3) + (d5 - d6))
    v, w = quotient(vb, whole), quotient(vc, whole)
    cases = [
        ((d1 <= 0.0) & (d2 <= 0.0), (one, zero, zero)),
        ((d3 >= 0.0) & (d4 <= d3), (zero, one, zero)),
        ((d6 >= 0.0) & (d5 <= d6), (zero, zero, one)),
        ((vc <= 0.0) & (d1 >= 0.0) & (d3 <= 0.0), (one - on_ab, on_ab, zero)),
        ((vb <= 0.0) & (d2 >= 0.0) & (d6 <= 0.0), (one - on_ac, zero, on_ac)),
        ((va <= 0.0) & (d4 - d3 >= 0.0) & (d5 - d6 >= 0.0), (zero, one - on_bc, on_bc)),
    ]
    inner = (one - v - w, v, w)
    return np.stack(
        [np.select([case for case, _ in cases], [value[k] for _, value in cases], inner[k]) for k in range(3)], axis=-1
    )
