"""Priors of the values of an unknown field: smooth over the nodes of a grid, or independent over zones."""

import math
from collections.abc import Sequence
from functools import cached_property, reduce
from typing import Any

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from datasets.scene.grid_field import Floats, Grid

COLUMNS = 256  # right-hand sides that are solved for at a time


class ZonePrior:
    """Independent normal values of mean 0, one for each of K zones: like `FieldPrior` with W = K."""

    def __init__(self, grid: Grid, deviation: float) -> None:
        self.deviation, self.size = deviation, grid.count

    def field(self, white: Floats) -> Floats:
        """u [K, ...] of w [K, ...]."""
        return self.deviation * white

    white = field


class FieldPrior:
    """A Gaussian field of mean 0 on the K nodes of a grid, as a linear function of W independent normal numbers."""

    def __init__(self, grid: Grid, deviation: float, lengths: Sequence[float]) -> None:
        """deviation: standard deviation at every node; lengths: correlation lengths along each axis [m]."""
        self.grid, self.deviation = grid, deviation
        # Along an axis with one node the field does not vary.
        dimension = sum(count > 1 for count in grid.nodes)
        scales = np.array(lengths) / math.sqrt(8.0 * (2.0 - 0.5 * dimension))  # nu
        sides = zip(grid.nodes, lengths, grid.spacing, strict=True)
        margins = [0 if count == 1 else math.ceil(length / step) for count, length, step in sides]
        shape = [count + 2 * margin for count, margin in zip(grid.nodes, margins, strict=True)]
        masses = [lumped_mass(count, step) for count, step in zip(shape, grid.spacing, strict=True)]
        operator = mass = reduce(sparse.kron, masses)
        for axis, (count, step) in enumerate(zip(shape, grid.spacing, strict=True)):
            factors = [stiffness(count, step) if other == axis else lumped for other, lumped in enumerate(masses)]
            operator = operator + scales[axis] ** 2 * reduce(sparse.kron, factors)
        self.root_mass: Floats = np.sqrt(mass.diagonal())
        self.operator = sparse.csc_array(operator)
        self.factor = splu(self.operator)
        inner = [slice(margin, margin + count) for margin, count in zip(margins, grid.nodes, strict=True)]
        self.inner: NDArray[np.int64] = np.arange(math.prod(shape)).reshape(shape)[tuple(inner)].ravel()
        """Indices of the field's nodes among those of the operator, shape [K]."""

    @property
    def size(self) -> int:
        return len(self.root_mass)

    @cached_property
    def scale(self) -> Floats:
        """Diagonal of S: the stated deviation over that of A w at each node, shape [K]."""
        factors = np.empty(self.grid.count)
        for first in range(0, len(factors), COLUMNS):
            nodes = self.inner[first : first + COLUMNS]
            units = np.zeros((self.size, len(nodes)))
            units[nodes, np.arange(len(nodes))] = 1.0
            rows = self.root_mass[:, None] * self.factor.solve(units)
            factors[first : first + COLUMNS] = self.deviation / np.sqrt((rows**2).sum(axis=0))
        return factors

    def field(self, white: Floats) -> Floats:
        """u [K, ...] of w [W, ...]."""
        flat = white.reshape(self.size, -1)
        values = self.factor.solve(self.root_mass[:, None] * flat)[self.inner] * self.scale[:, None]
        return np.asarray(values.reshape(-1, *white.shape[1:]))

    def white(self, adjoint: Floats) -> Floats:
        """The transpose of `field`: derivatives with respect to w [W, ...] from those with respect to u [K, ...]."""
        flat = adjoint.reshape(self.grid.count, -1)
        full = np.zeros((self.size, flat.shape[1]))
        full[self.inner] = flat * self.scale[:, None]
        derivatives = self.root_mass[:, None] * self.factor.solve(full)
        return np.asarray(derivatives.reshape(-1, *adjoint.shape[1:]))


def lumped_mass(count: int, step: float) -> Any:
    """Sparse lumped mass of linear elements along a line, half an element at its ends."""
    lengths = np.full(count, step)
    if count > 1:
        lengths[[0, -1]] *= 0.5
    return sparse.diags_array(lengths)


def stiffness(count: int, step: float) -> Any:
    """Sparse matrix int phi_i' phi_j' of linear elements along a line."""
    slopes = sparse.diags_array([-np.ones(count - 1), np.ones(count - 1)], offsets=[0, 1], shape=(count - 1, count))
    return slopes.T @ slopes / step
