"""Which faces of the solids' surface a place of the grid is near: lists for cells, distances at nodes.

Cells and nodes are numbered alike, as `mpm.arrays.access.node_strides` numbers nodes: a cell by its lowest node.
Nothing is stored beyond a cut-off distance from the surface.

**Lists.** A point p of a cell with centre c and half diagonal h has d(c, F) - h <= d(p, F) <= d(c, F) + h from a face
F. So F can be the nearest one of a point at a distance of at most `cutoff` only where d(c, F) <= min(smallest + 2 h,
cutoff + h), `smallest` being the distance of c from its nearest face, and a segment of length `travel` that starts in
the cell can cut F only where d(c, F) <= h + travel. Faces that are large against a cell are searched in pieces.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.geometry.nearest import feet, sign_and_normal
from datasets.geometry.surface import Surface
from datasets.memory import require
from datasets.scene import Domain
from mpm.arrays.layout import PADDING
from mpm.solids.face_search import nearest_listed, pairs_within

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

PIECE = 4.0
"""Longest side [cells] of the pieces in which large faces are searched."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Faces:
    """Faces near cells, and the surface at the nodes near it; D dimensions."""

    first: NDArray[np.int32]
    """Where the list of each cell begins in `faces`, shape [nodes + 1]; that of cell n ends at first[n + 1]."""
    faces: NDArray[np.int32]
    """Faces of the surface, those of one cell after those of another, in their order, shape [L]."""
    nodes: Integers
    """The nodes within the cut-off, shape [K]."""
    distance: Floats
    """Their signed distance from the surface [m], negative inside, shape [K]."""
    normal: Floats
    """Unit vectors out of the solid at them, shape [K, D]."""
    face: NDArray[np.int32]
    """The face nearest to each, shape [K]."""
    solid: NDArray[np.int32]
    """The solid it belongs to, shape [K]."""
    friction: Floats
    """Coulomb coefficient at the place nearest to each [-], shape [K]."""


def node_shape(domain: Domain) -> tuple[int, ...]:
    """Nodes of the background grid along each axis, PADDING cells beyond every wall."""
    return tuple(round(length / domain.cell) + 2 * PADDING + 1 for length in domain.size)


def node_positions(domain: Domain, nodes: Integers) -> Floats:
    """Positions of nodes by their numbers [m], shape [N, D]."""
    index = np.stack(np.unravel_index(nodes, node_shape(domain)), axis=-1)
    return np.asarray((index - PADDING) * domain.cell)


def faces_near(domain: Domain, surface: Surface, *, cutoff: float = 2.0, travel: float = 1.0) -> Faces:
    """The faces of `surface` near the cells of `domain` and the surface at the nodes near it.

    cutoff: largest distance from the surface that is listed [cells]; travel: longest displacement of a step [cells].
    """
    cell, shape = domain.cell, node_shape(domain)
    half = 0.5 * cell * np.sqrt(len(domain.size))
    cells, faces, distance = near_pairs(domain, surface, max(cutoff * cell + half, travel * cell + half))
    order = np.lexsort((faces, cells))
    cells, faces, distance = cells[order], faces[order], distance[order]
    # Pieces of a face meet the same cell: the nearest of them counts.
    starts = np.flatnonzero(np.diff(cells, prepend=-1) | np.diff(faces, prepend=-1))
    distance = np.minimum.reduceat(distance, starts) if len(starts) else distance
    cells, faces = cells[starts], faces[starts]
    groups = np.flatnonzero(np.diff(cells, prepend=-1))
    smallest = np.minimum.reduceat(distance, groups) if len(groups) else distance
    smallest = np.repeat(smallest, np.diff(groups, append=len(cells)))
    slack = 1.0e-9 * cell
    kept = (distance <= np.minimum(smallest + 2.0 * half, cutoff * cell + half) + slack) | (
        distance <= half + travel * cell + slack
    )
    cells, faces = cells[kept], faces[kept]
    first = np.zeros(int(np.prod(shape)) + 1, np.int64)
    np.add.at(first, cells + 1, 1)
    return Faces(
        first=np.cumsum(first).astype(np.int32),
        faces=faces.astype(np.int32),
        **nodes_near(domain, surface, cells, faces, cutoff * cell),
    )


def nodes_near(domain: Domain, surface: Surface, cells: Integers, faces: Integers, cutoff: float) -> dict[str, Any]:
    """Distance, normal and friction at the nodes within `cutoff` [m], by the names of `Faces`."""
    groups = np.flatnonzero(np.diff(cells, prepend=-1))
    nodes: Integers = cells[groups]
    points = node_positions(domain, nodes)
    points_in_space = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    ends = np.append(groups, len(cells))
    nearest, square = nearest_listed(in_space(surface.corners), points_in_space, ends, faces)
    near: NDArray[np.bool_] = np.asarray(square <= cutoff * cutoff, bool)
    nodes, points, nearest = nodes[near], points[near], nearest[near]
    foot = sign_and_normal(surface, points, nearest)
    _, _, weights = feet(surface.corners[nearest], points)
    friction = surface.friction[nearest]
    stuck = np.asarray(np.isinf(friction).any(axis=1))
    return {
        "nodes": nodes,
        "distance": foot.distance,
        "normal": foot.normal,
        "face": nearest.astype(np.int32),
        "solid": surface.solid[nearest],
        "friction": np.where(stuck, np.inf, (weights * np.where(stuck[:, None], 0.0, friction)).sum(axis=1)),
    }


def near_pairs(domain: Domain, surface: Surface, limit: float) -> tuple[Integers, Integers, Floats]:
    """Cells and faces whose centre lies within `limit` [m] of the face, and the distance of the centre [m], all [P]."""
    cell, shape = domain.cell, np.array(node_shape(domain))
    corners, face = pieces(surface.corners, PIECE * cell)
    low = np.floor((corners.min(axis=1) - limit) / cell - 0.5).astype(np.int64) + PADDING
    high = np.ceil((corners.max(axis=1) + limit) / cell - 0.5).astype(np.int64) + PADDING + 1
    low, high = np.maximum(low, 0), np.minimum(high, shape - 1)
    # In two dimensions a segment is a triangle without area, in a grid of a single layer.
    deep = 3 - len(shape)
    low, high = np.pad(low, ((0, 0), (0, deep))), np.pad(high, ((0, 0), (0, deep)), constant_values=1)
    first = (0.5 - PADDING) * cell
    origin = np.array([first, first, 0.0 if deep else first])
    rows = np.array([*np.cumprod(shape[:0:-1])[::-1], 1, *[0] * deep], np.int64)
    cells, found, distance = pairs_within(in_space(corners), low, high, origin, cell, rows, limit)
    return cells, face[found], distance


def in_space(corners: Floats) -> Floats:
    """Faces as triangles in three dimensions, shape [F, 3, 3]; a segment a b is the triangle a b b at z = 0."""
    if corners.shape[-1] == 3:
        return corners
    corners = np.concatenate([corners, corners[:, 1:]], axis=1)
    return np.concatenate([corners, np.zeros_like(corners[..., :1])], axis=2)


PIECE_BYTES = 400
"""Bytes that a piece of a face takes while it is cut."""


def pieces(corners: Floats, longest: float) -> tuple[Floats, Integers]:
    """Faces [F, D, D] cut at the middles of their edges until none is longer than `longest` [m]; the face of each."""
    edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=-1).max(axis=1)
    halvings = np.ceil(np.log2(np.maximum(edges / longest, 1.0)))
    count = float((2.0 ** ((corners.shape[-1] - 1) * halvings)).sum())
    instead = f"solids are cut into {count:.3g} pieces of some cells; larger cells, or smaller solids"
    require(PIECE_BYTES * count, "the faces of solids", instead, key="solids")
    face = np.arange(len(corners))
    done: list[tuple[Floats, Integers]] = []
    while len(corners):
        edges = np.roll(corners, -1, axis=1) - corners
        long = np.linalg.norm(edges, axis=-1).max(axis=1) > longest
        done.append((corners[~long], face[~long]))
        corners, face = corners[long], face[long]
        if corners.shape[-1] == 2:
            middle = corners.mean(axis=1)
            parts = [np.stack([corners[:, 0], middle], axis=1), np.stack([middle, corners[:, 1]], axis=1)]
        else:
            (a, b, c), (ab, bc, ca) = (np.moveaxis(each, 1, 0) for each in (corners, corners + 0.5 * edges[long]))
            parts = [np.stack(part, axis=1) for part in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        corners, face = np.concatenate(parts), np.tile(face, len(parts))
    return np.concatenate([each for each, _ in done]), np.concatenate([number for _, number in done])
