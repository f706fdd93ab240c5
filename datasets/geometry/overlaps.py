"""Whether masses are clear of solids and of each other, and how high they begin above what is beneath them."""

import dataclasses
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.geometry.ground import elevation
from datasets.geometry.margins import CLOSING, TOUCHING, Box
from datasets.geometry.masses import filling, lattice_in
from datasets.geometry.solid import Solid
from datasets.geometry.surface import Surface, solids_of, surface_of

if TYPE_CHECKING:
    import manifold3d

    from datasets.scene import Mass, Scene

Floats = NDArray[np.float64]

SAMPLES = 32
"""Most places along an axis at which the height of a body above ground is looked for."""
PAIRS = 4_000_000
"""Pairs of a place and a face that are looked at together."""


def check_overlaps(scene: "Scene") -> None:
    """Raise InputError for a solid that is none, a body that overlaps a solid, or masses that overlap each other."""
    surface_of(scene)  # says what is wrong with the shapes
    solids, keys = solids_of(scene)
    plain = [key.startswith("baffles") and solid.turned_deg == 0.0 for solid, key in zip(solids, keys, strict=True)]
    for index, mass in enumerate(scene.masses):
        for solid, key, is_plain in zip(solids, keys, plain, strict=True):
            if mass.kind == "box" and is_plain:
                continue  # boxes among boxes are the scene's own matter
            if overlap(scene, mass, solid, key):
                hint = " (on a slope a body is a layer, or a polygon along it)" if solid.kind == "terrain" else ""
                raise InputError(f"expected a body clear of {key}, got an overlap{hint}", key=f"masses[{index}]")
    check_masses(scene)


@lru_cache(maxsize=64)
def outline(solid: Solid, key: str, box: Box):  # type: ignore[no-untyped-def]
    """`planar.ring_of`, once."""
    from datasets.geometry import planar

    return planar.ring_of(solid, key, box)


@lru_cache(maxsize=64)
def body(solid: Solid, key: str, box: Box):  # type: ignore[no-untyped-def]
    """`spatial.body_of`, once."""
    from datasets.geometry import spatial

    return spatial.body_of(solid, key, box)


def overlap(scene: "Scene", mass: "Mass", solid: Solid, key: str) -> bool:
    """Whether a mass shares volume with a solid: boxes, polygons and meshes exactly, others by their particles."""
    box = Box(scene.domain.size, scene.domain.cell)
    if mass.kind in ("layer", "particles"):
        if mass.kind == "layer" and solid.kind == "terrain":
            return False  # it lies on the highest terrain
        return bool(in_solid(solid, key, box, particle_positions(scene, mass)).any())
    shape = dataclasses.replace(mass, material=None, velocity=None, angular_velocity=None, k0=None, release=None)
    return overlap_of_shapes(shape, solid, key, box)


def in_solid(solid: Solid, key: str, box: Box, points: Floats) -> NDArray[np.bool_]:
    """Which of N points [m], shape [N, D], lie in a solid, shape [N]."""
    from datasets.geometry.nearest import inside
    from datasets.geometry.surface import surface_in

    if solid.kind == "terrain":
        level = [axis for axis in range(box.dimension) if axis != 1]
        return np.asarray(points[:, 1] < elevation((solid,), box, points[:, level]) - TOUCHING)
    surface = surface_in(box, (solid,), (key,))
    low, high = surface.corners.min(axis=(0, 1)), surface.corners.max(axis=(0, 1))
    found = np.asarray(((points > low) & (points < high)).all(axis=1))
    found[found] = inside(surface, points[found])
    return found


@lru_cache(maxsize=256)
def overlap_of_shapes(mass: "Mass", solid: Solid, key: str, box: Box) -> bool:
    """Whether the shape of a mass, shrunk by a margin of rounding, shares volume with a solid."""
    margin = 10.0 * TOUCHING
    if box.dimension == 2:
        import shapely

        low, high = np.array(mass.lower), np.add(mass.lower, mass.size)
        shape = shapely.Polygon(mass.vertices) if mass.kind == "polygon" else shapely.box(*low, *high)
        ring = shapely.Polygon(outline(solid, key, box).points)
        return bool(shape.buffer(-margin).intersection(ring).area > 0.0)
    shared = mass_manifold(mass, margin) ^ solid_manifold(solid, key, box)
    return not shared.is_empty() and shared.volume() > 0.0


def mass_manifold(mass: "Mass", margin: float) -> "manifold3d.Manifold":
    """A box or a mesh of material, smaller by `margin` [m] all around."""
    from datasets.geometry import spatial

    if mass.kind == "box":
        return spatial.manifold(
            np.array(mass.lower) + margin + spatial.CUBE * (np.array(mass.size) - 2.0 * margin), spatial.CUBE_TRIANGLES
        )
    vertices = np.array(mass.vertices)
    triangles = spatial.outward(vertices, np.array(mass.triangles, np.int64), "masses")
    whole = spatial.Body(vertices=vertices, triangles=triangles, friction=np.zeros(len(vertices)), key="masses")
    return spatial.manifold(spatial.grown(whole, -margin), triangles)


def solid_manifold(solid: Solid, key: str, box: Box) -> "manifold3d.Manifold":
    """A solid in 3D for the library's operations."""
    from datasets.geometry import spatial

    whole = body(solid, key, box)
    return spatial.manifold(whole.vertices, whole.triangles)


def check_masses(scene: "Scene") -> None:
    """Raise InputError where particles of a body begin in another body, of which one at least is no box."""
    for first, a in enumerate(scene.masses):
        for second, b in enumerate(scene.masses[:first]):
            if (a.kind == "box" and b.kind == "box") or apart(a, b):
                continue
            if (
                contains(scene, b, particle_positions(scene, a)).any()
                or contains(scene, a, particle_positions(scene, b)).any()
            ):
                raise InputError(f"expected a body clear of masses[{second}], got an overlap", key=f"masses[{first}]")


def apart(a: "Mass", b: "Mass") -> bool:
    """Whether the boxes around two bodies share no volume."""
    gaps = np.maximum(np.subtract(a.lower, np.add(b.lower, b.size)), np.subtract(b.lower, np.add(a.lower, a.size)))
    return bool(gaps.max() > -TOUCHING)


def particle_positions(scene: "Scene", mass: "Mass") -> Floats:
    """Where the particles of a mass are before their jitter [m], shape [N, D]."""
    if mass.kind == "box":
        low = np.array(mass.lower)
        return lattice_in(low, low + np.array(mass.size), scene.particle_spacing)[0]
    found = filling(scene, mass)
    return found.raised(found.lattice)


def contains(scene: "Scene", mass: "Mass", points: Floats) -> NDArray[np.bool_]:
    """Which of N points [m], shape [N, D], lie in a body; none in single particles."""
    box = Box(scene.domain.size, scene.domain.cell)
    low, high = np.array(mass.lower) + TOUCHING, np.add(mass.lower, mass.size) - TOUCHING
    found = np.asarray(((points > low) & (points < high)).all(axis=1))
    if mass.kind == "particles" or not found.any():
        return np.zeros(len(points), bool)
    here = points[found]
    if mass.kind == "polygon":
        import shapely

        found[found] = shapely.contains_xy(shapely.Polygon(mass.vertices), here[:, 0], here[:, 1])
    elif mass.kind == "mesh":
        from datasets.geometry.nearest import inside
        from datasets.geometry.surface import surface_in

        enclosing = tuple((np.array(mass.size) + 2.0).tolist())
        moved = tuple(map(tuple, (np.array(mass.vertices) - mass.lower + 1.0).tolist()))
        solid = Solid(kind="mesh", vertices=moved, triangles=mass.triangles)
        found[found] = inside(surface_in(Box(enclosing, box.cell), (solid,), ("masses",)), here - mass.lower + 1.0)
    elif mass.kind == "layer":
        from datasets.geometry.layers import Plan

        plan = Plan(mass, box, "masses")
        level = here[:, [axis for axis in range(box.dimension) if axis != 1]]
        above = here[:, 1] - elevation(scene.solids, box, level)
        found[found] = plan.contains(level) & (above > 0.0) & (above < plan.thickness(level))
    return found


def heights_above_solids(scene: "Scene") -> Floats:
    """Height [m] of the underside of each mass above the highest solid beneath it, or the floor; shape [masses]."""
    surface = surface_of(scene)
    heights = np.zeros(len(scene.masses))
    for index, mass in enumerate(scene.masses):
        if mass.kind != "layer":
            points = underside(scene, mass)
            tops = np.zeros(len(points)) if surface is None else tops_beneath(surface, points, scene.domain.cell)
            heights[index] = max(0.0, float((points[:, 1] - tops).min()))
    return heights


def underside(scene: "Scene", mass: "Mass") -> Floats:
    """Places on the underside of a body [m], shape [N, D]."""
    low, size = np.array(mass.lower), np.array(mass.size)
    level = [axis for axis in range(scene.dimension) if axis != 1]
    step = np.maximum(0.5 * scene.domain.cell, size / SAMPLES)[level]
    if mass.kind == "box":
        axes = [
            np.linspace(low[a], low[a] + size[a], max(2, round(size[a] / s) + 1))
            for a, s in zip(level, step, strict=True)
        ]
        plan = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(level))
        return np.insert(plan, 1, low[1], axis=1)
    found = filling(scene, mass)
    points = found.lattice - [0.0, 0.5 * found.spacing[1], 0.0][: scene.dimension]
    order = np.argsort(points[:, 1], kind="stable")
    column = np.floor((points[order][:, level] - low[level]) / step).astype(np.int64)
    return np.asarray(points[order][np.unique(column, axis=0, return_index=True)[1]])


def tops_beneath(surface: Surface, points: Floats, cell: float) -> Floats:
    """Elevation [m] of the highest place of the surface at or beneath each point, 0 where there is none; shape [N]."""
    # Not more than rounding: the sides of a turned box have no area in plan.
    up = surface.normals[:, 1] > 1.0e-9
    corners = surface.corners[up]
    flat = [axis for axis in range(surface.dimension) if axis != 1]
    tops = np.zeros(len(points))
    portion = max(1, PAIRS // max(1, len(corners)))
    for first in range(0, len(points), portion):
        some = points[first : first + portion]
        offset = some[:, None, flat] - corners[None, :, 0, flat]
        edges = (corners[:, 1:] - corners[:, :1])[..., flat]
        if surface.dimension == 2:
            shares = [offset[..., 0] / edges[:, 0, 0]]
        else:
            area = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
            shares = [
                (offset[..., 0] * edges[:, 1, 1] - offset[..., 1] * edges[:, 1, 0]) / area,
                (offset[..., 1] * edges[:, 0, 0] - offset[..., 0] * edges[:, 0, 1]) / area,
            ]
        over = (np.stack(shares) >= -1.0e-9).all(axis=0) & (sum(shares) <= 1.0 + 1.0e-9)
        rise = corners[:, 1:, 1] - corners[:, :1, 1]
        y = corners[:, 0, 1] + sum(share * rise[:, k] for k, share in enumerate(shares))
        beneath = over & (y <= some[:, 1:2] + 10.0 * CLOSING * cell)
        tops[first : first + portion] = np.where(beneath, y, 0.0).max(axis=1, initial=0.0)
    return tops
