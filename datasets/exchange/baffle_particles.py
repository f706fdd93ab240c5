"""Baffles as other codes have them: stationary particles that fill a box; and boxes found again in such particles."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from datasets.errors import InputError
from datasets.scene import Baffle

LINK = 2.0
"""Particles closer than so many spacings belong together: even of those strewn at random none stays alone."""
DECIMALS = 6
"""Boxes are given to a micrometre: positions are single precision."""
DENSEST_GAP = 4.0
"""Edge, in spacings, of the cubes that must each hold a particle where a box is filled at random."""
SPARSEST = 0.85
"""Fewest particles in a box filled at random, as a share of one per cubed spacing: a disc has 0.79, a ball 0.52."""


def obstacle_particles(baffle: Baffle, spacing: float) -> NDArray[np.float64]:
    """A lattice that fills `baffle`, about `spacing` [m] apart: positions [m], shape [N, D].

    Each particle stands in the middle of its share of the box. There are at least two along each axis, so that the
    thickness can be read from the particles.
    """
    axes = []
    for low, size in zip(baffle.lower, baffle.size, strict=True):
        count = max(2, round(size / spacing))
        axes.append(low + (np.arange(count) + 0.5) * (size / count))
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def clusters(particles: NDArray[np.float64], spacing: float) -> list[NDArray[np.int64]]:
    """Indices of the particles of each connected cluster: positions [m], shape [N, D], and their `spacing` [m]."""
    if len(particles) == 0:
        return []
    # One particle for each half of a spacing will do; all pairs of densely packed ones would fill the memory.
    _, chosen, member = np.unique(np.floor(particles / (spacing / 2)), axis=0, return_index=True, return_inverse=True)
    pairs = cKDTree(particles[chosen]).query_pairs(LINK * spacing, output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs), np.int8), pairs.T), shape=(len(chosen), len(chosen)))
    count, of_chosen = connected_components(links, directed=False)
    labels = of_chosen[member.ravel()]
    order = np.argsort(labels, kind="stable")
    return np.split(order, np.searchsorted(labels[order], np.arange(1, count)))


def baffles_in(particles: NDArray[np.float64], spacing: float) -> tuple[Baffle, ...]:
    """The boxes that stationary particles stand for: positions [m], shape [N, D]; `spacing` of the sand [m].

    A cluster that is a lattice gives its box exactly; one strewn at random over a box gives the box around it. Raises
    InputError for a cluster that is no box along the axes: a ramp, a ball, the walls of a room.
    """
    return tuple(baffle_of(particles[cluster], spacing) for cluster in clusters(particles, spacing))


def baffle_of(particles: NDArray[np.float64], spacing: float) -> Baffle:
    """The box that one cluster of particles fills."""
    box = lattice_box(particles, spacing)
    if box is None:
        box = strewn_box(particles, spacing)
    if box is None:
        low, high = (", ".join(f"{x:.4g}" for x in corner) for corner in (particles.min(axis=0), particles.max(axis=0)))
        raise InputError(
            f"expected stationary particles that fill boxes along the axes, found {len(particles)} from ({low}) "
            f"to ({high}) that do not"
        )
    # Adding 0 makes a zero of -0.
    lower, size = box[0].round(DECIMALS) + 0.0, (box[1] - box[0]).round(DECIMALS)
    return Baffle(lower=tuple(lower.tolist()), size=tuple(size.tolist()))


Box = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Lower and upper corner [m], shape [D] each."""


def lattice_box(particles: NDArray[np.float64], spacing: float) -> Box | None:
    """The box around a lattice, half a step beyond its outermost particles; None where the particles are no lattice.

    An axis with a single layer counts as thick as `spacing`.
    """
    steps, counts = [], []
    for x in np.sort(particles, axis=0).T:
        gaps = np.diff(x)
        wide = gaps > 0.05 * spacing
        if (gaps[~wide] > 1e-3 * spacing).any():
            return None
        counts.append(int(wide.sum()) + 1)
        step = (x[-1] - x[0]) / (counts[-1] - 1) if wide.any() else spacing
        if (abs(gaps[wide] - step) > 0.02 * step).any():
            return None
        steps.append(step)
    low, step = particles.min(axis=0), np.array(steps)
    nodes = np.unique(np.rint((particles - low) / step).astype(np.int64), axis=0)
    if len(nodes) != len(particles) or len(nodes) != np.prod(counts):
        return None
    return low - step / 2, particles.max(axis=0) + step / 2


def strewn_box(particles: NDArray[np.float64], spacing: float) -> Box | None:
    """The box around particles strewn over it at random; None where a part of it is empty."""
    low, high = particles.min(axis=0), particles.max(axis=0)
    if (high <= low).any() or len(particles) < SPARSEST * np.prod((high - low) / spacing):
        return None
    bins = np.maximum(1, np.floor((high - low) / (DENSEST_GAP * spacing))).astype(int)
    counts, _ = np.histogramdd(particles, bins=tuple(bins.tolist()))
    return None if (counts == 0).any() else (low, high)
