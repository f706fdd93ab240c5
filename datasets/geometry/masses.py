"""Bodies that are no boxes: what shape a mass has, its exact volume, and the particles that fill it.

A body is filled with the lattice of `datasets.particles`, cut by its shape; each of the N particles has the volume of
the shape over N. A particle that its jitter would put outside stays where the lattice has it. A layer's lattice follows
the ground: it is laid in x, z and the height above the ground, a shear that keeps volumes.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.geometry.ground import elevation
from datasets.geometry.margins import TOUCHING, Box
from datasets.geometry.solid import FARTHEST, Solid, check_solid, check_vectors
from datasets.memory import require

if TYPE_CHECKING:
    from datasets.scene import Mass, Scene

Floats = NDArray[np.float64]

KEYS: dict[tuple[str, int], tuple[str, ...]] = {
    ("box", 2): ("lower", "size"),
    ("box", 3): ("lower", "size"),
    ("polygon", 2): ("vertices",),
    ("mesh", 3): ("vertices", "triangles"),
    ("layer", 2): ("thickness",),
    ("layer", 3): ("thickness",),
    ("particles", 2): ("positions",),
    ("particles", 3): ("positions",),
}
"""Keys that give the shape of a kind of mass, all of them needed."""
OPTIONAL = {"layer": ("origin", "spacing", "outline"), "particles": ("velocities", "volume")}
"""Keys that a kind of mass may have."""


LATTICE = 40
"""Bytes that a coordinate of a lattice takes while it is made."""


@dataclass(frozen=True, eq=False)
class Filling:
    """The particles of a body, before their jitter; N of them."""

    lattice: Floats
    """Their places [m], shape [N, D]; of a layer y counts from the ground."""
    spacing: Floats
    """Of the lattice [m], shape [D]; 0 where particles stay where they are."""
    volumes: Floats
    """Of each particle [m^D], shape [N]."""
    lower: Floats
    """Lower corner of the box around the body [m], shape [D]."""
    upper: Floats
    """Upper corner [m], shape [D]."""
    outside: Callable[[Floats], NDArray[np.bool_]]
    """Which of N places, one of each particle, are no longer in the body."""
    raised: Callable[[Floats], Floats]
    """Places of the lattice where they are in the box, both [N, D] in m."""
    depth: Callable[[Floats], Floats]
    """Depth below the top of the body [m], shape [N], of places of the lattice."""

    def positions(self, offset: Floats) -> tuple[Floats, Floats]:
        """Positions [N, D] and depths [N] of particles moved by `offset` [N, D], in fractions of the spacing; in m."""
        moved = self.lattice + offset * self.spacing
        moved = np.where(self.outside(moved)[:, None], self.lattice, moved)
        return self.raised(moved), self.depth(moved)


def with_boxes(scene: "Scene") -> tuple["Mass", ...]:
    """The masses of `scene`, each with the box around it. Raises InputError for a shape that is none."""
    size = scene.domain.size
    for index, solid in enumerate(scene.solids):
        check_solid(solid, f"solids[{index}]", len(size))
    masses = []
    for index, mass in enumerate(scene.masses):
        if mass.kind != "box":
            found = filling(scene, mass, f"masses[{index}]")
            lower, upper = found.lower, found.upper
            mass = dataclasses.replace(mass, lower=tuple(lower.tolist()), size=tuple((upper - lower).tolist()))
        masses.append(mass)
    return tuple(masses)


def filling(scene: "Scene", mass: "Mass", key: str = "masses") -> Filling:
    """The particles that fill a mass of `scene` that is no box. Raises InputError."""
    return fill(
        dataclasses.replace(mass, lower=(), size=(), material=None, velocity=None, angular_velocity=None),
        Box(scene.domain.size, scene.domain.cell),
        tuple(solid for solid in scene.solids if solid.kind == "terrain") if mass.kind == "layer" else (),
        scene.particle_spacing,
        key,
    )


@lru_cache(maxsize=64)
def fill(mass: "Mass", box: Box, ground: tuple[Solid, ...], share: float, key: str) -> Filling:
    """The particles of `mass` on a lattice of about `share` [m]. Raises InputError."""
    check_shape(mass, key, box.dimension)
    if mass.kind == "polygon":
        found = polygon(mass, share, key)
    elif mass.kind == "mesh":
        found = mesh(mass, box, share, key)
    elif mass.kind == "layer":
        found = layer(mass, box, ground, share, key)
    else:
        found = particles(mass, box, share, key)
    if not len(found.lattice):
        raise InputError(f"expected a body that a lattice of {share:g} m puts particles into, it has none", key=key)
    return found


def check_shape(mass: "Mass", key: str, dimension: int) -> None:
    """Raise InputError for a mass whose keys give no shape in `dimension` dimensions."""

    def require(ok: bool, name: str, expected: str, got: object) -> None:
        if not ok:
            raise InputError(f"expected {expected}, got {got}", key=f"{key}.{name}")

    kinds = [kind for kind, count in KEYS if count == dimension]
    require(mass.kind in kinds, "kind", f"{', '.join(kinds)} in {dimension}D", repr(mass.kind))
    needed, optional = KEYS[mass.kind, dimension], OPTIONAL.get(mass.kind, ())
    every = {name for names in (*KEYS.values(), *OPTIONAL.values()) for name in names} - {"lower", "size"}
    for name in sorted(every):
        given = getattr(mass, name) is not None
        require(given or name not in needed, name, f"`{'`, `'.join(needed)}` of a {mass.kind}", "none")
        require(not given or name in needed or name in optional, name, f"no such key of a {mass.kind}", "one")
    for name in ("vertices", "positions", "velocities"):
        rows = getattr(mass, name)
        if rows is not None:
            check_vectors(rows, [f"{name}[{index}]" for index in range(len(rows))], key, dimension)
    if mass.outline is not None:
        rows = mass.outline
        check_vectors(rows, [f"outline[{index}]" for index in range(len(rows))], key, dimension - 1)
        require(len(rows) >= 3 or (len(rows) == 2 and dimension == 2), "outline", "3 corners, or 2 x in 2D", len(rows))
    if mass.velocities is not None and mass.positions is not None:
        require(
            len(mass.velocities) == len(mass.positions), "velocities", "one for each position", len(mass.velocities)
        )
        require(mass.velocity is None, "velocity", "no velocity of the whole beside those of particles", "one")


def polygon(mass: "Mass", share: float, key: str) -> Filling:
    """A polygon in 2D."""
    import shapely

    from datasets.geometry.planar import check_simple

    vertices = np.array(mass.vertices)
    if len(vertices) < 3:
        raise InputError(f"expected at least 3 vertices, got {len(vertices)}", key=f"{key}.vertices")
    check_simple(vertices, f"{key}.vertices")
    shape = shapely.Polygon(vertices)
    shapely.prepare(shape)
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    lattice, spacing = lattice_in(lower, upper, share)
    lattice = lattice[shapely.contains_xy(shape, lattice[:, 0], lattice[:, 1])]
    return Filling(
        lattice,
        spacing,
        np.full(len(lattice), shape.area / max(1, len(lattice))),
        lower,
        upper,
        lambda positions: ~np.asarray(shapely.contains_xy(shape, positions[:, 0], positions[:, 1])),
        lambda positions: positions,
        lambda positions: np.asarray(upper[1] - positions[:, 1]),
    )


def mesh(mass: "Mass", box: Box, share: float, key: str) -> Filling:
    """A closed surface of triangles in 3D."""
    from datasets.geometry.nearest import inside
    from datasets.geometry.spatial import enclosed_volume, enclosing, outward, sliced
    from datasets.geometry.surface import surface_in

    vertices = np.array(mass.vertices)
    triangles = outward(vertices, np.array(mass.triangles, np.int64), f"{key}.triangles")
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    lattice, spacing = lattice_in(lower, upper, share)
    within = sliced(vertices, triangles, lattice)
    # A particle all of whose neighbours in the lattice are in the body stays in it wherever its jitter puts it.
    buried = enclosing(
        within, [round(float(length / step)) for length, step in zip(upper - lower, spacing, strict=True)]
    )
    lattice, buried = lattice[within], buried[within]
    # In a box of its own, which it does not reach the sides of.
    solid = Solid(kind="mesh", vertices=tuple(map(tuple, (vertices - lower + 1.0).tolist())), triangles=mass.triangles)

    def outside(positions: Floats) -> NDArray[np.bool_]:
        surface = surface_in(Box(tuple((upper - lower + 2.0).tolist()), box.cell), (solid,), (key,))
        found = np.zeros(len(positions), bool)
        found[~buried] = ~inside(surface, positions[~buried] - lower + 1.0)
        return found

    return Filling(
        lattice,
        spacing,
        np.full(len(lattice), enclosed_volume(vertices, triangles) / max(1, len(lattice))),
        lower,
        upper,
        outside,
        lambda positions: positions,
        lambda positions: np.asarray(upper[1] - positions[:, 1]),
    )


def layer(mass: "Mass", box: Box, ground: tuple[Solid, ...], share: float, key: str) -> Filling:
    """A layer of given vertical thickness on the ground."""
    from datasets.geometry.layers import Plan

    plan = Plan(mass, box, key)
    level = [axis for axis in range(box.dimension) if axis != 1]
    thickest = plan.greatest
    lattice, spacing = lattice_in(np.insert(plan.lower, 1, 0.0), np.insert(plan.upper, 1, thickest), share)
    positions = lattice[:, level]
    lattice = lattice[plan.contains(positions) & (lattice[:, 1] < plan.thickness(positions))]

    def height(positions: Floats) -> Floats:
        return elevation(ground, box, positions[:, level])

    def raised(positions: Floats) -> Floats:
        moved = positions.copy()
        moved[:, 1] += height(positions)
        return moved

    def outside(positions: Floats) -> NDArray[np.bool_]:
        flat = positions[:, level]
        return np.asarray(~plan.contains(flat) | (positions[:, 1] >= plan.thickness(flat)))

    stations, _ = lattice_in(plan.lower, plan.upper, 0.5 * share)
    stations = stations[plan.contains(stations) & (plan.thickness(stations) > 0.0)]
    if not len(stations):
        raise InputError("expected a layer with some thickness in the box, it has none", key=f"{key}.thickness")
    floor = elevation(ground, box, stations)
    top = floor + plan.thickness(stations)
    if top.max() > box.size[1] + TOUCHING:
        raise InputError(
            f"expected a layer inside the domain {list(box.size)}, its top is at y = {top.max():g}", key=key
        )
    return Filling(
        lattice,
        spacing,
        np.full(len(lattice), plan.volume / max(1, len(lattice))),
        np.insert(plan.lower, 1, float(floor.min())),
        np.insert(plan.upper, 1, float(top.max())),
        outside,
        raised,
        lambda positions: np.asarray(np.maximum(plan.thickness(positions[:, level]) - positions[:, 1], 0.0)),
    )


def particles(mass: "Mass", box: Box, share: float, key: str) -> Filling:
    """Particles where a file has them."""
    positions = np.array(mass.positions, np.float64).reshape(-1, box.dimension)
    beyond = ((positions < -TOUCHING) | (positions > np.array(box.size) + TOUCHING)).any(axis=1)
    if beyond.any():
        first = int(np.argmax(beyond))
        raise InputError(
            f"expected positions inside the domain {list(box.size)}, got {positions[first].tolist()}",
            key=f"{key}.positions[{first}]",
        )
    given = mass.volume if mass.volume is not None else share**box.dimension
    if isinstance(given, tuple) and len(given) != len(positions):
        raise InputError(
            f"expected {len(positions)} volumes, one for each particle, got {len(given)}", key=f"{key}.volume"
        )
    volumes = np.broadcast_to(np.asarray(given, np.float64), len(positions)).copy()
    if not ((volumes > 0.0) & (volumes <= FARTHEST)).all():
        raise InputError(f"expected positive volumes in m^{box.dimension}", key=f"{key}.volume")
    if not len(positions):
        raise InputError("expected at least one particle", key=f"{key}.positions")
    half = 0.5 * (volumes ** (1.0 / box.dimension))[:, None]
    upper = np.minimum((positions + half).max(axis=0), box.size)
    return Filling(
        positions,
        np.zeros(box.dimension),
        volumes,
        np.maximum((positions - half).min(axis=0), 0.0),
        upper,
        lambda moved: np.zeros(len(moved), bool),
        lambda moved: moved,
        lambda moved: np.asarray(upper[1] - moved[:, 1]),
    )


def lattice_in(lower: Floats, upper: Floats, share: float) -> tuple[Floats, Floats]:
    """Centres [N, D] of a lattice of about `share` [m] that fits the box from `lower` to `upper`; its spacing [D]."""
    counts = [max(1, round(float(length) / share)) for length in upper - lower]
    require(
        LATTICE * len(counts) * math.prod(counts),
        "a body in a lattice",
        f"it has {math.prod(counts):.3g} places; larger cells or fewer particles_per_axis",
        key="masses",
    )
    spacing = (upper - lower) / counts
    lattice = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, len(counts))
    return lower + (lattice + 0.5) * spacing, spacing
