"""Bodies that are no boxes: the shape of a mass, its exact volume, and the particles that fill it.

A body is filled with the lattice of `datasets.scene.particles`, cut by its shape; each of the N particles has the
volume of the shape over N. A particle that its jitter would put outside stays where the lattice has it. A layer's
lattice follows the ground: it is laid in x, z and the height above the ground, a shear that keeps volumes. Where the
thickness h varies, each column of the lattice has n = max(1, round(h / s)) rows over its own thickness, and each of its
particles the volume h A / n, scaled to the exact volume of the layer, sum h_c A_c over the cells that give it.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from datasets.errors import require
from datasets.geometry.closed import Body
from datasets.geometry.ground import TOUCHING, Floats, Solids, elevation, interpolated, plan_axes
from datasets.geometry.inflow import Inflow, inflow, until
from datasets.geometry.rings import check_simple
from datasets.geometry.shapes import check_grid, check_shape
from datasets.geometry.shells import manifold, outward, sliced
from datasets.memory import require as require_memory
from datasets.scene.parts import INFLOW, TOLERANCE, Domain, Mass, SceneLayout, keyed
from datasets.schema import FARTHEST

Within = Callable[[Floats], NDArray[np.bool_]]

LATTICE = 40  # bytes per coordinate of a lattice while it is made
FAINT = 0.01  # thickness of a layer over the height of a row below which a column gets no particle


@dataclass(frozen=True, eq=False, kw_only=True)
class Filling:
    """The particles of a body, before their jitter; N of them."""

    lattice: Floats  # their places [m], shape [N, D]; for a layer, y counts from the ground
    spacing: Floats  # of the lattice [m], shape [D]; of a layer whose thickness varies [N, D]
    volume: float  # of the body [m^D], which its particles share
    shares: Floats | None = None  # volume of each particle over the mean of all [-], [N]; None where all are alike
    lower: Floats  # lower corner of the box around the body [m], shape [D]
    upper: Floats  # upper corner [m], shape [D]
    contains: Within  # which of N places, one of each particle, are still in the body
    ends: Callable[[Floats], Floats] | None = None
    """Of a mesh or a layer: foot and top [m], [2, N], over N places in plan, NaN beside it; steps of a layer are ramps,
    since water takes differences over a cell of the grid."""
    raised: Callable[[Floats], Floats] = np.copy  # places of the lattice where they are in the box, both [N, D] in m
    cover: Callable[[Floats], Floats] | None = None  # depth of places below the top [m], [N]; else below the highest
    thickness: Floats | None = None  # of a layer at the places of its lattice [m], shape [N]
    inflow: Inflow | None = None  # for an inflow: particles and times; the lattice holds the places of entry
    missed: Callable[[], float] = float  # share of the volume that is so thin that no particle is near; 0.0 of a layer

    def depth(self, positions: Floats) -> Floats:
        """Depth of `positions` [N, D] below the top of the body, shape [N]; in m."""
        return np.asarray(self.upper[1] - positions[:, 1]) if self.cover is None else self.cover(positions)

    @property
    def height(self) -> float:
        """Largest height of the material over one place in plan [m]: on a slope, less than that of its box."""
        if self.inflow is not None:
            return self.inflow.depth
        plan = np.rint((self.lattice - self.lattice.min(axis=0)) / self.spacing).astype(np.int64)
        plan[:, 1] = 0
        column = np.ravel_multi_index(tuple(plan.T), tuple(plan.max(axis=0) + 1))
        return float(np.bincount(column).max() * self.spacing[1])

    def positions(self, offset: Floats, stretch: Floats | float = 1.0) -> Floats:
        """Positions [m], shape [N, D], of particles moved by `offset` [N, D], in fractions of the spacing. stretch: of
        the heights above the ground of a layer [-], shape [N]."""
        if self.inflow is not None:
            return self.inflow.places(offset[0])
        moved = self.lattice + offset * self.spacing
        held = np.where(self.contains(moved)[:, None], moved, self.lattice)
        held[:, 1] *= stretch
        return self.raised(held)


def with_boxes(scene: SceneLayout) -> tuple[Mass, ...]:
    """The masses of `scene`, each with the box around it. Raises InputError for an invalid shape."""
    masses = []
    for key, mass in keyed(scene, "masses").items():
        if mass.kind != "box":
            filled = filling(scene, mass, key)
            size = tuple((filled.upper - filled.lower).tolist())
            mass = dataclasses.replace(mass, lower=tuple(filled.lower.tolist()), size=size)
        masses.append(mass)
    return tuple(masses)


def filling(scene: SceneLayout, mass: Mass, key: str = "masses") -> Filling:
    """The particles that fill a mass of `scene` that is no box. Raises InputError."""
    shape = dataclasses.replace(mass, lower=(), size=(), material=None, velocity=None, angular_velocity=None)
    terrains = [solid for solid in scene.solids if solid.kind == "terrain" and mass.kind in ("layer", INFLOW)]
    # Without friction, so that scenes that differ only in friction share the result.
    ground = tuple(dataclasses.replace(solid, friction=0.0, turbulence=None) for solid in terrains)
    if mass.kind == INFLOW and mass.hydrograph is not None:
        shape = dataclasses.replace(shape, hydrograph=until(mass.hydrograph, scene.duration, f"{key}.hydrograph"))
    return fill(shape, scene.domain, ground, scene.particle_spacing, key)


@lru_cache(maxsize=16)
def fill(mass: Mass, domain: Domain, ground: Solids, share: float, key: str) -> Filling:
    """The particles of `mass` on a lattice of about `share` [m]. Raises InputError."""
    check_shape(mass, key, domain.dimension)
    if mass.kind == "layer":
        filled = layer(mass, domain, ground, share, key)
    elif mass.kind == INFLOW:
        filled = entering(mass, domain, ground, share, key)
    else:
        # Checked before filling: a mesh in millimetres would be a billion times as large.
        low, high = np.min(np.array(mass.vertices), axis=0), np.max(np.array(mass.vertices), axis=0)
        inside = bool((low >= -TOLERANCE).all() and (high <= np.array(domain.size) + TOLERANCE).all())
        expected = f"a {mass.kind} inside the domain {list(domain.size)}"
        require(inside, key, expected, f"one from {low.tolist()} to {high.tolist()}")
        filled = (polygon if mass.kind == "polygon" else mesh)(mass, share, key)
    require(len(filled.lattice) > 0, key, f"a body that a lattice of {share:g} m puts particles into", "one without")
    return filled


def entering(mass: Mass, domain: Domain, ground: Solids, share: float, key: str) -> Filling:
    """The particles of an inflow at their places of entry; the box around it is as long as it is deep."""
    inlet = inflow(mass, domain, ground, share, key)
    places, size = inlet.places(), np.array(domain.size)
    inside = bool((places >= -TOLERANCE).all() and (places <= size + TOLERANCE).all())
    got = f"places from {places.min(axis=0).tolist()} to {places.max(axis=0).tolist()}"
    require(inside, key, f"a section inside the domain {size.tolist()} up to its greatest depth", got)
    around = np.concatenate([places, places + inlet.depth * inlet.flow[: len(size)]]).clip(0.0, size)
    lower, spacing = np.minimum(around.min(axis=0), size - share), np.full(len(size), share)
    box: dict[str, Any] = {"lower": lower, "upper": np.maximum(around.max(axis=0), lower + share)}
    nothing: dict[str, Any] = {"contains": lambda at: at[:, 0] >= 0.0, "cover": lambda at: 0.0 * at[:, 0]}
    return Filling(lattice=places, spacing=spacing, volume=inlet.volume, **box, **nothing, inflow=inlet)


def polygon(mass: Mass, share: float, key: str) -> Filling:
    """A polygon in 2D."""
    vertices = np.array(mass.vertices)
    check_simple(vertices, f"{key}.vertices")
    shape = shapely.Polygon(vertices)
    shapely.prepare(shape)
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    lattice, spacing = lattice_in(lower, upper, share)
    contains = partial(shapely.contains_xy, shape)
    within = contains(lattice)
    box: dict[str, Any] = {"lower": lower, "upper": upper, "contains": contains}
    missed = partial(missed_share, within, lower, upper, share, contains)
    return Filling(lattice=lattice[within], spacing=spacing, volume=shape.area, **box, missed=missed)


def mesh(mass: Mass, share: float, key: str) -> Filling:
    """A closed surface of triangles in 3D."""
    from scipy import ndimage  # commands with boxes only start without these libraries

    from datasets.geometry.nearest import inside
    from datasets.geometry.surface import boundary, crossings

    vertices, triangles = outward(np.array(mass.vertices), np.array(mass.triangles, np.int64), f"{key}.triangles")
    body = Body(vertices=vertices, faces=triangles, friction=np.zeros(len(vertices)), key=key)
    solid = cache(partial(boundary, [body], 0.0))
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    lattice, spacing = lattice_in(lower, upper, share)
    within = sliced(vertices, triangles, lattice)
    # A particle whose lattice neighbours are all in the body stays in it for any jitter.
    counts = np.rint((upper - lower) / spacing).astype(int)
    buried = ndimage.binary_erosion(within.reshape(counts), np.ones((3, 3, 3)), border_value=False).ravel()[within]

    def contains(places: Floats) -> NDArray[np.bool_]:
        contained: NDArray[np.bool_] = buried.copy()
        contained[~buried] = inside(solid(), places[~buried])
        return contained

    def ends(plan: Floats) -> Floats:
        # Particles of a lattice share their places in plan.
        columns, number = np.unique(plan, axis=0, return_inverse=True)
        line, y, _ = crossings(solid(), columns)
        foot, top = np.full((2, len(columns)), [[np.inf], [-np.inf]])
        np.minimum.at(foot, line, y)
        np.maximum.at(top, line, y)
        return np.where(foot <= top, [foot, top], np.nan)[:, number.ravel()]

    box: dict[str, Any] = {"lower": lower, "upper": upper, "contains": contains, "ends": ends}
    missed = partial(missed_share, within, lower, upper, share, partial(sliced, vertices, triangles))
    volume = manifold(vertices, triangles).volume()
    return Filling(lattice=lattice[within], spacing=spacing, volume=volume, **box, missed=missed)


def missed_share(within: NDArray[np.bool_], lower: Floats, upper: Floats, share: float, contains: Within) -> float:
    """Share of a body that lies in places of its lattice whose neighbours, too, are not `within` it, by a finer one."""
    from scipy import ndimage

    counts = [max(1, round(float(length) / share)) for length in upper - lower]
    near = ndimage.binary_dilation(within.reshape(counts), np.ones((3,) * len(counts)))
    fine, _ = lattice_in(lower, upper, 0.5 * share)
    place = ((fine[contains(fine)] - lower) / (upper - lower) * counts).astype(int)
    return 1.0 - float(near[tuple(place.T)].mean()) if len(place) else 0.0


def layer(mass: Mass, domain: Domain, ground: Solids, share: float, key: str) -> Filling:
    """A layer of given vertical thickness on the ground."""
    plan = Plan(mass, domain, key)
    level = plan_axes(domain.dimension)
    lattice, spacing, shares = layered(plan, share)
    thickness = plan.thickness(lattice[:, level])

    def contains(places: Floats) -> NDArray[np.bool_]:
        return np.asarray(plan.contains(places[:, level]) & (places[:, 1] < plan.thickness(places[:, level])))

    places, _ = lattice_in(plan.lower, plan.upper, 0.5 * share)
    places = places[plan.contains(places) & (plan.thickness(places) > 0.0)]
    require(len(places) > 0, key, f"a layer that a lattice of {share:g} m puts particles into", "one without")
    floor = elevation(ground, domain, places)
    top = floor + plan.thickness(places)
    fits = top.max() <= domain.size[1] + TOUCHING
    require(fits, key, f"a layer inside the domain {list(domain.size)}", f"its top at y = {top.max():g}")

    def raised(places: Floats) -> Floats:
        moved = places.copy()
        moved[:, 1] += elevation(ground, domain, places[:, level])
        return moved

    def ends(places: Floats) -> Floats:
        foot = elevation(ground, domain, places)
        return np.where(plan.thickness(places) > 0.0, [foot, foot + plan.smooth_thickness(places, domain.cell)], np.nan)

    def cover(places: Floats) -> Floats:
        top = elevation(ground, domain, places[:, level]) + plan.thickness(places[:, level])
        return np.asarray(np.maximum(top - places[:, 1], 0.0))

    lower, upper = np.insert(plan.lower, 1, float(floor.min())), np.insert(plan.upper, 1, float(top.max()))
    given: dict[str, Any] = {"lattice": lattice, "spacing": spacing, "shares": shares, "thickness": thickness}
    place: dict[str, Any] = {"lower": lower, "upper": upper, "ends": ends, "raised": raised, "cover": cover}
    return Filling(volume=plan.volume, contains=contains, **given, **place)


def layered(plan: "Plan", share: float) -> tuple[Floats, Floats, Floats | None]:
    """Lattice of a layer [m], [N, D], y from the ground; its spacing [m] and `Filling.shares`."""
    if plan.values.ndim == 0:
        lattice, spacing = lattice_in(np.insert(plan.lower, 1, 0.0), np.insert(plan.upper, 1, plan.values), share)
        return lattice[plan.contains(np.delete(lattice, 1, axis=1))], spacing, None
    columns, across = lattice_in(plan.lower, plan.upper, share)
    thickness = plan.thickness(columns)
    there = plan.contains(columns) & (thickness > FAINT * share)
    columns, thickness = columns[there], thickness[there]
    rows = np.maximum(1, np.rint(thickness / share)).astype(np.int64)
    require_room(int(rows.sum()), 3)
    height = np.repeat(thickness / rows, rows)
    row = np.arange(len(height)) - np.repeat(np.cumsum(rows) - rows, rows)
    lattice = np.insert(np.repeat(columns, rows, axis=0), 1, (row + 0.5) * height, axis=1)
    spacing = np.insert(np.tile(across, (len(height), 1)), 1, height, axis=1)
    return lattice, spacing, height / height.mean() if len(np.unique(height)) > 1 else None


class Plan:
    """A layer in plan, in 2D a range of x, in 3D a polygon of x and z, and its thickness. Raises InputError."""

    def __init__(self, mass: Mass, domain: Domain, key: str) -> None:
        given, spatial = mass.thickness or 0.0, domain.dimension == 3
        rows = given if isinstance(given, tuple) else None
        require(spatial or rows is None, f"{key}.thickness", "a number, in 3D that or rows of a grid", "rows")
        check_grid(mass, rows, key, "thickness", "a grid of thicknesses")
        self.edges: tuple[Floats, ...] = ()
        """Edges of the cells around the given thicknesses, along each axis in plan [m]; empty for a single number."""
        self.values = np.array(given, np.float64)  # the thickness [m]: a number, or that of each cell
        if rows is not None:
            steps = zip(mass.origin or (), mass.spacing or (), self.values.shape, strict=True)
            self.edges = tuple(np.asarray(first + step * (np.arange(count + 1) - 0.5)) for first, step, count in steps)
        some = self.values.min() >= 0.0 and 0.0 < self.values.max() <= FARTHEST
        require(some, f"{key}.thickness", "thicknesses in m of at least 0, and some above", f"{self.values.min():g}")
        size = np.array(domain.size)[plan_axes(domain.dimension)]
        outline = None if mass.outline is None else np.array(mass.outline)
        lower, upper = (np.zeros_like(size), size) if outline is None else (outline.min(axis=0), outline.max(axis=0))
        if self.edges:
            filled = [np.flatnonzero(self.values.any(axis=1 - axis)) for axis in (0, 1)]
            ends = [edges[[cells[0], cells[-1] + 1]] for edges, cells in zip(self.edges, filled, strict=True)]
            low, high = np.array(ends).T
            lower, upper = (low, high) if outline is None else (np.maximum(lower, low), np.minimum(upper, high))
        shape = shapely.box(*lower, *upper) if spatial else shapely.box(lower[0], 0.0, upper[0], 1.0)
        if outline is not None and spatial:
            check_simple(outline, f"{key}.outline")
            shape = shape.intersection(shapely.Polygon(outline))
        # In 2D the width is 1 m.
        self.region = shape.intersection(shapely.box(0.0, 0.0, size[0], size[1] if spatial else 1.0))
        require(self.region.area > 0.0, key, "a layer that lies in the box", "one that in plan does not")
        shapely.prepare(self.region)
        low_x, low_z, high_x, high_z = self.region.bounds
        self.lower: Floats = np.array([low_x, low_z] if spatial else [low_x])  # least x, and z, of the layer [m]
        self.upper: Floats = np.array([high_x, high_z] if spatial else [high_x])  # greatest [m]
        self.volume = self.within(self.region)  # of the layer in the box [m^D]
        self.lost = 1.0 - self.volume / self.within(shape)  # share of the layer that lies beyond the sides of the box
        require(self.volume > 0.0, f"{key}.thickness", "a layer with some thickness in the box", "none")

    def within(self, region: shapely.Geometry) -> float:
        """Volume of the layer over a region in plan [m^D]."""
        if not self.edges:
            return float(self.values) * float(region.area)
        i, k = np.nonzero(self.values)
        x, z = self.edges
        cells = shapely.box(x[i], z[k], x[i + 1], z[k + 1])
        shapely.prepare(region)
        cut = ~np.asarray(shapely.covers(region, cells))
        cells[cut] = shapely.intersection(cells[cut], region)
        return float(self.values[i, k] @ shapely.area(cells))

    def contains(self, plan: Floats) -> NDArray[np.bool_]:
        """Which places in plan [m], shape [N, D - 1], are in the layer's outline, shape [N]."""
        if plan.shape[1] == 1:
            return np.asarray(((plan >= self.lower) & (plan <= self.upper)).all(axis=1))
        return np.asarray(shapely.contains_xy(self.region, plan), bool)

    def thickness(self, plan: Floats) -> Floats:
        """Thickness [m] at places in plan, shape [N]: that of their cell, 0 beyond all cells."""
        if not self.edges:
            return np.full(len(plan), float(self.values))
        cells = (np.searchsorted(edges, plan[:, axis], side="right") for axis, edges in enumerate(self.edges))
        return np.asarray(np.pad(self.values, 1)[tuple(cells)])

    def smooth_thickness(self, plan: Floats, width: float) -> Floats:
        """Thickness [m] at places in plan, shape [N]: that of their cell, with each step to the next cell spread over a
        `width` [m], at most from centre to centre. No step at the end of the layer: there it keeps its thickness."""
        from scipy import ndimage

        if not self.edges:
            return self.thickness(plan)
        nearest = ndimage.distance_transform_edt(self.values == 0.0, return_distances=False, return_indices=True)
        # Each cell has two nodes along each axis, between which it is level.
        values, axes = self.values[tuple(nearest)].repeat(2, axis=0).repeat(2, axis=1), []
        for edges in self.edges:
            middle, level = 0.5 * (edges[:-1] + edges[1:]), max(0.0, edges[1] - edges[0] - width)
            nodes = np.stack([middle - 0.5 * level, middle + 0.5 * level], axis=1).ravel()
            nodes[[0, -1]] = edges[[0, -1]]
            axes.append(nodes)
        return interpolated(axes, values, plan)


def height(scene: SceneLayout, mass: Mass) -> float:
    """Largest height of the material of `mass` over one place in plan [m]; for a layer, its largest thickness."""
    if mass.kind == "box":
        return mass.size[1]
    return float(np.max(mass.thickness or 0.0)) if mass.kind == "layer" else filling(scene, mass).height


def scene_height(scene: SceneLayout) -> float:
    """Largest height of the material of all masses over one place in plan [m], without the air between them."""
    lower, size = (np.array([getattr(mass, key) for mass in scene.masses])[:, ::2] for key in ("lower", "size"))
    above = (np.abs(lower + 0.5 * size - (lower + 0.5 * size)[:, None]) <= 0.5 * size + TOLERANCE).all(axis=2)
    return float((above @ np.array([height(scene, mass) for mass in scene.masses])).max())


def lattice_of(scene: SceneLayout, mass: Mass) -> Floats:
    """Positions of a mass's particles before their jitter [m], shape [N, D]."""
    if mass.kind == "box":
        lower = np.array(mass.lower)
        return lattice_in(lower, lower + np.array(mass.size), scene.particle_spacing)[0]
    filled = filling(scene, mass)
    return filled.raised(filled.lattice)


def lattice_in(lower: Floats, upper: Floats, share: float) -> tuple[Floats, Floats]:
    """Centres [N, D] of a lattice of about `share` [m] that fits the box from `lower` to `upper`; its spacing [D]."""
    counts = [max(1, round(float(length) / share)) for length in upper - lower]
    require_room(math.prod(counts), len(counts))
    spacing = (upper - lower) / counts
    lattice = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, len(counts))
    return lower + (lattice + 0.5) * spacing, spacing


def require_room(places: int, dimension: int) -> None:
    """Raise InputError for a lattice of more places than the memory holds."""
    instead = f"it has {places:.3g} places; larger cells or fewer particles_per_axis"
    require_memory(LATTICE * dimension * places, "a body in a lattice", instead, key="masses")
