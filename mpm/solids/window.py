"""Boxes of cells in which lists are kept: around the faces of solids, or around some nodes."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datasets.geometry.surface import Surface
from datasets.scene import Domain
from mpm.arrays.layout import PADDING, node_shape

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class Window:
    """A box of cells, and of the nodes at their lowest corners; D dimensions."""

    low: tuple[int, ...]
    """The lowest node, as the grid counts from its first padding node, shape [D]."""
    shape: tuple[int, ...]
    """Cells along each axis, shape [D]."""
    cell: float
    """[m]."""

    @property
    def count(self) -> int:
        """Cells in it, C."""
        return math.prod(self.shape)

    def positions(self, numbers: Integers) -> Floats:
        """Of the nodes with these numbers [m], shape [N, D]."""
        index = np.stack(np.unravel_index(numbers, self.shape), axis=-1)
        return np.asarray((index + np.array(self.low) - PADDING) * self.cell)

    def numbers(self, nodes: Integers) -> Integers:
        """Of nodes in it by their indices in the grid, shape [N, D]; shape [N]."""
        return np.asarray(np.ravel_multi_index(tuple((nodes - np.array(self.low)).T), self.shape))

    def nodes(self, numbers: Integers) -> Integers:
        """The indices in the grid, shape [N, D], of the nodes with these numbers, shape [N]."""
        return np.asarray(np.stack(np.unravel_index(numbers, self.shape), axis=-1) + np.array(self.low))


def window_around(domain: Domain, surface: Surface, cutoff: float) -> Window:
    """The cells that may list a face, up to `cutoff` cells from it; none without faces."""
    if not len(surface.corners):
        return Window(low=(0,) * domain.dimension, shape=(0,) * domain.dimension, cell=domain.cell)
    corners = surface.corners.reshape(1, -1, domain.dimension)
    # Of the centre of a cell that lists a face; a step moves a particle by at most a cell.
    farthest = (max(cutoff, 1.0) + 0.5 * math.sqrt(domain.dimension)) * domain.cell
    low, high = (each[0] for each in boxes_around(domain, corners, farthest))
    shape = np.array(node_shape(domain))
    low = np.clip(low, 0, shape - 1)
    high = np.clip(high, low + 1, shape)
    return Window(low=tuple(low.tolist()), shape=tuple((high - low).tolist()), cell=domain.cell)


def window_of(domain: Domain, nodes: Integers) -> Window:
    """The box around nodes by their indices, shape [N, D]."""
    low, high = nodes.min(axis=0), nodes.max(axis=0) + 1
    return Window(low=tuple(low.tolist()), shape=tuple((high - low).tolist()), cell=domain.cell)


def boxes_around(domain: Domain | Window, corners: Floats, limit: float) -> tuple[Integers, Integers]:
    """The boxes [low, high) of cells whose centres may lie within `limit` [m] of corners, [F, K, D]; [F, D] each."""
    low = np.floor((corners.min(axis=1) - limit) / domain.cell - 0.5).astype(np.int64) + PADDING
    high = np.ceil((corners.max(axis=1) + limit) / domain.cell - 0.5).astype(np.int64) + PADDING + 1
    return low, high
