"""Solids in three dimensions by manifold3d: closed triangles, what of them goes on beyond the box, their union."""

import manifold3d
import numpy as np
import shapely
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.geometry.closed import Body, pseudonormals
from datasets.geometry.ground import BEYOND, OUTSIDE, TOUCHING, grid_triangles, ground_grid
from datasets.scene import Domain, Solid

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

FLAT = 1.0e-6
"""What makes the place of a vertex between faces of one plane unique [-]."""


def outward(vertices: Floats, triangles: Integers, key: str) -> Integers:
    """The triangles of a closed surface, turned to face outwards. Raises InputError where it is open."""
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    _, number = np.unique(edges, axis=0, return_counts=True)
    opened, shared = int((number == 1).sum()), int((number > 2).sum())
    if opened or shared:
        fault = f"{opened} open edges" if opened else f"{shared} edges of more than two triangles"
        raise InputError(f"expected a closed surface, got one with {fault}", key=key)
    status = manifold(vertices, triangles).status()
    if status != manifold3d.Error.NoError:
        raise InputError("expected a closed surface whose triangles all face the same way", key=key)
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    volume = float(np.einsum("ni,ni->", a, np.cross(b, c)))
    if volume == 0.0:
        raise InputError("expected a surface that encloses a volume", key=key)
    return triangles if volume > 0.0 else triangles[:, ::-1].copy()


def ground_body(solid: Solid, key: str, box: Domain) -> Body:
    """All that lies below a height field, some cells beyond the box; it goes on level, or straight from a side."""
    (x, z), heights, friction = ground_grid(solid, key, box)
    deep = min(0.0, float(heights.min())) - BEYOND * box.cell
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
    """The body cut off at a side of the box (0 or 1 of `axis`) and continued straight beyond, where it reaches it."""
    limit, out = (box.size[axis], 1.0) if side else (0.0, -1.0)
    vertices, triangles, friction = body.vertices.copy(), body.faces, body.friction
    vertices[np.abs(vertices[:, axis] - limit) <= TOUCHING, axis] = limit
    height = out * (vertices[:, axis] - limit)
    if height.max() < 0.0:
        return body
    if height.max() > 0.0:
        inward = np.zeros(3)
        inward[axis] = -out
        part = manifold(vertices, triangles).trim_by_plane(tuple(inward), -out * limit)
        if part.is_empty():
            raise InputError(OUTSIDE, key=body.key)
        mesh = part.to_mesh64()
        vertices, triangles = np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, np.int64)
        friction = np.full(len(vertices), friction[0])
        vertices[np.abs(vertices[:, axis] - limit) <= TOUCHING, axis] = limit
    on_side = (vertices[triangles][..., axis] == limit).all(axis=1)
    if not on_side.any():
        return body
    lid = triangles[on_side]
    used, renamed = np.unique(lid, return_inverse=True)
    renamed = renamed.reshape(-1, 3) + len(vertices)
    moved = vertices[used]
    moved[:, axis] = limit + out * BEYOND * box.cell
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


def union(bodies: list[Body], gap: float) -> tuple[Floats, Integers, Floats, NDArray[np.int32]]:
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
