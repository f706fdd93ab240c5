"""Scene -> particles: a jittered lattice in each mass, whose particles have exactly the volume of the mass."""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datasets.errors import require
from datasets.geometry.bodies import filling, height, lattice_of
from datasets.memory import require as require_memory
from datasets.scene import INFLOW, TOLERANCE, Mass, Scene, keyed
from datasets.scene.grid_field import FRICTION, THICKNESS, Floats
from datasets.scene.material import Material

PARTICLE = 60  # bytes per particle while the particles are made, over the square of the dimension
ROUNDING = 1.0e-13  # relative difference up to which two volumes are the same number
RESOLVED = (3.0, 4.0)  # number of cells across a body that a warning recommends
MISSED = 0.01  # smallest share of a body, too thin for any particle, that a warning reports


@dataclass(frozen=True, kw_only=True)
class Particles:
    """The particles of a scene at time 0, or as they enter, one mass after the other."""

    positions: Floats
    """Positions [m], shape [N, D]."""
    velocities: Floats
    """Velocities [m/s], shape [N, D]."""
    mass: NDArray[np.int32]
    """Index of the scene's mass that each particle belongs to, shape [N]."""
    velocity_gradients: Floats
    """Velocity gradients dv_i / dx_j [1/s], shape [N, D, D]; 0 except in a rotating mass or a field of velocity."""
    material: NDArray[np.int32]
    """Index into `materials` of each particle, shape [N]."""
    materials: tuple[Material, ...]
    """The different materials of the scene."""
    volume: Floats
    """Initial volume of each particle [m^D], shape [N]."""
    depth: Floats
    """Depth of each particle below the top of its mass [m], shape [N]."""
    entry_time: Floats | None = None
    """Time at which each particle enters [s], shape [N], at its position and with its velocity; 0 for particles that
    are present from the start. None if all are."""
    friction_deg: Floats | None = None
    """Friction angle of each particle [deg], shape [N], which replaces its material's and is measured in the same way;
    None if all particles have the material's."""

    @property
    def present(self) -> NDArray[np.bool_]:
        """Which particles are present from the start, shape [N]."""
        return np.full(len(self.volume), True) if self.entry_time is None else self.entry_time == 0.0

    @property
    def density(self) -> Floats:
        """Initial density of each particle [kg/m^3], shape [N]."""
        return np.array([material.density for material in self.materials])[self.material]

    @property
    def friction(self) -> NDArray[np.float32]:
        """tan(phi) of each particle [-], shape [N]."""
        if self.friction_deg is None:
            return np.array([material.friction for material in self.materials], np.float32)[self.material]
        phi_deg = self.friction_deg.copy()
        for index, material in enumerate(self.materials):
            here = self.material == index
            phi_deg[here] = material.phi_deg_of(phi_deg[here], material.dilation_deg)
        return np.tan(np.radians(phi_deg)).astype(np.float32)

    @property
    def cohesion(self) -> NDArray[np.float32]:
        """Cohesion of each particle [Pa], shape [N]."""
        return cohesions(self.materials, self.material, self.depth)


def initial_particles(scene: Scene) -> Particles:
    """Fill every mass of `scene` with particles: a lattice of spacing about `cell / particles_per_axis`, fitted to the
    mass along every axis (`lattice_counts`). Each of N particles has the volume prod(size) / N, and moves at random
    within the share `jitter` of its lattice cell. Each mass draws from its own random stream, so that adding a mass
    does not change the others. For bodies that are no boxes, see `datasets.geometry.bodies`."""
    count = particle_count(scene)
    instead = f"there are {count}; larger cells or fewer particles_per_axis"
    require_memory(PARTICLE * scene.dimension**2 * count, "particles", instead, key="masses")
    positions, depths, velocities, times = [], [], [], []
    stretch = stretches(scene)
    for index, mass in enumerate(scene.masses):
        stream = np.random.default_rng([scene.seed, index])
        if mass.kind == "box":
            counts = lattice_counts(scene, mass)
            spacing = np.array(mass.size) / counts
            lattice = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, len(counts))
            offset = stream.uniform(-0.5, 0.5, lattice.shape) * scene.jitter
            moved = np.array(mass.lower) + (lattice + 0.5 + offset) * spacing
        else:
            filled = filling(scene, mass)
            jitter = stream.uniform(-0.5, 0.5, filled.lattice.shape) * scene.jitter
            moved = filled.positions(jitter)
        arm = moved - (np.array(mass.lower) + 0.5 * np.array(mass.size))
        flow = filled.inflow if mass.kind == INFLOW else None
        thrown = np.array(mass.velocity or (0.0,) * scene.dimension) + arm @ mass.spin.T
        velocities.append(thrown if flow is None else flow.velocities)
        times.append(np.zeros(len(moved)) if flow is None else flow.time)
        depths.append(depth(scene, mass, moved) * stretch[index])
        if mass.kind == "layer":
            moved = filled.positions(jitter, stretch[index])
        positions.append(moved)
    materials = tuple(dict.fromkeys(map(scene.material_of, scene.masses)))
    number = np.repeat(np.arange(len(scene.masses), dtype=np.int32), mass_counts(scene))
    material = np.array([materials.index(scene.material_of(mass)) for mass in scene.masses], np.int32)[number]
    spins = np.array([mass.spin for mass in scene.masses])
    alike = np.broadcast_to(spins[0], (len(number), *spins.shape[1:]))  # takes no memory
    gradients = alike if (spins == spins[0]).all() else spins[number]
    placed, moving, friction_deg = np.concatenate(positions), np.concatenate(velocities), None
    for field in scene.fields:
        if field.quantity == THICKNESS:
            continue
        here, values = field.mass is None or number == field.mass, field.at(placed)
        if field.quantity == FRICTION:
            angles = np.array([sand.friction_deg for sand in materials])[material]
            friction_deg = np.where(here, values, angles if friction_deg is None else friction_deg)
        else:
            moving[:, field.axis] = np.where(here, values, moving[:, field.axis])
            gradients = np.array(gradients)
            covered = np.broadcast_to(here, len(placed))[:, None]
            gradients[:, field.axis] = np.where(covered, field.slope(placed), gradients[:, field.axis])
    return Particles(
        positions=placed,
        velocities=moving,
        mass=number,
        velocity_gradients=gradients,
        material=material,
        materials=materials,
        volume=initial_volumes(scene),
        depth=np.concatenate(depths),
        entry_time=np.concatenate(times) if any(mass.kind == INFLOW for mass in scene.masses) else None,
        friction_deg=friction_deg,
    )


def depth(scene: Scene, mass: Mass, positions: Floats) -> Floats:
    """Depth of `positions` [m], shape [N, D], below the top of `mass` [m], shape [N]."""
    if mass.kind == "box":
        return np.asarray(mass.lower[1] + mass.size[1] - positions[:, 1])
    return filling(scene, mass).depth(positions)


def cohesions(materials: Sequence[Material], material: NDArray[np.integer], depths: Floats) -> NDArray[np.float32]:
    """Cohesion [Pa] of particles, shape [N]. material: index into `materials`, [N]; depths: [m], [N]."""
    values = np.zeros(len(depths), np.float32)
    for index, sand in enumerate(materials):
        values[material == index] = sand.cohesion_at(depths[material == index])
    return values


def observed_cohesion(
    scene: Scene, positions: NDArray[np.floating], mass: NDArray[np.int32] | None
) -> NDArray[np.float32]:
    """Cohesion [Pa], shape [N], of the particles of a trajectory that starts at `positions` [m], shape [N, D]. mass:
    index of each particle's mass, if they are not those of `initial_particles`. Raises InputError if the masses differ
    and the particles cannot be assigned to them."""
    materials = [scene.material_of(body) for body in scene.masses]
    grows = [material.strength_gradient > 0.0 for material in materials]
    alike = len(materials) == 1 or (len({material.cohesion for material in materials}) == 1 and not any(grows))
    if mass is None and alike:
        mass = np.zeros(len(positions), np.int32)
    elif mass is None:
        counts = mass_counts(scene)
        expected = f"the {sum(counts)} particles of masses that differ in cohesion"
        require(sum(counts) == len(positions), "positions", expected, len(positions))
        mass = np.repeat(np.arange(len(counts), dtype=np.int32), counts)
    depths = np.zeros(len(positions))
    for index, body in enumerate(scene.masses):
        if grows[index]:
            depths[mass == index] = depth(scene, body, np.asarray(positions[mass == index], np.float64))
    return cohesions(materials, mass, depths)


def lattice_counts(scene: Scene, mass: Mass) -> list[int]:
    """Particles along each axis of `mass`: the spacing nearest to `cell / particles_per_axis` that fits its size.
    If every side is at least a cell, the spacings along different axes differ by at most a factor of two."""
    return [max(1, round(length / scene.particle_spacing)) for length in mass.size]


def mass_counts(scene: Scene) -> list[int]:
    """Number of particles of each mass, shape [masses]."""
    return [
        math.prod(lattice_counts(scene, mass)) if mass.kind == "box" else len(filling(scene, mass).lattice)
        for mass in scene.masses
    ]


def stretches(scene: Scene) -> list[Floats]:
    """Thickness by a field over the layer's own, for the particles of each mass [-]; shape [1] where it is 1. The field
    moves the particles of a layer up or down in proportion and scales their volumes: a flow depends on it smoothly."""
    factors = [np.ones(1) for _ in scene.masses]
    for field in scene.fields:
        for index in range(len(factors)) if field.mass is None else (field.mass,):
            if field.quantity == THICKNESS:
                filled = filling(scene, scene.masses[index])
                assert filled.thickness is not None, "a layer, by the checks of the scene"
                factors[index] = field.at(filled.lattice) / filled.thickness
    return factors


def mass_volumes(scene: Scene) -> Floats:
    """Volume of each mass [m^D], shape [masses]: of its shape or, with a field of thickness, of its particles."""
    volumes = (math.prod(mass.size) if mass.kind == "box" else filling(scene, mass).volume for mass in scene.masses)
    return np.asarray(np.fromiter(volumes, np.float64) * [float(shares.mean()) for shares in volume_shares(scene)])


def volume_shares(scene: Scene) -> list[Floats]:
    """For each mass, the volume of its particles over their mean without a field of thickness [-]; [1] if alike."""
    shares = stretches(scene)
    for index, mass in enumerate(scene.masses):
        if mass.kind == "layer" and (uneven := filling(scene, mass).shares) is not None:
            shares[index] = shares[index] * uneven
    return shares


def particle_count(scene: Scene) -> int:
    """Number of particles that `initial_particles` makes."""
    return sum(mass_counts(scene))


def released_volume(scene: Scene) -> float:
    """Volume of all masses of `scene` [m^D]."""
    return float(sum(mass_volumes(scene).tolist()))


def mass_centroids(scene: Scene) -> Floats:
    """Centroid of each mass's particles before their jitter [m], shape [masses, D]."""
    centroids = []
    for mass, shares in zip(scene.masses, volume_shares(scene), strict=True):
        places = lattice_of(scene, mass)
        centroids.append(np.average(places, axis=0, weights=np.broadcast_to(shares, len(places))))
    return np.array(centroids)


def mass_particle_volumes(scene: Scene) -> Floats:
    """Volume of a particle of each mass [m^D], shape [masses]: the volume of the mass over its number of particles.
    Volumes that differ by rounding become one number, `scene.particle_volume` if the masses fit the lattice."""
    volumes = [scene.particle_volume]
    for volume in (mass_volumes(scene) / mass_counts(scene)).tolist():
        volumes.append(next((earlier for earlier in volumes if abs(volume - earlier) <= ROUNDING * earlier), volume))
    return np.array(volumes[1:])


def initial_volumes(scene: Scene) -> Floats:
    """Initial volume of each particle [m^D], shape [N]."""
    counts, shares = mass_counts(scene), volume_shares(scene)
    volumes = np.repeat(mass_particle_volumes(scene), counts)
    if all(len(uneven) == 1 for uneven in shares):
        return volumes
    factors = [np.broadcast_to(part / part.mean(), count) for part, count in zip(shares, counts, strict=True)]
    return np.asarray(volumes * np.concatenate(factors))


def particle_volumes(scene: Scene, count: int) -> Floats:
    """Initial volume [m^D] of each of the `count` particles of a trajectory of `scene`, shape [count]. For particles of
    another code than `initial_particles`, only the mean is known."""
    volumes = initial_volumes(scene)
    return volumes if len(volumes) == count else np.full(count, volumes.sum() / count)


def warn_if_unresolved(scene: Scene) -> None:
    """Give a UserWarning if a mass is thinner than a cell, and if parts of a mass are too thin for any particle."""
    if line := unresolved(scene, 1.0):
        warnings.warn(line, stacklevel=3)
    for key, mass in keyed(scene, "masses").items():
        if mass.kind in ("polygon", "mesh") and (missed := filling(scene, mass).missed()) > MISSED:
            thin = f"{key}: {missed:.0%} of its volume is thinner than the distance of particles"
            line = f"{thin}, {scene.particle_spacing:.3g} m, and is added to the rest; smaller cells would hold it"
            warnings.warn(line, stacklevel=3)


def unresolved(scene: Scene, cells: float) -> str:
    """Which masses are thinner than `cells` cells, and the cell that would resolve them; empty if none is. A mass that
    continues across its thin side in another mass of its material, or has a single particle, does not count."""
    cell, thin = scene.domain.cell, dict[str, float]()
    for (key, mass), count in zip(keyed(scene, "masses").items(), mass_counts(scene), strict=True):
        across = min(mass.size) if mass.kind != "layer" else min(height(scene, mass), *mass.size[::2])
        goes_on = mass.kind == "box" and continues(scene, mass, int(np.argmin(mass.size)))
        if count > 1 and across < cells * cell - TOLERANCE and not goes_on:
            thin[key] = across
    if not thin:
        return ""
    names, thickness = ", ".join([*thin][:3]) + (", ..." if len(thin) > 3 else ""), min(thin.values())
    finest, coarsest = (thickness / number for number in reversed(RESOLVED))
    said = f"{names}: {thickness:.3g} m thick in cells of {cell:.3g} m, so the grid hardly resolves it"
    return f"{said}; a cell of {finest:.2g} to {coarsest:.2g} m would"


def continues(scene: Scene, mass: Mass, axis: int) -> bool:
    """Whether a mass of the same material shares a face with `mass` across `axis`."""
    lower = np.array([other.lower for other in scene.masses])
    upper = lower + np.array([other.size for other in scene.masses])
    gaps = np.maximum(lower - np.add(mass.lower, mass.size), mass.lower - upper)
    beside = (np.delete(gaps, axis, axis=1) < -TOLERANCE).all(axis=1) & (np.abs(gaps[:, axis]) <= TOLERANCE)
    others = (scene.masses[index] for index in np.flatnonzero(beside))
    return any(scene.material_of(other) == scene.material_of(mass) for other in others)
