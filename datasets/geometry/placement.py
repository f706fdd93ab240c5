"""Placement of bodies: clearance from solids and from each other, and height above whatever is beneath them."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import shapely
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.geometry.bodies import Plan, filling, lattice_of
from datasets.geometry.contact_surface import contact_surface_of, height_field
from datasets.geometry.ground import CLOSING, TOUCHING, Floats, plan_axes
from datasets.geometry.nearest import inside
from datasets.geometry.shells import manifold
from datasets.geometry.surface import Surface, closed_body, crossings, raster_body, solids_of, surface_in
from datasets.scene.parts import INFLOW, TOLERANCE, Baffle, Domain, Mass, SceneLayout, Solid, keyed

HOVERS = 0.1  # height above the ground, in cells, from which on a body is in flight
SAMPLES = 32  # most places along an axis at which the height of a body above ground is looked for


def check_overlaps(scene: SceneLayout) -> None:
    """Raise InputError for an invalid solid, a body that overlaps a solid, or masses that overlap each other."""
    keys, boxes = zip(*keyed(scene, "masses", "baffles").items(), strict=True)
    shared = overlaps(boxes)
    shared[len(scene.masses) :, len(scene.masses) :] = False  # baffles may be built of more boxes than one
    upright = np.array([box.kind == "box" if isinstance(box, Mass) else box.turned_deg == 0.0 for box in boxes])
    for first, second in np.argwhere(shared & np.outer(upright, upright)):
        raise InputError(f"expected a box clear of {keys[first]}, got an overlap", key=keys[second])
    if not has_shapes(scene):
        return
    contact_surface_of(scene)  # raises errors of the shapes
    for index, mass in enumerate(scene.masses):
        others: list[tuple[Mass | Solid, str]] = [*zip(*solids_of(scene), strict=True)]
        others += [(other, keys[number]) for number, other in enumerate(scene.masses[:index])]
        for other, key in others:
            aligned = mass.kind == other.kind == "box" and (isinstance(other, Mass) or other.turned_deg == 0.0)
            if aligned and not key.startswith("solids"):
                continue  # compared above
            if overlap(scene, mass, other, key):
                hint = " (on a slope a body is a layer, or a polygon along it)" if other.kind == "terrain" else ""
                raise InputError(f"expected a body clear of {key}, got an overlap{hint}", key=f"masses[{index}]")


def has_shapes(scene: SceneLayout) -> bool:
    """Whether a scene has shapes other than boxes along the axes."""
    turned = any(baffle.turned_deg != 0.0 for baffle in scene.baffles)
    return bool(scene.solids) or turned or any(mass.kind != "box" for mass in scene.masses)


def corners(boxes: Sequence[Mass | Baffle]) -> tuple[Floats, Floats]:
    """The smallest and the largest coordinates of each box [m], both of shape [N, D]."""
    lower = np.array([box.lower for box in boxes])
    return lower, lower + np.array([box.size for box in boxes])


def overlaps(boxes: Sequence[Mass | Baffle]) -> NDArray[np.bool_]:
    """Which boxes share volume with a later one, shape [N, N]; touching faces do not count."""
    lower, upper = corners(boxes)
    below = lower[:, None] + TOLERANCE < upper[None]
    return np.asarray(np.triu((below & below.swapaxes(0, 1)).all(axis=-1), k=1))


def overlap(scene: SceneLayout, mass: Mass, other: Mass | Solid, key: str) -> bool:
    """Whether a mass shares volume with another one or a solid: exactly, or for a layer or an inflow by particles."""
    if INFLOW in (mass.kind, other.kind) and isinstance(other, Mass):
        return False  # it may reach to the section
    if isinstance(other, Mass):
        if not overlaps((mass, other)).any():
            return False
        if other.kind == "layer":
            mass, other = other, mass
    if mass.kind not in ("layer", INFLOW):
        return shapes_overlap(shape_of(mass), shape_of(other), key, scene.domain)
    if other.kind == "terrain":
        return False  # it lies on the highest terrain
    places = lattice_of(scene, mass)
    if isinstance(other, Solid) or other.kind != "layer":
        return bool(inside(surface_in(scene.domain, (shape_of(other),), (key,)), places).any())
    plan, level = Plan(other, scene.domain, key), places[:, plan_axes(scene.dimension)]
    return bool((plan.contains(level) & (plan.thickness(level) > 0.0)).any())


def shape_of(body: Mass | Solid) -> Solid:
    """A box, a polygon or a mesh as a solid."""
    if isinstance(body, Solid):
        return body
    lower, size = (body.lower, body.size) if body.kind == "box" else (None, None)
    return Solid(kind=body.kind, lower=lower, size=size, vertices=body.vertices, triangles=body.triangles)


@lru_cache(maxsize=256)
def shapes_overlap(first: Solid, second: Solid, key: str, domain: Domain) -> bool:
    """Whether two shapes share more than a margin of rounding."""
    margin, a = 10.0 * TOUCHING, closed_body(first, key, domain)
    if domain.dimension == 3 and second.kind == "terrain":
        # Only what lies below the first solid and around it.
        low, high, field = a.vertices.min(axis=0), a.vertices.max(axis=0), height_field(second, key, 0, domain)
        deep = float(min(low[1], field.heights.min())) - 1.0
        b = raster_body(*field.around(low[::2], high[::2]), deep=deep, key=key)
    else:
        b = closed_body(second, key, domain)
    if domain.dimension == 2:
        return bool(shapely.Polygon(a.vertices).buffer(-margin).intersects(shapely.Polygon(b.vertices)))
    solid, other = (manifold(body.vertices, body.faces) for body in (a, b))
    return bool((solid ^ other).volume() > margin * solid.surface_area())


def remembers_gaps(scene: SceneLayout) -> bool:
    """Whether gaps between particles are remembered: as `volume_correction` says, else wherever sand may fall or
    splash: beside solids, if a mass has any velocity (else an unknown velocity would cross a jump), and if a body is in
    flight. A column that collapses on a flat floor keeps its volume without this."""
    if scene.volume_correction is not None:
        return scene.volume_correction
    thrown = any(mass.kind == INFLOW or np.any(mass.velocity) or np.any(mass.angular_velocity) for mass in scene.masses)
    thrown = thrown or any(np.any(field.values) for field in scene.fields if "velocity" in field.quantity)
    if scene.gravity <= 0.0 or thrown or scene.solids or scene.baffles:
        return scene.gravity > 0.0
    return bool((heights_above_ground(scene) >= HOVERS * scene.domain.cell).any())


def heights_above_ground(scene: SceneLayout) -> Floats:
    """Height [m] of the body of each mass above floor, box or solid beneath it, [masses]; 0 for a layer. Touching
    masses form one body, with the height of the lowest."""
    count, shaped = len(scene.masses), has_shapes(scene)
    lower, upper = corners(scene.masses if shaped else (*scene.masses, *scene.baffles))
    level = plan_axes(scene.dimension)
    over = (lower[:, None, level] + TOLERANCE < upper[None][:, :, level]).all(axis=-1)
    beneath = over & over.T & (upper[None, :, 1] <= lower[:, None, 1] + TOLERANCE)
    height = lower[:count, 1] - np.where(beneath[:count], upper[:, 1], 0.0).max(axis=1)
    if shaped:
        solid, slack = contact_surface_of(scene), 10.0 * CLOSING * scene.domain.cell
        for index, mass in enumerate(scene.masses):
            above = 0.0
            if mass.kind != "layer":
                places = underside(scene, mass)
                tops = np.zeros(len(places))
                if solid is not None:
                    tops = tops_beneath(solid.around(places, scene.domain.cell), places, slack)
                above = max(0.0, float((places[:, 1] - tops).min()))
            height[index] = min(height[index], above)
    group = connected(lower[:count], upper[:count])
    lowest = np.full(count, np.inf)
    np.minimum.at(lowest, group, height)
    return np.asarray(lowest[group])


def connected(lower: Floats, upper: Floats) -> NDArray[np.int32]:
    """The number of the group of each box, shape [K]: boxes that share at least a corner form one group."""
    from scipy.sparse.csgraph import connected_components  # imported here: --help does not need it

    touch = (lower[:, None] <= upper + TOLERANCE).all(axis=-1)
    group: NDArray[np.int32] = connected_components(touch & touch.T)[1]
    return group


def underside(scene: SceneLayout, mass: Mass) -> Floats:
    """Places on the underside of a body [m], shape [N, D]; if it is no box, below all of its particles."""
    if mass.kind != "box":
        filled = filling(scene, mass)
        return np.asarray(filled.lattice - 0.5 * filled.spacing * np.eye(scene.dimension)[1])
    low, size = np.array(mass.lower), np.array(mass.size)
    step = np.maximum(0.5 * scene.domain.cell, size / SAMPLES)
    counts = np.maximum(2, np.rint(size / step).astype(int) + 1)
    axes = [np.linspace(low[a], low[a] + size[a], counts[a]) for a in plan_axes(scene.dimension)]
    plan = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    return np.insert(plan, 1, low[1], axis=1)


def tops_beneath(surface: Surface, places: Floats, slack: float) -> Floats:
    """Elevation [m] of the highest place of the surface at or beneath each place [m], [N, D], or up to `slack` [m]
    above it; 0, the floor's, where there is none; shape [N]."""
    place, y, up = crossings(surface, places[:, plan_axes(surface.dimension)])
    beneath = up & (y <= places[place, 1] + slack)
    tops = np.zeros(len(places))
    np.maximum.at(tops, place[beneath], y[beneath])
    return tops
