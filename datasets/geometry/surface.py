"""The boundary of everything solid in a scene, as segments or triangles with normals, labels and friction.

For contact, all baffles and solids of a scene form one solid, their union, without joints between touching ones. Where
it reaches a side of the box it continues some cells beyond, so that no face lies on a side. The sign of a distance from
it comes from angle-weighted pseudonormals (Baerentzen & Aanaes 2005, https://doi.org/10.1109/TVCG.2005.49).
"""

import itertools
import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import shapely
from numpy.typing import NDArray

from datasets.errors import require
from datasets.geometry.closed import Body, pseudonormals, ring, snapped
from datasets.geometry.ground import BEYOND, CLOSING, TOUCHING, Floats, Integers, grid_triangles, ground_grid
from datasets.geometry.rings import check_simple, cut_ring, lengthened_ring, union_of_rings
from datasets.geometry.shells import cut_surface, lengthened_surface, outward, union_of_surfaces
from datasets.scene.parts import ROUGH, Domain, SceneLayout, Solid, coefficient, keyed

KEPT = 3.0  # cells beyond the box up to which faces are kept: the grid ends there (`mpm.arrays.layout.PADDING`)
CORNERS = {
    2: np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]),
    3: np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64),
}
"""Corners of the unit square and of the unit cube, whose last coordinate changes fastest."""
SIDES = [
    *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5]),  # x = 0, x = 1
    *([0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6]),  # y = 0, y = 1
    *([0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),  # z = 0, z = 1
]
FACES = {2: ring(4), 3: np.array(SIDES)}  # their faces, outwards


@dataclass(frozen=True, eq=False)
class Surface:
    """The boundary of the union of all solids of a scene; F faces in D dimensions."""

    corners: Floats  # of segments, the solid on the left, or triangles, anticlockwise from outside [m], [F, D, D]
    normals: Floats  # outward unit normals, shape [F, D]
    corner_normals: Floats  # pseudonormals at the corners, of unit length, shape [F, D, D]
    edge_normals: Floats  # the same of edges of triangles, [F, 3, 3], k from corner k to k + 1; in 2D [F, 0, 2]
    solid: NDArray[np.int32]  # solid of each face: first the scene's baffles, then its solids; shape [F]
    friction: Floats  # Coulomb coefficient at the corners [-], linear between them; inf without slip; shape [F, D]

    @classmethod
    def empty(cls, dimension: int) -> "Surface":
        """An empty surface."""
        corners, edges = np.zeros((0, dimension, dimension)), np.zeros((0, 3, 3) if dimension == 3 else (0, 0, 2))
        return cls(corners, corners[:, 0], corners, edges, np.zeros(0, np.int32), corners[:, 0])

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return int(self.corners.shape[-1])

    def chosen(self, faces: NDArray[np.bool_]) -> "Surface":
        """Some of its faces, shape [F]."""
        return Surface(**{name: array[faces] for name, array in vars(self).items()})


def surface_of(scene: SceneLayout) -> Surface | None:
    """The surface of all baffles and solids of a scene, one object for equal ones; None without. Raises InputError."""
    if not scene.baffles and not scene.solids:
        return None
    return surface_in(scene.domain, *solids_of(scene))


def surface_in_box(scene: SceneLayout) -> Surface | None:
    """The same, but solids other than terrain end at the sides of the box, as they are drawn."""
    if not scene.baffles and not scene.solids:
        return None
    return surface_in(scene.domain, *solids_of(scene), continues=False)


def solids_of(scene: SceneLayout) -> tuple[tuple[Solid, ...], tuple[str, ...]]:
    """All solids of `scene`, in the order of their numbers, and the key of each; without turbulence, so that scenes
    that differ only in turbulence share their surface."""
    baffles = []
    for baffle in scene.baffles:
        friction = scene.friction_of(baffle)
        contact = "no-slip" if friction == ROUGH else "coulomb"
        box = {key: getattr(baffle, key) for key in ("lower", "size", "turned_deg")}
        baffles.append(Solid(**box, friction=coefficient(friction, 0.0), contact=contact))
    others = [solid if solid.turbulence is None else replace(solid, turbulence=None) for solid in scene.solids]
    return (*baffles, *others), tuple(keyed(scene, "baffles", "solids"))


@lru_cache(maxsize=8)
def surface_in(domain: Domain, solids: tuple[Solid, ...], keys: tuple[str, ...], *, continues: bool = True) -> Surface:
    """The surface of `solids` in a box and, if it continues, some cells beyond, inf friction without slip; errors name
    the keys."""
    bodies = [body_of(*solid_and_key, domain, continues) for solid_and_key in zip(solids, keys, strict=True)]
    surface = boundary(bodies, CLOSING * domain.cell)
    margin, high = KEPT * domain.cell, np.array(domain.size)
    low, top = surface.corners.min(axis=1), surface.corners.max(axis=1)
    surface = surface.chosen(((top >= -margin) & (low <= high + margin)).all(axis=1))
    surface.friction[np.array([solid.contact == "no-slip" for solid in solids])[surface.solid]] = np.inf
    return surface


def crossings(surface: Surface, plan: Floats) -> tuple[Integers, Floats, NDArray[np.bool_]]:
    """Where the vertical lines at places in plan [m], [N, D - 1], cross a surface, up to rounding of its sides: the
    number of the line, the elevation [m], and whether the solid is below; each [K]."""
    sloping, tree = faces_in_plan(surface)
    level, flat = list(range(0, surface.dimension, 2)), np.zeros((len(plan), 2))
    flat[:, : len(level)] = plan
    line, number = tree.query(shapely.points(flat), predicate="dwithin", distance=TOUCHING)
    face = sloping[number]
    corners, normal = surface.corners[face], surface.normals[face]
    offset = ((plan[line] - corners[:, 0, level]) * normal[:, level]).sum(axis=1)
    y = corners[:, 0, 1] - offset / normal[:, 1]
    return line, y.clip(corners[..., 1].min(axis=1), corners[..., 1].max(axis=1)), normal[:, 1] > 0.0


@lru_cache(maxsize=2)
def faces_in_plan(surface: Surface) -> tuple[Integers, shapely.STRtree]:
    """The faces that are not vertical, [K], and where they lie in plan, in a tree."""
    # Above rounding only: the sides of a turned box have no area in plan.
    sloping = np.flatnonzero(np.abs(surface.normals[:, 1]) > 1.0e-9)
    corners = surface.corners[sloping]
    if surface.dimension == 3:
        return sloping, shapely.STRtree(shapely.polygons(corners[..., [0, 2]]))
    return sloping, shapely.STRtree(shapely.linestrings(corners * [1.0, 0.0]))


def boundary(bodies: list[Body], gap: float) -> Surface:
    """The boundary of the union of `bodies`; those at most `gap` [m] apart are merged."""
    if len(bodies) == 1:
        (body,) = bodies
        vertices, faces, friction = body.vertices, body.faces, body.friction[body.faces]
        owner = np.zeros(len(faces), np.int32)
    else:
        union = union_of_rings if bodies[0].vertices.shape[1] == 2 else union_of_surfaces
        vertices, faces, friction, owner = union(bodies, gap)
    surface = Surface(vertices[faces], *pseudonormals(vertices, faces), owner, friction)
    return surface.chosen(np.asarray(surface.normals.any(axis=1)))  # triangles without area have no normal


def body_of(solid: Solid, key: str, box: Domain, continues: bool) -> Body:
    """The surface of `solid`, where it meets a side of the box cut off or continued. Raises InputError."""
    body = closed_body(solid, key, box)
    thinnest = float(np.ptp(body.vertices, axis=0).min())
    require(thinnest > TOUCHING, key, f"a solid thicker than {TOUCHING:g} m", f"one of {thinnest:.3g} m")
    for axis, side in itertools.product(() if solid.kind == "terrain" else (0, 2, 1), (0, 1)):  # the floor last
        if axis < box.dimension:
            body = ended(body, axis, side, box, continues)
    return body


def closed_body(solid: Solid, key: str, box: Domain) -> Body:
    """The surface of `solid` itself; for a terrain, of everything below it, to some cells beyond the box."""
    dimension = box.dimension
    if solid.kind == "terrain":
        return ground_body(solid, key, box)
    if solid.kind == "box":
        low, size = np.array(solid.lower), np.array(solid.size)
        vertices, faces = low + CORNERS[dimension] * size, FACES[dimension]
        if solid.turned_deg != 0.0:
            plane, angle = slice(0, None, dimension - 1), math.radians(solid.turned_deg)
            c, s, centre = math.cos(angle), math.sin(angle), (low + 0.5 * size)[plane]
            vertices[:, plane] = (vertices[:, plane] - centre) @ np.array([[c, s], [-s, c]]) + centre
    else:
        vertices = np.array(solid.vertices, dtype=np.float64)
        if dimension == 2:
            check_simple(vertices, f"{key}.vertices")
            faces = ring(len(vertices))
        else:
            vertices, faces = outward(vertices, np.array(solid.triangles, np.int64), f"{key}.triangles")
    friction = np.broadcast_to(np.asarray(solid.friction, np.float64), len(vertices)).copy()
    if dimension == 2 and not shapely.is_ccw(shapely.linearrings(vertices)):
        vertices, friction = vertices[::-1].copy(), friction[::-1].copy()
    return Body(vertices=vertices, faces=faces, friction=friction, key=key)


def ground_body(solid: Solid, key: str, box: Domain) -> Body:
    """Everything below a terrain, to some cells beyond the box, where it continues level, or straight from a side."""
    axes, heights, friction = ground_grid(solid, key, box)
    deep = min(0.0, float(heights.min())) - BEYOND * box.cell
    if len(axes) == 1:
        x, points = axes[0], np.stack([axes[0], heights], axis=1)
        # The line runs towards +x with the solid on its right: from its end back to its start is anticlockwise.
        vertices = np.concatenate([points[::-1], [[x[0], deep], [x[-1], deep]]])
        friction = np.concatenate([friction[::-1], friction[[0, -1]]])
        return Body(vertices=vertices, faces=ring(len(vertices)), friction=friction, key=key)
    x, z = axes
    return raster_body(x, z, heights, friction, deep=deep, key=key)


def raster_body(x: Floats, z: Floats, heights: Floats, friction: Floats, *, deep: float, key: str) -> Body:
    """The body between posts at x, z with `heights` and `friction`, both [X, Z], and the level `deep`; in m."""
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
    vertices, faces = np.concatenate([top, bottom, centre]), np.concatenate([grid_triangles(heights), skirt, floor])
    friction = np.concatenate([friction.ravel(), friction.ravel()[rim], [float(friction.mean())]])
    return Body(vertices=vertices, faces=faces, friction=friction, key=key, grows=False)


def ended(body: Body, axis: int, side: int, box: Domain, continues: bool) -> Body:
    """The body cut off at a side of the box (0 or 1 of `axis`); if it reaches the side and `continues`, then from there
    on straight beyond. Raises InputError if nothing of it lies in the box."""
    limit, out = (box.size[axis], 1.0) if side else (0.0, -1.0)
    within = replace(body, vertices=snapped(body.vertices, axis, limit))
    height = out * (within.vertices[:, axis] - limit)
    if height.max() < 0.0:
        return body
    planar = box.dimension == 2
    if height.max() > 0.0:
        within = (cut_ring if planar else cut_surface)(within, axis, limit, out)
        within = replace(within, vertices=snapped(within.vertices, axis, limit))
    if not continues:
        return within
    return (lengthened_ring if planar else lengthened_surface)(within, axis, limit, out * BEYOND * box.cell) or body
