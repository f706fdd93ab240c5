"""Which faces of the solids' surface a place of the grid is near: lists for cells, distances at nodes.

Cells and nodes are numbered alike, as `mpm.arrays.access.node_strides` numbers nodes: a cell by its lowest node.
Nothing is stored beyond a cut-off distance from the surface.

**Lists.** A point p of a cell with centre c and half diagonal h has d(c, F) - h <= d(p, F) <= d(c, F) + h from a face
F. So F can be the nearest one of a point at a distance of at most `cutoff` only where d(c, F) <= min(smallest + 2 h,
cutoff + h), `smallest` being the distance of c from its nearest face, and a segment of length `travel` that starts in
the cell can cut F only where d(c, F) <= h + travel.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.geometry.nearest import Search, feet, nearest
from datasets.geometry.surface import Surface
from datasets.scene import Domain
from mpm.arrays.layout import PADDING

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


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
    groups = np.flatnonzero(np.diff(cells, prepend=-1))
    smallest = np.minimum.reduceat(distance, groups) if len(groups) else distance
    smallest = np.repeat(smallest, np.diff(groups, append=len(cells)))
    slack = 1.0e-9 * cell
    kept = (distance <= np.minimum(smallest + 2.0 * half, cutoff * cell + half) + slack) | (
        distance <= half + travel * cell + slack
    )
    listed = np.bincount(cells[kept] + 1, minlength=int(np.prod(shape)) + 1)
    return Faces(
        first=np.cumsum(listed).astype(np.int32),
        faces=faces[kept].astype(np.int32),
        **nodes_near(domain, surface, np.unique(cells[kept]), cutoff * cell),
    )


def near_pairs(domain: Domain, surface: Surface, limit: float) -> tuple[Integers, Integers, Floats]:
    """Cells and faces whose centre lies within `limit` [m] of the face, and the distance of the centre [m], all [P];

    in the order of the cells, then of the faces.
    """
    shape = np.array(node_shape(domain))
    # Cells in the boxes around faces; the last node of an axis has no cell.
    low = np.floor((surface.corners.min(axis=1) - limit) / domain.cell - 0.5).astype(np.int64) + PADDING
    high = np.ceil((surface.corners.max(axis=1) + limit) / domain.cell - 0.5).astype(np.int64) + PADDING + 1
    around = np.zeros(shape, bool)
    for first, last in zip(np.maximum(low, 0), np.maximum(np.minimum(high, shape - 1), 0), strict=True):
        around[tuple(map(slice, first, last))] = True
    numbers = np.flatnonzero(around)
    centres = node_positions(domain, numbers) + 0.5 * domain.cell
    found: list[tuple[Integers, Integers, Floats]] = []
    for point, face in Search(surface).pairs(centres, np.full(len(centres), limit)):
        _, distance, _ = feet(surface.corners[face], centres[point])
        near = distance <= limit
        found.append((numbers[point[near]], face[near], distance[near]))
    none = np.zeros(0, np.int64)
    cells = np.concatenate([none, *(part[0] for part in found)])
    faces = np.concatenate([none, *(part[1] for part in found)])
    distance = np.concatenate([np.zeros(0), *(part[2] for part in found)])
    order = np.lexsort((faces, cells))
    return cells[order], faces[order], distance[order]


def nodes_near(domain: Domain, surface: Surface, nodes: Integers, cutoff: float) -> dict[str, Any]:
    """Distance, normal and friction at those of `nodes` within `cutoff` [m], by the names of `Faces`."""
    near = nearest(surface, node_positions(domain, nodes), cutoff)
    chosen = np.abs(near.distance) <= cutoff
    nodes, face, distance, normal = nodes[chosen], near.face[chosen], near.distance[chosen], near.normal[chosen]
    _, _, weights = feet(surface.corners[face], node_positions(domain, nodes))
    friction = surface.friction[face]
    stuck: NDArray[np.bool_] = np.asarray(np.isinf(friction).any(axis=1))
    return {
        "nodes": nodes,
        "distance": distance,
        "normal": normal,
        "face": face.astype(np.int32),
        "solid": surface.solid[face],
        "friction": np.where(stuck, np.inf, (weights * np.where(stuck[:, None], 0.0, friction)).sum(axis=1)),
    }
