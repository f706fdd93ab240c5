"""A quantity that varies over a body: given at the nodes of a regular grid, linear along each axis between them.

    f(x) = sum_k w_k(x) f_k,    w_k(x) = prod_a max(0, 1 - |x_a - x_ka| / h_a)

with h the spacing of the grid; a point x outside the grid is moved to its edge.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from datasets.schema import Bounds, Record

Floats = NDArray[np.float64]

VELOCITIES = ("velocity_x", "velocity_y", "velocity_z")
FRICTION = "friction_deg"
NEAR = 1.0e-4  # half of the step of a difference quotient, over the spacing
THICKNESS = "thickness"
"""Vertical thickness of a layer; its field lies in plan."""


@dataclass(frozen=True)
class Grid:
    """A regular grid of nodes, the last axis fastest; K nodes in all."""

    origin: tuple[float, ...]
    """The node with the smallest coordinates [m]."""
    spacing: Annotated[tuple[float, ...], Bounds("positive lengths in m", gt=0.0)]
    """Distance between neighbours along each axis [m]."""
    nodes: Annotated[tuple[int, ...], Bounds("at least one along each axis", gt=0)]
    """Number of nodes along each axis."""

    @property
    def count(self) -> int:
        """K."""
        return math.prod(self.nodes)

    @cached_property
    def axes(self) -> list[Floats]:
        """Coordinates of the nodes along each axis [m]."""
        rows = zip(self.origin, self.spacing, self.nodes, strict=True)
        return [np.asarray(first + step * np.arange(count), np.float64) for first, step, count in rows]

    @cached_property
    def positions(self) -> Floats:
        """Positions of the nodes [m], shape [K, D]."""
        return np.stack(np.meshgrid(*self.axes, indexing="ij"), axis=-1).reshape(-1, len(self.nodes))

    def weights(self, positions: Floats) -> Any:
        """Sparse matrix [N, K] of w_k at `positions` [m], shape [N, D]. Its transpose maps derivatives to nodes."""
        from scipy.sparse import csr_array  # scenes without fields do not need it

        count, node, weight = len(positions), np.zeros((len(positions), 1), np.int32), np.ones((len(positions), 1))
        for axis, (first, spacing, nodes) in enumerate(zip(self.origin, self.spacing, self.nodes, strict=True)):
            place = np.clip((positions[:, axis, None] - first) / spacing, 0.0, nodes - 1)
            low = np.minimum(place.astype(np.int32), max(nodes - 2, 0))
            part, shape = place - low, (count, node.shape[1] * min(nodes, 2))
            # A single node along an axis has no neighbour.
            ends, parts = ((low, low + 1), (1.0 - part, part)) if nodes > 1 else ((low,), (1.0 - part,))
            node = np.stack([node * nodes + end for end in ends], axis=2).reshape(shape)
            weight = np.stack([weight * share for share in parts], axis=2).reshape(shape)
        rows = np.arange(count + 1, dtype=np.int32) * node.shape[1]
        return csr_array((weight.ravel(), node.ravel(), rows), shape=(count, self.count))

    def slopes(self, positions: Floats) -> list[Any]:
        """Derivatives of the `weights` along each axis [1/m], sparse matrices of shape [N, K]."""
        steps = NEAR * np.diag(self.spacing)
        sides = ((self.weights(positions + step), self.weights(positions - step)) for step in steps)
        return [(ahead - behind) / (2.0 * step.max()) for (ahead, behind), step in zip(sides, steps, strict=True)]


@dataclass(frozen=True, kw_only=True)
class Field(Grid, Record):
    """An initial quantity that varies over particles, and replaces the value of their mass or its material."""

    quantity: str
    """`friction_deg`, `velocity_x`, `velocity_y`, `velocity_z`, or `thickness` of a layer, which lies in plan."""
    values: tuple[float, ...]
    """At the nodes, y (in 3D z) fastest: angles in degrees, velocities in m/s, thicknesses in m."""
    mass: int | None = None
    """Index of the mass whose particles it applies to; default: all masses."""

    @property
    def axis(self) -> int:
        """Axis of a velocity."""
        return VELOCITIES.index(self.quantity)

    def at(self, positions: Floats) -> Floats:
        """Values, shape [N], at `positions` [m], shape [N, D]."""
        places = positions[:, ::2] if self.quantity == THICKNESS else positions
        return np.asarray(self.weights(places) @ np.array(self.values))

    def slope(self, positions: Floats) -> Floats:
        """Derivatives, shape [N, D], at `positions` [m], shape [N, D]."""
        return np.stack([slopes @ np.array(self.values) for slopes in self.slopes(positions)], axis=1)
