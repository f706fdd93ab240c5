"""Solids in two dimensions by shapely: rings of points, what of them goes on beyond the box, their union."""

from dataclasses import replace

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon
from shapely.geometry.polygon import orient

from datasets.errors import InputError
from datasets.geometry.closed import Body, Integers, ring
from datasets.geometry.ground import BEYOND, OUTSIDE, TOUCHING, ground_grid
from datasets.scene import Domain, Solid

Floats = NDArray[np.float64]

STEEPEST = 4.0
"""Slope, sideways over outwards, with which a face that ends on a side of the box is continued beyond it at most."""


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
        raise InputError(f"expected a polygon that does not cross or touch itself, got one with {reason}", key=key)


def ground_body(solid: Solid, key: str, box: Domain) -> Body:
    """All that lies below a ground line, some cells beyond the box: it goes on level, or straight from a side."""
    (x,), heights, friction = ground_grid(solid, key, box)
    points, beyond = np.stack([x, heights], axis=1), BEYOND * box.cell
    deep = min(-beyond, float(heights.min()) - beyond)
    under = np.array([[x[-1], deep], [x[0], deep]])
    # The line runs towards +x with the solid on its right: from its end back to its start is anticlockwise.
    return Body(
        vertices=np.concatenate([points[::-1], under[::-1]]),
        faces=ring(len(points) + 2),
        friction=np.concatenate([friction[::-1], friction[[0, -1]]]),
        key=key,
    )


def continued(body: Body, axis: int, side: int, box: Domain) -> Body:
    """The ring cut off at a side of the box (0 or 1 of `axis`) and continued beyond, where it reaches the side.

    What lies on the side is moved outwards, along the two faces that end there.
    """
    limit, out = (box.size[axis], 1.0) if side else (0.0, -1.0)
    height = out * (body.vertices[:, axis] - limit)
    if height.max() < -TOUCHING:
        return body
    beyond, across = BEYOND * box.cell, 1 - axis
    points, friction = cut(body, axis, limit, out)
    on_side = np.abs(points[:, axis] - limit) <= TOUCHING
    # Of several edges in a row on the side only the two outermost ends are continued.
    kept = ~(on_side & np.roll(on_side, 1) & np.roll(on_side, -1))
    points, friction, on_side = points[kept], friction[kept], on_side[kept]
    count = len(points)
    first = np.flatnonzero(on_side & np.roll(on_side, -1))
    last = (first + 1) % count
    ends, inner = np.stack([first, last]), np.stack([first - 1, (last + 1) % count])
    along = points[ends] - points[inner]
    rise = out * along[..., axis]
    shift = np.divide(along[..., across], rise, out=np.zeros_like(rise), where=rise > TOUCHING)
    moved = points[ends]
    moved[..., axis] = limit + out * beyond
    moved[..., across] += beyond * np.clip(shift, -STEEPEST, STEEPEST)
    width = points[last, across] - points[first, across]
    crossed = (moved[1, :, across] - moved[0, :, across]) * np.sign(width) < 0.1 * np.abs(width)
    moved[:, crossed, across] = points[ends][:, crossed, across]
    places = np.repeat(first + 1, 2)
    points = np.insert(points, places, moved.swapaxes(0, 1).reshape(-1, 2), axis=0)
    friction = np.insert(friction, places, friction[ends].T.ravel())
    return replace(body, vertices=points, faces=ring(len(points)), friction=friction)


def cut(body: Body, axis: int, limit: float, out: float) -> tuple[Floats, Floats]:
    """Points [V, 2] and friction [V] of the part of the ring within a side of the box."""
    points = body.vertices.copy()
    points[np.abs(points[:, axis] - limit) <= TOUCHING, axis] = limit
    if (out * (points[:, axis] - limit) <= 0.0).all():
        return points, body.friction
    low, high = points.min(axis=0) - 1.0, points.max(axis=0) + 1.0
    (low if out < 0.0 else high)[axis] = limit
    inside = Polygon(points).intersection(shapely.box(*low, *high))
    parts = [part for part in getattr(inside, "geoms", [inside]) if isinstance(part, Polygon) and part.area > 0.0]
    if not parts:
        raise InputError(OUTSIDE, key=body.key)
    if len(parts) > 1:
        raise InputError("expected a solid of which one piece lies in the box", key=body.key)
    kept = np.array(orient(parts[0]).exterior.coords)[:-1]
    kept[np.abs(kept[:, axis] - limit) <= TOUCHING, axis] = limit
    return kept, friction_at(body, kept)


def union(bodies: list[Body], gap: float) -> tuple[Floats, Integers, Floats, NDArray[np.int32]]:
    """Vertices [V, 2] and segments [F, 2] of the union, friction at their ends [F, 2] and the body of each [F].

    Closing by a distance far below what matters merges rings that touch but for rounding.
    """
    grown = [Polygon(body.vertices).buffer(gap, join_style="mitre", mitre_limit=50.0) for body in bodies]
    closed = shapely.union_all(grown).buffer(-gap, join_style="mitre", mitre_limit=50.0)
    loops = []
    for part in map(orient, getattr(closed, "geoms", [closed])):
        loops += [np.array(loop.coords)[:-1] for loop in (part.exterior, *part.interiors)]
    # Without points that are closer than rounding to the one before.
    loops = [loop[np.linalg.norm(loop - np.roll(loop, 1, axis=0), axis=1) > 10.0 * gap] for loop in loops]
    known = np.concatenate([body.vertices for body in bodies])
    loops = [split(loop, known, 10.0 * gap) for loop in loops if len(loop) >= 3]
    firsts = np.cumsum([0, *map(len, loops)])
    vertices = np.concatenate(loops)
    faces = np.concatenate([first + ring(len(loop)) for first, loop in zip(firsts, loops, strict=False)])
    middle = shapely.points(vertices[faces].mean(axis=1))
    distance = np.stack([shapely.distance(middle, shapely.linearrings(body.vertices)) for body in bodies])
    # Faces that coincide go to the first of their solids.
    owner = np.argmax(distance <= distance.min(axis=0) + 10.0 * gap, axis=0).astype(np.int32)
    friction = np.zeros(faces.shape)
    for number, body in enumerate(bodies):
        mine = faces[owner == number]
        if len(mine):
            friction[owner == number] = friction_at(body, vertices[mine].reshape(-1, 2)).reshape(-1, 2)
    return vertices, faces, friction, owner


def friction_at(body: Body, positions: Floats) -> Floats:
    """The coefficient at the nearest place of a ring, linear along its edges, shape [N]."""
    corners, friction = body.vertices[body.faces], body.friction[body.faces]
    edge = shapely.STRtree(shapely.linestrings(corners)).nearest(shapely.points(positions))
    start, along = corners[edge, 0], corners[edge, 1] - corners[edge, 0]
    share = np.clip(((positions - start) * along).sum(-1) / (along * along).sum(-1), 0.0, 1.0)
    return np.asarray((1.0 - share) * friction[edge, 0] + share * friction[edge, 1])


def split(loop: Floats, known: Floats, tolerance: float) -> Floats:
    """A loop with the `known` corners that lie on its edges as points of its own: friction may change there."""
    start, along = loop, np.roll(loop, -1, axis=0) - loop
    length = np.linalg.norm(along, axis=1)
    edges = shapely.STRtree(shapely.linestrings(np.stack([loop, np.roll(loop, -1, axis=0)], axis=1)))
    corner, edge = edges.query(shapely.points(known), predicate="dwithin", distance=tolerance)
    position = ((known[corner] - start[edge]) * along[edge]).sum(-1) / length[edge]
    inner = (position > tolerance) & (position < length[edge] - tolerance)
    edge, position = np.append(np.arange(len(loop)), edge[inner]), np.append(0.0 * length, position[inner])
    order = np.lexsort((position, edge))
    edge, position = edge[order], position[order]
    new = (np.diff(edge, prepend=-1) > 0) | (np.diff(position, prepend=-1.0) > tolerance)
    edge, position = edge[new], position[new]
    return np.asarray(start[edge] + (position / length[edge])[:, None] * along[edge])
