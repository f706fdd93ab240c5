"""Solids in two dimensions: each as a ring of points, and the boundary of their union as segments."""

import itertools
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon
from shapely.geometry.polygon import orient

from datasets.errors import InputError
from datasets.geometry.ground import BEYOND, CLOSING, OUTSIDE, TOUCHING, ground_line
from datasets.scene import Domain, Solid

Floats = NDArray[np.float64]

STEEPEST = 4.0
"""Slope, sideways over outwards, with which a face that ends on a side of the box is continued beyond it at most."""


@dataclass(frozen=True, kw_only=True)
class Ring:
    """The outline of a solid."""

    points: Floats
    """Corners, anticlockwise [m], shape [V, 2]."""
    friction: Floats
    """Coulomb coefficient at each corner [-], shape [V]."""
    key: str
    """Where the solid stands in the scene, such as `solids[0]`."""

    def friction_at(self, positions: Floats) -> Floats:
        """The coefficient at the nearest place of the ring, linear along its edges, shape [N]."""
        after = np.roll(self.points, -1, axis=0)
        edges = shapely.STRtree(shapely.linestrings(np.stack([self.points, after], axis=1)))
        edge = edges.nearest(shapely.points(positions))
        start, along = self.points[edge], after[edge] - self.points[edge]
        share = np.clip(((positions - start) * along).sum(-1) / (along * along).sum(-1), 0.0, 1.0)
        return np.asarray((1.0 - share) * self.friction[edge] + share * np.roll(self.friction, -1)[edge])

    def distance(self, positions: Floats) -> Floats:
        """Distance [m] of places from the ring, shape [N]."""
        return np.asarray(shapely.distance(shapely.points(positions), shapely.linearrings(self.points)))


def turned(corners: Floats, centre: Floats, angle_deg: float) -> Floats:
    """Points of a plane turned about `centre` by an angle from the first axis to the second, shape [N, 2]."""
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    return np.asarray((corners - centre) @ np.array([[c, s], [-s, c]]) + centre)


def ring_of(solid: Solid, key: str, box: Domain) -> Ring:
    """The outline of `solid`, continued where it meets a side of the box. Raises InputError."""
    if solid.kind == "terrain":
        return ground_ring(solid, key, box)
    if solid.kind == "box":
        low, size = np.array(solid.lower), np.array(solid.size)
        points = low + np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * size
        if solid.turned_deg != 0.0:
            points = turned(points, low + 0.5 * size, solid.turned_deg)
    else:
        points = np.array(solid.vertices, dtype=np.float64)
        check_simple(points, f"{key}.vertices")
    friction = np.broadcast_to(np.asarray(solid.friction, np.float64), len(points)).copy()
    if not shapely.is_ccw(shapely.linearrings(points)):
        points, friction = points[::-1].copy(), friction[::-1].copy()
    ring = Ring(points=points, friction=friction, key=key)
    for axis, side in itertools.product((0, 1), (0, 1)):
        ring = continued(ring, axis, side, box)
    return ring


def check_simple(points: Floats, key: str) -> None:
    """Raise InputError unless `points` are the corners of a polygon that does not cross or touch itself."""
    after = np.roll(points, -1, axis=0)
    twice = np.flatnonzero((points == after).all(axis=1))
    if len(twice):
        where = (int(twice[0]) + 1) % len(points)
        raise InputError(
            f"expected different vertices, got {points[where].tolist()} twice (the last joins the first by itself)",
            key=f"{key}[{where}]",
        )
    polygon = Polygon(points)
    if not polygon.is_valid:
        reason = shapely.is_valid_reason(polygon)
        position = reason[reason.find("[") + 1 : reason.find("]")].replace(" ", ", ") if "[" in reason else ""
        raise InputError(
            f"expected a polygon that does not cross itself, it does at ({position})"
            if position
            else "expected a polygon",
            key=key,
        )


def ground_ring(solid: Solid, key: str, box: Domain) -> Ring:
    """All that lies below a ground line, some cells beyond the box: it goes on level, or straight from a side."""
    points, friction = ground_line(solid, key, box)
    beyond = BEYOND * box.cell
    deep = min(-beyond, float(points[:, 1].min()) - beyond)
    under = np.array([[points[-1, 0], deep], [points[0, 0], deep]])
    # The line runs towards +x with the solid on its right: from its end back to its start is anticlockwise.
    return Ring(
        points=np.concatenate([points[::-1], under[::-1]]),
        friction=np.concatenate([friction[::-1], friction[[0, -1]]]),
        key=key,
    )


def continued(ring: Ring, axis: int, side: int, box: Domain) -> Ring:
    """The ring cut off at a side of the box (0 or 1 of `axis`) and continued beyond, where it reaches the side.

    What lies on the side is moved outwards, along the two faces that end there.
    """
    limit, out = (box.size[axis], 1.0) if side else (0.0, -1.0)
    height = out * (ring.points[:, axis] - limit)
    if height.max() < -TOUCHING:
        return ring
    beyond, across = BEYOND * box.cell, 1 - axis
    points, friction = cut(ring, axis, limit, out)
    on_side = np.abs(points[:, axis] - limit) <= TOUCHING
    # Of several edges in a row on the side only the two outermost ends are continued.
    kept = ~(on_side & np.roll(on_side, 1) & np.roll(on_side, -1))
    points, friction, on_side = points[kept], friction[kept], on_side[kept]
    new_points, new_friction = [], []
    count = len(points)
    for index in range(count):
        following = (index + 1) % count
        new_points.append(points[index])
        new_friction.append(friction[index])
        if not (on_side[index] and on_side[following]):
            continue
        moved = []
        for end, inner in ((index, index - 1), (following, (following + 1) % count)):
            rise = out * (points[end, axis] - points[inner, axis])
            shift = (points[end, across] - points[inner, across]) / rise if rise > TOUCHING else 0.0
            position = points[end].copy()
            position[axis] = limit + out * beyond
            position[across] += beyond * float(np.clip(shift, -STEEPEST, STEEPEST))
            moved.append(position)
        width = points[following, across] - points[index, across]
        if (moved[1][across] - moved[0][across]) * np.sign(width) < 0.1 * abs(width):
            for position, end in zip(moved, (index, following), strict=True):
                position[across] = points[end, across]
        new_points += moved
        new_friction += [friction[index], friction[following]]
    return replace(ring, points=np.array(new_points), friction=np.array(new_friction))


def cut(ring: Ring, axis: int, limit: float, out: float) -> tuple[Floats, Floats]:
    """Points [V, 2] and friction [V] of the part of the ring within a side of the box."""
    points = ring.points.copy()
    near = np.abs(points[:, axis] - limit) <= TOUCHING
    points[near, axis] = limit
    if (out * (points[:, axis] - limit) <= 0.0).all():
        return points, ring.friction
    low, high = points.min(axis=0) - 1.0, points.max(axis=0) + 1.0
    (low if out < 0.0 else high)[axis] = limit
    inside = Polygon(points).intersection(shapely.box(*low, *high))
    parts = [part for part in getattr(inside, "geoms", [inside]) if isinstance(part, Polygon) and part.area > 0.0]
    if not parts:
        raise InputError(OUTSIDE, key=ring.key)
    if len(parts) > 1:
        raise InputError("expected a solid of which one piece lies in the box", key=ring.key)
    kept = np.array(orient(parts[0]).exterior.coords)[:-1]
    snapped = np.abs(kept[:, axis] - limit) <= TOUCHING
    kept[snapped, axis] = limit
    return kept, ring.friction_at(kept)


def boundary(rings: list[Ring], box: Domain) -> dict[str, NDArray[Any]]:
    """The boundary of the union of `rings` as segments, the solid on the left; touching rings are one.

    The arrays of `datasets.geometry.surface.Surface` by their names, but for contact without slip and adhesion.
    """
    if len(rings) == 1:
        (ring,) = rings
        corners, corner_normals = with_normals(ring.points)
        friction = np.stack([ring.friction, np.roll(ring.friction, -1)], axis=1)
        return segments(corners, corner_normals, np.zeros(len(corners), np.int32), friction)
    # Closing by a distance far below what matters merges rings that touch but for rounding.
    gap = CLOSING * box.cell
    grown = [Polygon(ring.points).buffer(gap, join_style="mitre", mitre_limit=50.0) for ring in rings]
    closed = shapely.union_all(grown).buffer(-gap, join_style="mitre", mitre_limit=50.0)
    loops = []
    for part in getattr(closed, "geoms", [closed]):
        part = orient(part)
        loops += [merged(np.array(loop.coords)[:-1], 10.0 * gap) for loop in (part.exterior, *part.interiors)]
    known = np.concatenate([ring.points for ring in rings])
    parts = [with_normals(split(loop, known, 10.0 * gap)) for loop in loops if len(loop) >= 3]
    corners, corner_normals = (np.concatenate(part) for part in zip(*parts, strict=True))
    middle = corners.mean(axis=1)
    distance = np.stack([ring.distance(middle) for ring in rings])
    # Faces that coincide go to the first of their solids.
    owner = np.argmax(distance <= distance.min(axis=0) + 10.0 * gap, axis=0).astype(np.int32)
    friction = np.zeros((len(corners), 2))
    for number, ring in enumerate(rings):
        mine = owner == number
        if mine.any():
            friction[mine] = ring.friction_at(corners[mine].reshape(-1, 2)).reshape(-1, 2)
    return segments(corners, corner_normals, owner, friction)


def segments(corners: Floats, corner_normals: Floats, owner: NDArray[np.int32], friction: Floats) -> dict[str, Any]:
    """The arrays of a boundary, with the normals of its segments; only triangles have others at their edges."""
    along = corners[:, 1] - corners[:, 0]
    normals = unit(np.stack([along[:, 1], -along[:, 0]], axis=1))
    return {
        "corners": corners,
        "normals": normals,
        "corner_normals": corner_normals,
        "edge_normals": np.zeros((len(corners), 0, 2)),
        "solid": owner,
        "friction": friction,
    }


def with_normals(loop: Floats) -> tuple[Floats, Floats]:
    """The segments of a loop [V, 2] and the pseudonormals at their ends, both of shape [V, 2, 2]."""
    corners = np.stack([loop, np.roll(loop, -1, axis=0)], axis=1)
    along = corners[:, 1] - corners[:, 0]
    normals = unit(np.stack([along[:, 1], -along[:, 0]], axis=1))
    mean = unit(normals + np.roll(normals, 1, axis=0))
    return corners, np.stack([mean, np.roll(mean, -1, axis=0)], axis=1)


def merged(loop: Floats, closest: float) -> Floats:
    """A loop without points that are closer than `closest` to the one before, shape [V, 2]."""
    kept = np.linalg.norm(loop - np.roll(loop, 1, axis=0), axis=1) > closest
    return np.asarray(loop[kept])


def split(loop: Floats, known: Floats, tolerance: float) -> Floats:
    """A loop with the `known` corners that lie on its edges as points of its own: friction may change there."""
    start, along = loop, np.roll(loop, -1, axis=0) - loop
    length = np.linalg.norm(along, axis=1)
    edges = shapely.STRtree(shapely.linestrings(np.stack([loop, np.roll(loop, -1, axis=0)], axis=1)))
    corner, edge = edges.query(shapely.points(known), predicate="dwithin", distance=tolerance)
    position = ((known[corner] - start[edge]) * along[edge]).sum(-1) / length[edge]
    inner = (position > tolerance) & (position < length[edge] - tolerance)
    edge, position = (
        np.concatenate([np.arange(len(loop)), edge[inner]]),
        np.concatenate([0.0 * length, position[inner]]),
    )
    order = np.lexsort((position, edge))
    edge, position = edge[order], position[order]
    new = (np.diff(edge, prepend=-1) > 0) | (np.diff(position, prepend=-1.0) > tolerance)
    edge, position = edge[new], position[new]
    return np.asarray(start[edge] + (position / length[edge])[:, None] * along[edge])


def unit(vectors: Floats) -> Floats:
    """Vectors of length 1; those of length 0 stay."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0.0, length, 1.0))
