"""Closed surfaces in two dimensions, rings of segments, by shapely: cut at the box, continued beyond, united."""

from dataclasses import replace

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from shapely.geometry import Polygon
from shapely.geometry.polygon import orient

from datasets.errors import InputError, require
from datasets.geometry.closed import NEARLY, POINTED, STEEPEST, Body, meet, outside_of_box, ring, snapped
from datasets.geometry.ground import TOUCHING, Floats, Integers


def check_simple(points: Floats, key: str) -> None:
    """Raise InputError unless `points` are the corners of a polygon that does not cross or touch itself."""
    twice = np.flatnonzero((points == np.roll(points, -1, axis=0)).all(axis=1))
    for where in (twice[:1] + 1) % len(points):
        got = f"{points[where].tolist()} twice (the last joins the first by itself)"
        raise InputError(f"expected different vertices, got {got}", key=f"{key}[{where}]")
    polygon = Polygon(points)
    reason = shapely.is_valid_reason(polygon)
    require(polygon.is_valid, key, "a polygon that does not cross or touch itself", f"one with {reason}")


def cut_ring(body: Body, axis: int, limit: float, out: float) -> Body:
    """The part of a ring within a side of the box. Raises InputError unless it is one piece."""
    low, high = body.vertices.min(axis=0) - 1.0, body.vertices.max(axis=0) + 1.0
    (low if out < 0.0 else high)[axis] = limit
    inside = Polygon(body.vertices).intersection(shapely.box(*low, *high))
    parts = [part for part in getattr(inside, "geoms", [inside]) if isinstance(part, Polygon) and part.area > 0.0]
    if not parts:
        raise outside_of_box(body)
    require(len(parts) == 1, body.key, "a solid of which one piece lies in the box")
    kept = snapped(np.array(orient(parts[0]).exterior.coords)[:-1], axis, limit)
    return replace(body, vertices=kept, faces=ring(len(kept)), friction=friction_at(body, kept))


def lengthened_ring(body: Body, axis: int, limit: float, beyond: float) -> Body:
    """A ring whose edges on a side of the box are moved outwards, `beyond` it [m], along the faces that end there."""
    points, friction, out, across = body.vertices, body.friction, np.sign(beyond), 1 - axis
    on_side = points[:, axis] == limit
    # If several edges in a row lie on the side, only the two outermost ends are continued.
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
    moved[..., axis] = limit + beyond
    moved[..., across] += abs(beyond) * np.clip(shift, -STEEPEST, STEEPEST)
    width = points[last, across] - points[first, across]
    crossed = (moved[1, :, across] - moved[0, :, across]) * np.sign(width) < 0.1 * np.abs(width)
    moved[:, crossed, across] = points[ends][:, crossed, across]
    places = np.repeat(first + 1, 2)
    points = np.insert(points, places, moved.swapaxes(0, 1).reshape(-1, 2), axis=0)
    friction = np.insert(friction, places, friction[ends].T.ravel())
    return replace(body, vertices=points, faces=ring(len(points)), friction=friction)


def union_of_rings(bodies: list[Body], gap: float) -> tuple[Floats, Integers, Floats, NDArray[np.int32]]:
    """Vertices [V, 2] and segments [F, 2] of the union, friction at their ends [F, 2] and the body of each [F]. Closing
    by a negligible distance merges rings that touch to within rounding."""
    grown = [Polygon(body.vertices).buffer(gap, join_style="mitre", mitre_limit=50.0) for body in bodies]
    closed = shapely.union_all(grown).buffer(-gap, join_style="mitre", mitre_limit=50.0)
    loops = []
    for part in map(orient, getattr(closed, "geoms", [closed])):
        loops += [np.array(loop.coords)[:-1] for loop in (part.exterior, *part.interiors)]
    # Drop points within rounding of the previous one.
    loops = [loop[np.linalg.norm(loop - np.roll(loop, 1, axis=0), axis=1) > 10.0 * gap] for loop in loops]
    corners = np.concatenate([body.vertices for body in bodies])
    loops = [split(loop, corners, 10.0 * gap) for loop in loops if len(loop) >= 3]
    firsts = np.cumsum([0, *map(len, loops)])
    vertices = np.concatenate(loops)
    faces = np.concatenate([first + ring(len(loop)) for first, loop in zip(firsts, loops, strict=False)])
    middle = shapely.points(vertices[faces].mean(axis=1))
    distance = np.stack([shapely.distance(middle, shapely.linearrings(body.vertices)) for body in bodies])
    # Faces that coincide go to the first of their solids.
    owner = np.argmax(distance <= distance.min(axis=0) + 10.0 * gap, axis=0).astype(np.int32)
    check_corners(vertices, owner, bodies, gap)
    check_near_corners(bodies, NEARLY * gap)
    friction = np.zeros(faces.shape)
    for number, body in enumerate(bodies):
        mine = faces[owner == number]
        if len(mine):
            friction[owner == number] = friction_at(body, vertices[mine].reshape(-1, 2)).reshape(-1, 2)
    return vertices, faces, friction, owner


def check_corners(vertices: Floats, owner: NDArray[np.int32], bodies: list[Body], gap: float) -> None:
    """Raise InputError if solids in 2D meet only in a point, unless `gap` [m] on either side closes it. At such a point
    the boundary of their union has two corners in one place [m], [V, 2]; owner: the solid of each, [V]."""
    pairs = cKDTree(vertices).query_pairs(100.0 * gap, output_type="ndarray")
    for first, second in sorted({(min(pair), max(pair)) for pair in owner[pairs].tolist()}):
        one, other = (Polygon(bodies[number].vertices) for number in (first, second))
        if first == second or one.distance(other) > 2.0 * gap:
            continue
        # Two corners are also near each other where an edge that is shared ends with a step as small as this.
        if one.boundary.intersection(other.buffer(2.0 * gap)).length <= 1.0e3 * gap:
            raise meet(bodies[first].key, bodies[second].key, "an edge", "in a point")


def check_near_corners(bodies: list[Body], near: float) -> None:
    """Raise InputError if solids in 2D come within `near` [m] only in a point, as rounded corners do: the boundary of
    one is close to the other over less than `POINTED` times that, unless a third covers it."""
    shapes = [Polygon(body.vertices) for body in bodies]
    pairs = shapely.STRtree(shapes).query(shapes, predicate="dwithin", distance=near)
    for first, second in pairs.T[pairs[0] < pairs[1]].tolist():
        one, other = shapes[first], shapes[second]
        apart = one.distance(other)
        beside = other.buffer(apart + 0.5 * near)
        if apart == 0.0 or one.boundary.intersection(beside).length > POINTED * near:
            continue
        between = shapely.shortest_line(one, other).centroid
        thirds = (shape for number, shape in enumerate(shapes) if number not in (first, second))
        if not any(third.intersects(between) for third in thirds):
            raise meet(bodies[first].key, bodies[second].key, "an edge", f"in a point but for {apart:.2g} m")


def friction_at(body: Body, positions: Floats) -> Floats:
    """The coefficient at the nearest place of a ring, linear along its edges, shape [N]."""
    edges, places = shapely.linestrings(body.vertices[body.faces]), shapely.points(positions)
    edge = shapely.STRtree(edges).nearest(places)
    share = shapely.line_locate_point(edges[edge], places, normalized=True)
    first, last = body.friction[body.faces[edge]].T
    return np.asarray((1.0 - share) * first + share * last)


def split(loop: Floats, known: Floats, tolerance: float) -> Floats:
    """A loop with the `known` corners that lie on its edges inserted as points, because friction may change there."""
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
