"""Scene -> material points: a jittered lattice in each mass."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datasets.material import Material
from datasets.scene import Mass, Scene


@dataclass(frozen=True, kw_only=True)
class Particles:
    """The points of a scene at time 0."""

    positions: NDArray[np.float64]
    """Positions [m], shape [N, D]."""
    velocities: NDArray[np.float64]
    """Velocities [m/s], shape [N, D]."""
    velocity_gradients: NDArray[np.float64]
    """Velocity gradients dv_i / dx_j [1/s], shape [N, D, D]; 0 but in a mass that turns."""
    material: NDArray[np.int32]
    """Index into `materials` of each point, shape [N]."""
    materials: tuple[Material, ...]
    """The different materials of the scene."""
    volume: float
    """Initial volume of one point [m^D]."""

    @property
    def friction(self) -> NDArray[np.float32]:
        """tan(phi) of each point [-], shape [N]."""
        return np.array([material.friction for material in self.materials], np.float32)[self.material]

    @property
    def cohesion(self) -> NDArray[np.float32]:
        """Cohesion of each point [Pa], shape [N]."""
        return np.array([material.cohesion for material in self.materials], np.float32)[self.material]


def initial_particles(scene: Scene) -> Particles:
    """Fill every mass of `scene` with points.

    A mass gets a lattice of about `cell / particles_per_axis`, fitted to its size (`lattice_counts`); each point is moved
    at random inside the share `jitter` of its own lattice cell. A mass draws from its own stream, so that adding one
    leaves the others.
    """
    share = scene.domain.cell / scene.particles_per_axis
    materials: list[Material] = []
    positions, velocities, gradients, indices = [], [], [], []
    for number, mass in enumerate(scene.masses):
        counts = lattice_counts(mass, share)
        spacing = np.array(mass.size) / counts
        lattice = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, len(counts))
        offset = np.random.default_rng([scene.seed, number]).uniform(-0.5, 0.5, lattice.shape) * scene.jitter
        positions.append(np.array(mass.lower) + (lattice + 0.5 + offset) * spacing)
        arm = positions[-1] - (np.array(mass.lower) + 0.5 * np.array(mass.size))
        velocities.append(np.array(mass.velocity or (0.0,) * scene.dimension) + arm @ mass.spin.T)
        gradients.append(np.broadcast_to(mass.spin, (len(lattice), *mass.spin.shape)))
        material = scene.material_of(mass)
        if material not in materials:
            materials.append(material)
        indices.append(np.full(len(lattice), materials.index(material), np.int32))
    return Particles(
        positions=np.concatenate(positions),
        velocities=np.concatenate(velocities),
        velocity_gradients=np.concatenate(gradients),
        material=np.concatenate(indices),
        materials=tuple(materials),
        volume=scene.particle_volume,
    )


def lattice_counts(mass: Mass, share: float) -> list[int]:
    """Points along each axis of `mass`, about `share` [m] apart.

    Every point weighs the same, so their number must stand for the volume of the mass: where the lengths are no
    multiples of `share`, the longest axis makes good what rounding the others gained or lost.
    """
    counts = [max(1, round(length / share)) for length in mass.size]
    longest = int(np.argmax(mass.size))
    others = math.prod(counts) // counts[longest]
    counts[longest] = max(1, round(math.prod(mass.size) / (share ** len(counts) * others)))
    return counts


def particle_count(scene: Scene) -> int:
    """How many points `initial_particles` makes."""
    share = scene.domain.cell / scene.particles_per_axis
    return sum(math.prod(lattice_counts(mass, share)) for mass in scene.masses)
