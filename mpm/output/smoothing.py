"""Smoothing of particle fields through the grid: stress and pressure without their noise.

The stress of neighbouring particles scatters by as much as its mean, because a quadratic spline cannot distinguish
every arrangement of particles: the sum over a cell's particles moves the nodes, its distribution among them does not.
Fields on the grid are smooth. With w_ip the quadratic B-spline weight of node i at particle p and V_p its volume,

    a_i  = sum_p w_ip V_p a_p / sum_p w_ip V_p          (particles to nodes)
    a_p' = sum_i w_ip a_i                               (and back)

which preserves constant fields, and the volume integral of any field: sum_p V_p a_p' = sum_i (sum_p w_ip V_p) a_i =
sum_p V_p a_p. It is applied PASSES times.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from datasets.scene import Scene
from mpm.arrays.layout import PADDING, node_shape

PASSES = 2  # how often stress and pressure are smoothed

Floats = NDArray[np.floating]


def support(scene: Scene, positions: Floats) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """For the 3^D nodes in the support of each of N particles at `positions` [m], shape [N, D], by quadratic B-splines:

    numbers in the flat grid and weights w_ip, shape [N, 3^D], and x_i - x_p [cells], shape [N, 3^D, D]."""
    cell, dimension = scene.domain.cell, scene.dimension
    x_cells = positions.astype(np.float64) / cell + PADDING
    low = np.floor(x_cells - 0.5)
    f = x_cells - low
    spline = np.stack([0.5 * (1.5 - f) ** 2, 0.75 - (f - 1.0) ** 2, 0.5 * (f - 0.5) ** 2], axis=-1)
    stencil = np.stack(np.meshgrid(*[np.arange(3)] * dimension, indexing="ij"), axis=-1).reshape(-1, dimension)
    weight = np.ones((len(positions), len(stencil)))
    for axis in range(dimension):
        weight *= spline[:, axis, :][:, stencil[:, axis]]
    index = low.astype(np.int64)[:, None, :] + stencil
    nodes = np.ravel_multi_index(tuple(np.moveaxis(index, -1, 0)), node_shape(scene.domain))
    return nodes, weight, stencil - f[:, None]


def weights(positions: Floats, scene: Scene) -> sparse.csr_array:
    """Weights w_ip of nodes i at `positions` p [m], shape [N, D]; shape [N, nodes]."""
    nodes, weight, _ = support(scene, positions)
    starts = np.arange(0, nodes.size + 1, nodes.shape[1])
    shape = len(positions), math.prod(node_shape(scene.domain))
    return sparse.csr_array((weight.ravel(), nodes.ravel(), starts), shape=shape)


def smoothed(values: Floats, positions: Floats, volume: float | Floats, scene: Scene) -> NDArray[np.float32]:
    """Fields of frames, shape [T, N] or [T, N, K], smoothed through the grid; the same shape.

    positions: [m], shape [T, N, D]; volume: of each particle [m^D], one for all or shape [N]."""
    smooth = np.empty(values.shape, np.float32)
    volumes = np.broadcast_to(np.asarray(volume, np.float64), positions.shape[1])
    for frame, points in enumerate(positions):
        to_particles = weights(points, scene)
        to_nodes = to_particles.T
        at_nodes = to_nodes @ volumes
        inverse = np.divide(1.0, at_nodes, out=np.zeros_like(at_nodes), where=at_nodes > 0.0)
        field = values[frame].astype(np.float64).reshape(len(points), -1)
        for _ in range(PASSES):
            field = to_particles @ ((to_nodes @ (volumes[:, None] * field)) * inverse[:, None])
        smooth[frame] = field.reshape(values.shape[1:])
    return smooth
