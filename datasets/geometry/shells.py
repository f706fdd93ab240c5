"""Closed surfaces of triangles in 3D, by manifold3d: turned outwards, cut, continued, united, sliced horizontally."""

import warnings
from dataclasses import replace
from itertools import combinations

import numpy as np
import shapely
from manifold3d import Error, Manifold, Mesh64, OpType
from numpy.typing import NDArray

from datasets.errors import require
from datasets.geometry.closed import NEARLY, POINTED, Body, meet, outside_of_box, pseudonormals
from datasets.geometry.ground import Floats, Integers

SHARED = 1.0e-6  # share of a volume that rounding may change
FLAT = 1.0e-6  # regularisation that makes the place of a vertex between coplanar faces unique [-]
NARROW = 100.0  # width of a shared region, over the distance by which bodies have grown, up to which it is no face
MOST_TRIANGLES = 20_000
"""Most triangles of two compared bodies, such as boxes and meshes, not terrain: a boolean of more takes seconds."""


def manifold(vertices: Floats, triangles: Integers, friction: Floats | None = None) -> Manifold:
    """A closed surface in the form of the library, with the friction of its vertices if given."""
    values = vertices if friction is None else np.column_stack([vertices, friction])
    return Manifold(Mesh64(np.ascontiguousarray(values), np.ascontiguousarray(triangles, np.uint64)))


def outward(vertices: Floats, triangles: Integers, key: str) -> tuple[Floats, Integers]:
    """Vertices [V, 3] and triangles [T, 3] of a closed surface, turned outwards, with its shells united: one that faces
    inwards within others is a cavity; shared volume counts once, with a warning. Raises InputError."""
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    _, number = np.unique(edges, axis=0, return_counts=True)
    opened, odd = int((number == 1).sum()), int((number % 2 == 1).sum())
    fault = f"{opened} open edges" if opened else f"{odd} edges of three or more triangles"
    require(opened == odd == 0, key, "a closed surface", f"one with {fault}")
    body = manifold(vertices, triangles)
    require(body.status() == Error.NoError, key, "a closed surface whose triangles all face the same way")
    shells = sorted(body.decompose(), key=lambda shell: -abs(shell.volume()))
    # The largest is none within another one.
    if shells and shells[0].volume() < 0.0:
        triangles = triangles[:, ::-1].copy()
        body = manifold(vertices, triangles)
        shells = sorted(body.decompose(), key=lambda shell: -abs(shell.volume()))
    nothing = "a surface that encloses a volume", "one that does not"
    require(bool(shells) and shells[0].volume() > 0.0, key, *nothing)
    if len(shells) == 1:
        return vertices, triangles
    united = Manifold()
    for shell in shells:
        if shell.volume() > 0.0:
            united = united + shell
            continue
        mesh = shell.to_mesh64()
        turned = manifold(np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts)[:, ::-1])
        buried = (united ^ turned).volume() > (1.0 - SHARED) * turned.volume()
        united = united - turned if buried else united + turned
    require(united.volume() > 0.0, key, *nothing)
    if abs(united.volume() - body.volume()) <= SHARED * united.volume():
        return vertices, triangles
    volumes = f"{united.volume():.6g} m^3 in place of {body.volume():.6g}"
    prefix = f"{key}: " if key else ""
    warnings.warn(f"{prefix}the shells of the mesh are united, which makes {volumes}", stacklevel=2)
    mesh = united.to_mesh64()
    return np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, np.int64)


def cut_surface(body: Body, axis: int, limit: float, out: float) -> Body:
    """The part of triangles within a side of the box. Raises InputError if there is none."""
    inward = tuple((-out * np.eye(3)[axis]).tolist())
    part = manifold(body.vertices, body.faces).trim_by_plane(inward, -out * limit)
    if part.is_empty():
        raise outside_of_box(body)
    mesh = part.to_mesh64()
    vertices, triangles = np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, np.int64)
    return replace(body, vertices=vertices, faces=triangles, friction=np.full(len(vertices), body.friction[0]))


def lengthened_surface(body: Body, axis: int, limit: float, beyond: float) -> Body | None:
    """Triangles whose faces on a side of the box are moved outwards, `beyond` it [m]; None if none lies there."""
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
    directed = {tuple(edge) for edge in edges.tolist()}
    rim = np.array([(b, a) not in directed for a, b in edges.tolist()])
    (a, b), (c, d) = edges[rim].T, ends[rim].T
    skirt = np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])
    faces = np.concatenate([triangles[~on_side], renamed, skirt])
    vertices, friction = np.concatenate([vertices, moved]), np.concatenate([friction, friction[used]])
    return Body(vertices=vertices, faces=faces, friction=friction, key=body.key)


def union_of_surfaces(bodies: list[Body], gap: float) -> tuple[Floats, Integers, Floats, NDArray[np.int32]]:
    """Vertices [V, 3] and triangles [F, 3] of the union, friction at their corners [F, 3] and the body of each [F].
    Every body except rasters grows by `gap`, so that bodies that touch to within rounding share volume."""
    parts, numbers = [], {}
    for number, body in enumerate(bodies):
        part = manifold(grown(body, gap) if body.grows else body.vertices, body.faces, body.friction).as_original()
        require(part.status() == Error.NoError, body.key, "a closed surface that does not cross itself")
        parts.append(part)
        numbers[part.original_id()] = number
    check_lines(bodies, parts, gap)
    mesh = Manifold.batch_boolean(parts, OpType.Add).to_mesh64()
    values, triangles = np.array(mesh.vert_properties), np.array(mesh.tri_verts, np.int64)
    owner = np.zeros(len(triangles), np.int32)
    starts = np.array(mesh.run_index, np.int64) // 3
    for original, first, last in zip(mesh.run_original_id, starts[:-1], starts[1:], strict=True):
        owner[first:last] = numbers[int(original)]
    friction = values[:, 3][triangles]
    # The mesh has a vertex for each body where solids meet.
    same = np.arange(len(values))
    same[np.array(mesh.merge_from_vert, np.int64)] = np.array(mesh.merge_to_vert, np.int64)
    return values[:, :3], same[triangles], friction, owner


def check_lines(bodies: list[Body], parts: list[Manifold], gap: float) -> None:
    """Raise InputError if solids in 3D meet only in a point or along a line, which no third solid covers. parts: the
    solids, each grown by `gap` [m]; those within NEARLY gaps of each other grow by half of that."""
    near, bounds = NEARLY * gap, np.array([part.bounding_box() for part in parts]).reshape(-1, 2, 3)
    for first, second in combinations(range(len(parts)), 2):
        lower, upper = bounds[[first, second], 0].max(axis=0), bounds[[first, second], 1].min(axis=0)
        if (lower - upper > near).any() or parts[first].num_tri() + parts[second].num_tri() > MOST_TRIANGLES:
            continue
        pair, wide, narrow, apart = [parts[first], parts[second]], gap, NARROW, ""
        if (pair[0] ^ pair[1]).is_empty():
            wide, narrow, chosen = 0.5 * near, 2.0 * POINTED, (bodies[first], bodies[second])
            pair = [manifold(grown(body, wide), body.faces) for body in chosen if body.grows]
            if len(pair) < 2 or any(solid.status() != Error.NoError for solid in pair):
                continue
            apart = f" but for {parts[first].min_gap(parts[second], near):.2g} m"
        others = [part for number, part in enumerate(parts) if number not in (first, second)]
        if where := line_shared(pair[0], pair[1], others, wide, narrow):
            raise meet(bodies[first].key, bodies[second].key, "a face", where + apart)


def line_shared(one: Manifold, other: Manifold, others: list[Manifold], gap: float, narrow: float) -> str:
    """Where two solids, grown by `gap` [m], share less than a face that is `narrow` gaps wide; empty if nowhere. Solids
    that share a face of width w then have a common layer of surface 2 w L, with L its diagonal; for an edge it is
    8 gap L. Regions that others cover by half do not count."""
    for shared in (one ^ other).decompose():
        low, high = np.array(shared.bounding_box()).reshape(2, 3)
        length = float(np.linalg.norm(high - low))
        if shared.surface_area() > narrow * gap * length:
            continue
        left = Manifold.batch_boolean([shared, *others], OpType.Subtract)
        if left.volume() > 0.5 * shared.volume():
            return "along a line" if length > narrow * gap else "in a point"
    return ""


def grown(body: Body, gap: float) -> Floats:
    """The vertices [V, 3] of a body whose faces have all moved outwards by `gap` [m]. A vertex moves by the smallest d
    with n . d = gap for its faces' normals n, in least squares if there are many."""
    normals, _, _ = pseudonormals(body.vertices, body.faces)
    matrix, right = np.zeros((len(body.vertices), 3, 3)), np.zeros((len(body.vertices), 3))
    for corner in range(3):
        np.add.at(matrix, body.faces[:, corner], normals[:, :, None] * normals[:, None, :])
        np.add.at(right, body.faces[:, corner], gap * normals)
    matrix += FLAT * np.eye(3)
    return np.asarray(body.vertices + np.linalg.solve(matrix, right[..., None])[..., 0])


def sliced(vertices: Floats, triangles: Integers, lattice: Floats) -> NDArray[np.bool_]:
    """Which places of a lattice [m], shape [N, 3], lie in a closed surface, by horizontal slices; shape [N]."""
    body = manifold(vertices[:, [0, 2, 1]], triangles[:, ::-1])  # the library cuts across its third axis
    within = np.zeros(len(lattice), bool)
    for level in np.unique(lattice[:, 1]):
        here = np.flatnonzero(lattice[:, 1] == level)
        rings = [shapely.Polygon(ring) for ring in body.slice(float(level)).to_polygons() if len(ring) >= 3]
        for ring in rings:
            # A ring inside another ring is a hole.
            within[here] ^= np.asarray(shapely.contains_xy(ring, lattice[here, 0], lattice[here, 2]), bool)
    return within
