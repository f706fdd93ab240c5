"""Closed surfaces in two and in three dimensions: rings of segments by shapely, triangles by manifold3d.

Their normals, what of them goes on beyond the box, their union.
"""

import warnings
from dataclasses import dataclass, replace

import manifold3d
import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon
from shapely.geometry.polygon import orient

from datasets.errors import InputError, require
from datasets.geometry.ground import BEYOND, TOUCHING, Floats, Integers, grid_triangles, ground_grid
from datasets.geometry.joints import check_corners, check_lines
from datasets.scene import Domain, Solid

OUTSIDE = "expected a solid that reaches into the domain, this one lies outside of it"
STEEPEST = 4.0
"""Slope, sideways over outwards, with which a face that ends on a side of the box is continued beyond it at most."""
SHARED = 1.0e-6
"""Share of a volume that rounding may change."""
FLAT = 1.0e-6
"""What makes the place of a vertex between faces of one plane unique [-]."""


@dataclass(frozen=True, kw_only=True)
class Body:
    """The surface of a solid, closed; V vertices and F faces in D dimensions."""

    vertices: Floats
    """[m], shape [V, D]; in 2D one after the other, anticlockwise."""
    faces: Integers
    """Vertices of each segment, the solid on its left, or triangle, anticlockwise from outside, shape [F, D]."""
    friction: Floats
    """Coulomb coefficient at each vertex [-], shape [V]."""
    key: str
    """Where the solid stands in the scene, such as `solids[0]`."""


def ring(count: int) -> Integers:
    """Segments from each of `count` vertices to the next, the last to the first, shape [count, 2]."""
    return np.stack([np.arange(count), np.roll(np.arange(count), -1)], axis=1)


def unit(vectors: Floats) -> Floats:
    """Vectors of length 1; those of length 0 stay."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0.0, length, 1.0))


def pseudonormals(vertices: Floats, faces: Integers) -> tuple[Floats, Floats, Floats]:
    """Unit normals of faces [F, D], 0 of one without area; of their corners [F, D, D]; of triangles' edges [F, 3, D].

    A corner's is the sum of the normals around its vertex, in 3D weighted by their angles there, an edge's that of its
    two (Baerentzen & Aanaes 2005). Segments have no edges: [F, 0, 2].
    """
    corners = vertices[faces]
    edges = np.roll(corners, -1, axis=1) - corners
    angles = np.ones(faces.shape)
    if faces.shape[1] == 2:
        normals = unit(edges[:, 0, ::-1] * [1.0, -1.0])
    else:
        across = np.cross(edges[:, 0], edges[:, 1])
        longest = (edges * edges).sum(-1).max(axis=1)
        across[np.linalg.norm(across, axis=1) <= 1.0e-14 * longest] = 0.0
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


def check_simple(points: Floats, key: str) -> None:
    """Raise InputError unless `points` are the corners of a polygon that does not cross or touch itself."""
    twice = np.flatnonzero((points == np.roll(points, -1, axis=0)).all(axis=1))
    if len(twice):
        where = (int(twice[0]) + 1) % len(points)
        got = f"{points[where].tolist()} twice (the last joins the first by itself)"
        raise InputError(f"expected different vertices, got {got}", key=f"{key}[{where}]")
    polygon = Polygon(points)
    reason = shapely.is_valid_reason(polygon)
    require(polygon.is_valid, key, "a polygon that does not cross or touch itself", f"one with {reason}")


def outward(vertices: Floats, triangles: Integers, key: str) -> tuple[Floats, Integers]:
    """Vertices [V, 3] and triangles [T, 3] of a closed surface, turned to face outwards, its shells united.

    A shell that faces inwards within others is a cavity. What shells share counts once, which a warning says. Raises
    InputError where the surface is open.
    """
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    _, number = np.unique(edges, axis=0, return_counts=True)
    opened, odd = int((number == 1).sum()), int((number % 2 == 1).sum())
    fault = f"{opened} open edges" if opened else f"{odd} edges of three or more triangles"
    require(opened == odd == 0, key, "a closed surface", f"one with {fault}")
    body = manifold(vertices, triangles)
    if body.status() != manifold3d.Error.NoError:
        raise InputError("expected a closed surface whose triangles all face the same way", key=key)
    if body.volume() < 0.0:
        triangles = triangles[:, ::-1].copy()
        body = manifold(vertices, triangles)
    require(body.volume() > 0.0, key, "a surface that encloses a volume", "one that does not")
    shells = sorted(body.decompose(), key=lambda shell: -abs(shell.volume()))
    if len(shells) == 1:
        return vertices, triangles
    united = manifold3d.Manifold()
    for shell in shells:
        if shell.volume() > 0.0:
            united = united + shell
            continue
        mesh = shell.to_mesh64()
        turned = manifold(np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts)[:, ::-1])
        buried = (united ^ turned).volume() > (1.0 - SHARED) * turned.volume()
        united = united - turned if buried else united + turned
    if abs(united.volume() - body.volume()) <= SHARED * united.volume():
        return vertices, triangles
    volumes = f"{united.volume():.6g} m^3 in place of {body.volume():.6g}"
    prefix = f"{key}: " if key else ""
    warnings.warn(f"{prefix}the shells of the mesh are united, which makes {volumes}", stacklevel=2)
    mesh = united.to_mesh64()
    return np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, np.int64)


def ground_body(solid: Solid, key: str, box: Domain) -> Body:
    """All that lies below a terrain, some cells beyond the box; it goes on level, or straight from a side."""
    axes, heights, friction = ground_grid(solid, key, box)
    deep = min(0.0, float(heights.min())) - BEYOND * box.cell
    if len(axes) == 1:
        x, points = axes[0], np.stack([axes[0], heights], axis=1)
        under = np.array([[x[-1], deep], [x[0], deep]])
        # The line runs towards +x with the solid on its right: from its end back to its start is anticlockwise.
        return Body(
            vertices=np.concatenate([points[::-1], under[::-1]]),
            faces=ring(len(points) + 2),
            friction=np.concatenate([friction[::-1], friction[[0, -1]]]),
            key=key,
        )
    x, z = axes
    plan = np.stack(np.meshgrid(x, z, indexing="ij"), axis=-1)
    top = np.stack([plan[..., 0], heights, plan[..., 1]], axis=-1).reshape(-1, 3)
    number = np.arange(len(top)).reshape(len(x), len(z))
    # Around the edge once, then down to a floor far below that fans from one corner.
    rim = np.concatenate([number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]])
    below = len(top) + np.arange(len(rim))
    after, below_after = np.roll(rim, -1), np.roll(below, -1)
    bottom = top[rim] * [1.0, 0.0, 1.0] + [0.0, deep, 0.0]
    floor = np.stack([below, below_after, np.full(len(rim), len(top) + len(rim))], axis=1)
    centre = np.array([[0.5 * (x[0] + x[-1]), deep, 0.5 * (z[0] + z[-1])]])
    skirt = np.concatenate([np.stack([rim, after, below], axis=1), np.stack([after, below_after, below], axis=1)])
    return Body(
        vertices=np.concatenate([top, bottom, centre]),
        faces=np.concatenate([grid_triangles(heights), skirt, floor]),
        friction=np.concatenate([friction.ravel(), friction.ravel()[rim], [float(friction.mean())]]),
        key=key,
    )


def continued(body: Body, axis: int, side: int, box: Domain) -> Body:
    """The body cut off at a side of the box (0 or 1 of `axis`) and continued beyond, where it reaches the side.

    Raises InputError where nothing of it lies in the box.
    """
    limit, out = (box.size[axis], 1.0) if side else (0.0, -1.0)
    within = replace(body, vertices=snapped(body.vertices, axis, limit))
    height = out * (within.vertices[:, axis] - limit)
    if height.max() < 0.0:
        return body
    planar = box.dimension == 2
    if height.max() > 0.0:
        within = (cut_ring if planar else cut_surface)(within, axis, limit, out)
        within = replace(within, vertices=snapped(within.vertices, axis, limit))
    lengthened = (lengthened_ring if planar else lengthened_surface)(within, axis, limit, out * BEYOND * box.cell)
    return lengthened or body


def snapped(vertices: Floats, axis: int, limit: float) -> Floats:
    """Vertices [V, D], those that all but lie on a side of the box on it."""
    found = vertices.copy()
    found[np.abs(found[:, axis] - limit) <= TOUCHING, axis] = limit
    return found


def cut_ring(body: Body, axis: int, limit: float, out: float) -> Body:
    """The part of a ring within a side of the box. Raises InputError unless it is one piece."""
    low, high = body.vertices.min(axis=0) - 1.0, body.vertices.max(axis=0) + 1.0
    (low if out < 0.0 else high)[axis] = limit
    inside = Polygon(body.vertices).intersection(shapely.box(*low, *high))
    parts = [part for part in getattr(inside, "geoms", [inside]) if isinstance(part, Polygon) and part.area > 0.0]
    if not parts:
        raise InputError(OUTSIDE, key=body.key)
    if len(parts) > 1:
        raise InputError("expected a solid of which one piece lies in the box", key=body.key)
    kept = snapped(np.array(orient(parts[0]).exterior.coords)[:-1], axis, limit)
    return replace(body, vertices=kept, faces=ring(len(kept)), friction=friction_at(body, kept))


def cut_surface(body: Body, axis: int, limit: float, out: float) -> Body:
    """The part of triangles within a side of the box. Raises InputError where there is none."""
    inward = tuple((-out * np.eye(3)[axis]).tolist())
    part = manifold(body.vertices, body.faces).trim_by_plane(inward, -out * limit)
    if part.is_empty():
        raise InputError(OUTSIDE, key=body.key)
    mesh = part.to_mesh64()
    vertices, triangles = np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, np.int64)
    return replace(body, vertices=vertices, faces=triangles, friction=np.full(len(vertices), body.friction[0]))


def lengthened_ring(body: Body, axis: int, limit: float, beyond: float) -> Body:
    """A ring whose edges on a side of the box are moved outwards, `beyond` it [m], along the faces that end there."""
    points, friction, out, across = body.vertices, body.friction, np.sign(beyond), 1 - axis
    on_side = points[:, axis] == limit
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
    moved[..., axis] = limit + beyond
    moved[..., across] += abs(beyond) * np.clip(shift, -STEEPEST, STEEPEST)
    width = points[last, across] - points[first, across]
    crossed = (moved[1, :, across] - moved[0, :, across]) * np.sign(width) < 0.1 * np.abs(width)
    moved[:, crossed, across] = points[ends][:, crossed, across]
    places = np.repeat(first + 1, 2)
    points = np.insert(points, places, moved.swapaxes(0, 1).reshape(-1, 2), axis=0)
    friction = np.insert(friction, places, friction[ends].T.ravel())
    return replace(body, vertices=points, faces=ring(len(points)), friction=friction)


def lengthened_surface(body: Body, axis: int, limit: float, beyond: float) -> Body | None:
    """Triangles whose faces on a side of the box are moved outwards, `beyond` it [m]; None where none lies there."""
    vertices, triangles, friction = body.vertices, body.faces, body.friction
    on_side = (vertices[triangles][..., axis] == limit).all(axis=1)
    if not on_side.any():
        return None
    lid = triangles[on_side]
    used, renamed = np.unique(lid, return_inverse=True)
    renamed = renamed.reshape(-1, 3) + len(vertices)
    moved = vertices[used]
    moved[:, axis] = limit + beyond
    edges = np.stack([lid, np.roll(lid, -1, axis=1)], axis=-1).reshape(-1, 2)
    ends = np.stack([renamed, np.roll(renamed, -1, axis=1)], axis=-1).reshape(-1, 2)
    known = {tuple(edge) for edge in edges.tolist()}
    rim = np.array([(b, a) not in known for a, b in edges.tolist()])
    (a, b), (c, d) = edges[rim].T, ends[rim].T
    skirt = np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])
    return Body(
        vertices=np.concatenate([vertices, moved]),
        faces=np.concatenate([triangles[~on_side], renamed, skirt]),
        friction=np.concatenate([friction, friction[used]]),
        key=body.key,
    )


def manifold(vertices: Floats, triangles: Integers, friction: Floats | None = None) -> manifold3d.Manifold:
    """A closed surface as the library takes it, with the friction of its vertices where given."""
    values = vertices if friction is None else np.column_stack([vertices, friction])
    mesh = manifold3d.Mesh64(np.ascontiguousarray(values), np.ascontiguousarray(triangles, np.uint64))
    return manifold3d.Manifold(mesh)


def union_of_rings(bodies: list[Body], gap: float) -> tuple[Floats, Integers, Floats, NDArray[np.int32]]:
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
    check_corners(vertices, owner, [body.key for body in bodies], 100.0 * gap)
    friction = np.zeros(faces.shape)
    for number, body in enumerate(bodies):
        mine = faces[owner == number]
        if len(mine):
            friction[owner == number] = friction_at(body, vertices[mine].reshape(-1, 2)).reshape(-1, 2)
    return vertices, faces, friction, owner


def friction_at(body: Body, positions: Floats) -> Floats:
    """The coefficient at the nearest place of a ring, linear along its edges, shape [N]."""
    edges, places = shapely.linestrings(body.vertices[body.faces]), shapely.points(positions)
    edge = shapely.STRtree(edges).nearest(places)
    share = shapely.line_locate_point(edges[edge], places, normalized=True)
    first, last = body.friction[body.faces[edge]].T
    return np.asarray((1.0 - share) * first + share * last)


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


def union_of_surfaces(bodies: list[Body], gap: float) -> tuple[Floats, Integers, Floats, NDArray[np.int32]]:
    """Vertices [V, 3] and triangles [F, 3] of the union, friction at their corners [F, 3] and the body of each [F].

    Every body grows by `gap`, so that those that touch but for rounding share volume.
    """
    parts, numbers = [], {}
    for number, body in enumerate(bodies):
        part = manifold(grown(body, gap), body.faces, body.friction).as_original()
        if part.status() != manifold3d.Error.NoError:
            raise InputError("expected a closed surface that does not cross itself", key=body.key)
        parts.append(part)
        numbers[part.original_id()] = number
    check_lines(parts, [body.key for body in bodies], gap)
    mesh = manifold3d.Manifold.batch_boolean(parts, manifold3d.OpType.Add).to_mesh64()
    values, triangles = np.array(mesh.vert_properties), np.array(mesh.tri_verts, np.int64)
    owner = np.zeros(len(triangles), np.int32)
    starts = np.array(mesh.run_index, np.int64) // 3
    for original, first, last in zip(mesh.run_original_id, starts[:-1], starts[1:], strict=True):
        owner[first:last] = numbers[int(original)]
    friction = values[:, 3][triangles]
    # Vertices where solids meet stand in the mesh once for each body.
    same = np.arange(len(values))
    same[np.array(mesh.merge_from_vert, np.int64)] = np.array(mesh.merge_to_vert, np.int64)
    return values[:, :3], same[triangles], friction, owner


def grown(body: Body, gap: float) -> Floats:
    """The vertices [V, 3] of a body whose faces have all moved outwards by `gap` [m].

    A vertex moves by the least d for which n . d = gap of its faces' normals n, in the mean square where they are many.
    """
    normals, _, _ = pseudonormals(body.vertices, body.faces)
    matrix, right = np.zeros((len(body.vertices), 3, 3)), np.zeros((len(body.vertices), 3))
    for corner in range(3):
        np.add.at(matrix, body.faces[:, corner], normals[:, :, None] * normals[:, None, :])
        np.add.at(right, body.faces[:, corner], gap * normals)
    matrix += FLAT * np.eye(3)
    return np.asarray(body.vertices + np.linalg.solve(matrix, right[..., None])[..., 0])


def sliced(vertices: Floats, triangles: Integers, lattice: Floats) -> NDArray[np.bool_]:
    """Which places of a lattice [m], shape [N, 3], lie in a closed surface, by level cuts through it; shape [N]."""
    # The library cuts across its third axis.
    body = manifold(vertices[:, [0, 2, 1]], triangles[:, ::-1])
    within = np.zeros(len(lattice), bool)
    for level in np.unique(lattice[:, 1]):
        here = np.flatnonzero(lattice[:, 1] == level)
        rings = [shapely.Polygon(ring) for ring in body.slice(float(level)).to_polygons() if len(ring) >= 3]
        for ring in rings:
            # A ring inside another one is a hole.
            within[here] ^= np.asarray(shapely.contains_xy(ring, lattice[here, 0], lattice[here, 2]), bool)
    return within
