"""Fields of particles through the grid: stress and pressure without their noise, and the density of a deposit.

The stress that particles carry scatters from one to its neighbours by as much as it is, because a quadratic spline does
not tell every arrangement of particles apart: what a cell's particles carry in sum moves the nodes, how they share it
does not. Fields on the grid are smooth. With w_ip the quadratic B-spline weight of node i at particle p and V_p its
volume,

    a_i  = sum_p w_ip V_p a_p / sum_p w_ip V_p          (particles to nodes)
    a_p' = sum_i w_ip a_i                               (and back)

which keeps constant fields as they are, and the volume integral of any: sum_p V_p a_p' = sum_i (sum_p w_ip V_p) a_i =
sum_p V_p a_p. It is applied PASSES times.

Density compares the mass at a node with the space that the material takes up around it:

    m_i   = sum_p w_ip m_p,   V_i = sum_c w_ic V_c
    rho_p = sum_i w_ip m_i / sum_i w_ip V_i

The sum over c is over those little boxes, as large as a particle's share of a cell, that the deposit fills: that hold
a particle, or lie in a gap no wider than two boxes between such ones (a morphological closing), inside the walls; of
one that a solid cuts the part outside. So a box beyond a wall or above the surface is missing from V_i as its particles
are from m_i, and both the floor and the surface have the density of the inside. What jitter leaves of scatter goes
through the grid once more, as above.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse

from datasets.geometry.nearest import nearest
from datasets.geometry.surface import surface_of
from datasets.scene import Scene
from mpm.arrays.layout import PADDING

PASSES = 2
"""How often stress and pressure go through the grid."""
MIN_FREE_SHARE = 0.5
"""Least share that counts as free of a box with a particle in it: its mass is there."""

Floats = NDArray[np.floating]


class Support(NamedTuple):
    """The 3^D nodes in the support of each of N particles."""

    shape: tuple[int, ...]
    """Nodes of the grid along each axis, from the first padding node on."""
    nodes: NDArray[np.int64]
    """Of the nodes in the flat grid, shape [N, 3^D]."""
    weight: NDArray[np.float64]
    """w_ip, shape [N, 3^D]."""
    offset: NDArray[np.float64]
    """x_i - x_p [cells], shape [N, 3^D, D]."""


def support(scene: Scene, positions: Floats) -> Support:
    """The support of particles at `positions` [m], shape [N, D], by quadratic B-splines."""
    cell, dimension = scene.domain.cell, scene.dimension
    x_cells = positions.astype(np.float64) / cell + PADDING
    low = np.floor(x_cells - 0.5)
    f = x_cells - low
    spline = np.stack([0.5 * (1.5 - f) ** 2, 0.75 - (f - 1.0) ** 2, 0.5 * (f - 0.5) ** 2], axis=-1)
    stencil = np.stack(np.meshgrid(*[np.arange(3)] * dimension, indexing="ij"), axis=-1).reshape(-1, dimension)
    weight = np.ones((len(positions), len(stencil)))
    for axis in range(dimension):
        weight *= spline[:, axis, :][:, stencil[:, axis]]
    shape = tuple(round(length / cell) + 2 * PADDING + 1 for length in scene.domain.size)
    index = low.astype(np.int64)[:, None, :] + stencil
    return Support(shape, np.ravel_multi_index(tuple(np.moveaxis(index, -1, 0)), shape), weight, stencil - f[:, None])


def weights(positions: Floats, scene: Scene) -> sparse.csr_array:
    """Weights w_ip of nodes i at `positions` p [m], shape [N, D]; shape [N, nodes]."""
    found = support(scene, positions)
    starts = np.arange(0, found.nodes.size + 1, found.nodes.shape[1])
    return sparse.csr_array(
        (found.weight.ravel(), found.nodes.ravel(), starts), shape=(len(positions), math.prod(found.shape))
    )


def smoothed(
    values: Floats, positions: Floats, volume: float | Floats, scene: Scene, passes: int = PASSES
) -> NDArray[np.float32]:
    """Fields of frames, shape [T, N] or [T, N, K], sent `passes` times through the grid; the same shape.

    positions: [m], shape [T, N, D]; volume: of each particle [m^D], one for all or shape [N].
    """
    found = np.empty(values.shape, np.float32)
    own = np.broadcast_to(np.asarray(volume, np.float64), positions.shape[1])
    for frame, points in enumerate(positions):
        to_particles = weights(points, scene)
        to_nodes = to_particles.T
        at_nodes = to_nodes @ own
        inverse = np.divide(1.0, at_nodes, out=np.zeros_like(at_nodes), where=at_nodes > 0.0)
        field = values[frame].astype(np.float64).reshape(len(points), -1)
        for _ in range(passes):
            field = to_particles @ ((to_nodes @ (own[:, None] * field)) * inverse[:, None])
        found[frame] = field.reshape(values.shape[1:])
    return found


def density(positions: Floats, mass: Floats, scene: Scene) -> NDArray[np.float32]:
    """Density around each particle [kg/m^3] in frames, shape [T, N].

    positions: [m], shape [T, N, D]; mass: of each particle [kg, per metre of width in 2D], shape [N].
    """
    found = np.empty(positions.shape[:2], np.float32)
    for frame, points in enumerate(positions):
        boxes, volumes = filled(points, scene)
        to_particles = weights(points, scene)
        at_nodes = to_particles.T @ mass.astype(np.float64)
        space = weights(boxes, scene).T @ volumes
        found[frame] = (to_particles @ at_nodes) / (to_particles @ space)
    return smoothed(found, positions, mass, scene, passes=1)


def filled(positions: Floats, scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres [m], shape [M, D], and volumes [m^D], shape [M], of the little boxes that particles at `positions` fill.

    Of a box that a solid cuts at the distance d of its centre the share 1 / 2 + d / edge is free, and of one that holds
    a particle at least HELD.
    """
    edge, size = scene.particle_spacing, np.array(scene.domain.size)
    counts = np.round(size / edge).astype(int)
    at = np.clip((positions.astype(np.float64) / edge).astype(int), 0, counts - 1)
    # Where the particles are, and a border that the closing needs.
    low, high = np.maximum(at.min(axis=0) - 2, 0), np.minimum(at.max(axis=0) + 3, counts)
    full = np.zeros(high - low, bool)
    full[tuple((at - low).T)] = True
    around = np.ones((3,) * scene.dimension, bool)
    # Beyond a wall all is solid: the boxes along it are not eroded.
    occupied = full.copy()
    full = ndimage.binary_erosion(ndimage.binary_dilation(full, around), around, border_value=True)
    centres = (np.argwhere(full) + low + 0.5) * edge
    volumes = np.full(len(centres), edge**scene.dimension)
    surface = surface_of(scene)
    if surface is not None:
        distance = nearest(surface, centres).distance
        volumes *= np.clip(0.5 + distance / edge, np.where(occupied[full], MIN_FREE_SHARE, 0.0), 1.0)
    return centres, volumes
