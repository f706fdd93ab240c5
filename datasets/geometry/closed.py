"""Closed surfaces in two and in three dimensions, and their normals."""

from dataclasses import dataclass

import numpy as np

from datasets.errors import InputError
from datasets.geometry.ground import TOUCHING, Floats, Integers

STEEPEST = 4.0
"""Largest slope, sideways over outwards, of the continuation of a face beyond a side of the box on which it ends."""
NEARLY = 2.0e4
"""Widest gap between solids that nearly meet, over the distance at which they are merged: a fiftieth of a cell."""
POINTED = 10.0  # smallest length of an edge along which adjacent solids meet, over such a gap


@dataclass(frozen=True, kw_only=True)
class Body:
    """The surface of a solid, closed; V vertices and F faces in D dimensions."""

    vertices: Floats  # [m], shape [V, D]; in 2D one after the other, anticlockwise
    faces: Integers  # vertices of segments, the solid on the left, or of triangles, anticlockwise from outside, [F, D]
    friction: Floats  # Coulomb coefficient at each vertex [-], shape [V]
    key: str  # key of the solid in the scene, such as `solids[0]`
    grows: bool = True  # whether it grows to close gaps to others: all but rasters, which others touch only in part


def ring(count: int) -> Integers:
    """Segments from each of `count` vertices to the next, the last to the first, shape [count, 2]."""
    return np.stack([np.arange(count), np.roll(np.arange(count), -1)], axis=1)


def unit(vectors: Floats) -> Floats:
    """Vectors normalised to length 1; zero vectors are unchanged."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0.0, length, 1.0))


def pseudonormals(vertices: Floats, faces: Integers) -> tuple[Floats, Floats, Floats]:
    """Unit normals of faces [F, D], 0 for one without area; of their corners [F, D, D], sums around the vertex, in 3D
    weighted by angles; of the edges of triangles [F, 3, D], none for segments (Baerentzen & Aanaes 2005)."""
    corners = vertices[faces]
    edges = np.roll(corners, -1, axis=1) - corners
    angles = np.ones(faces.shape)
    if faces.shape[1] == 2:
        normals = unit(edges[:, 0, ::-1] * [1.0, -1.0])
    else:
        across = np.cross(edges[:, 0], edges[:, 1])
        across[np.linalg.norm(across, axis=1) <= 1.0e-14 * (edges * edges).sum(-1).max(axis=1)] = 0.0
        normals = unit(across)
        ahead, back = unit(edges), -unit(np.roll(edges, 1, axis=1))
        angles = np.arctan2(np.linalg.norm(np.cross(ahead, back), axis=-1), (ahead * back).sum(-1))
    at_vertex = np.zeros_like(vertices)
    np.add.at(at_vertex, faces, angles[..., None] * normals[:, None])
    at_corners = unit(at_vertex)[faces]
    if faces.shape[1] == 2:
        return normals, at_corners, np.zeros((len(faces), 0, 2))
    pairs = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    _, edge = np.unique(pairs, axis=0, return_inverse=True)
    at_edge = np.zeros((int(edge.max()) + 1, 3))
    np.add.at(at_edge, edge.ravel(), np.repeat(normals, 3, axis=0))
    return normals, at_corners, unit(at_edge)[edge.ravel()].reshape(-1, 3, 3)


def snapped(vertices: Floats, axis: int, limit: float) -> Floats:
    """Vertices [V, D]; those within rounding of a side of the box are moved onto it."""
    moved = vertices.copy()
    moved[np.abs(moved[:, axis] - limit) <= TOUCHING, axis] = limit
    return moved


def outside_of_box(body: Body) -> InputError:
    """The error for a body that lies entirely outside the box."""
    return InputError("expected a solid that reaches into the domain, this one lies outside of it", key=body.key)


def meet(first: str, second: str, shared: str, where: str) -> InputError:
    """The error for a solid that meets another one in too small a contact."""
    return InputError(f"expected solids that overlap or share {shared}, got one that meets {first} {where}", key=second)
