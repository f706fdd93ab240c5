"""Fewer particles for the same flow: keep some of the particles of each cell, which then carry the volume of all."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class Thinned:
    """The particles that stay, and the volume that each of them stands for."""

    indices: NDArray[np.int64]
    """Indices of the kept particles, ascending, shape [n]."""
    volumes: NDArray[np.float32]
    """Initial volume of each kept particle [m^D], shape [n]; the sum is that of all particles."""


def thin(
    positions: NDArray[np.floating],
    volume: float | NDArray[np.floating],
    *,
    cell: float,
    kept: int,
    rng: np.random.Generator,
) -> Thinned:
    """Keep at random `kept` particles of each cell.

    positions: initial positions [m], shape [N, D]; volume: of the particles [m^D], one for all or shape [N];
    cell: edge of a cell [m]. The particles of a cell (all of them where it holds no more than `kept`) share its volume
    equally. Two draws from `rng` keep different particles of the same flow, which augments the training data.
    """
    cells = np.floor(positions.astype(np.float64) / cell).astype(np.int64)
    cells -= cells.min(axis=0)
    group = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    shuffled = rng.permutation(len(group))
    order = shuffled[np.argsort(group[shuffled], kind="stable")]
    _, first, count = np.unique(group[order], return_index=True, return_counts=True)
    rank = np.arange(len(order)) - np.repeat(first, count)
    each = np.broadcast_to(np.asarray(volume, np.float64), len(group))[order]
    if len(each) and (each == each[0]).all():
        shared = np.repeat(count / np.minimum(count, kept), count) * each
    else:
        shared = np.repeat(np.add.reduceat(each, first) / np.minimum(count, kept), count)
    stays = rank < kept
    ascending = np.argsort(order[stays])
    return Thinned(indices=order[stays][ascending], volumes=shared[stays][ascending].astype(np.float32))
