"""The background grid: particles to grid nodes and back with multilinear weights, differentiable in the positions."""

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass

import torch
from torch import Tensor

UP = 1
"""The axis that points up."""
REFERENCE_HEIGHT = 0.1
"""Unit of overburden and height [m]."""
MARGIN = 3
"""Nodes around the particles that a grid has at least, where the box does not end."""
MULTIPLE = 4
"""Numbers of nodes are multiples of this, so that grids of few shapes recur."""


@dataclass(frozen=True, kw_only=True)
class Stencil:
    """The grid nodes around each particle and their weights.

    The grid of a sample covers its particles alone. Nodes lie at whole multiples of the cell from the box's lower
    corner. Grid values are flat, shape [B * nodes, C], node index fastest in the last axis of `shape`.
    """

    shape: tuple[int, ...]
    """Grid nodes along each axis, of all samples alike."""
    origin: Tensor
    """The first node of each sample, counted from the lower corner of its box along each axis, int64, shape [B, D]."""
    cell: float
    """Edge of a grid cell [m]."""
    nodes: Tensor
    """Flat index of the 2^D nodes around each particle, shape [2^D, N]."""
    weights: Tensor
    """Multilinear weights, they sum to one over the first axis, shape [2^D, N]."""
    own: Tensor | None = None
    """1 at the nodes that a sample would have alone and 0 elsewhere, shape [B, *`shape`, 1]; absent where all are."""

    @property
    def samples(self) -> int:
        """Samples in the batch, B."""
        return len(self.origin)

    def scatter(self, values: Tensor) -> Tensor:
        """Sum values of particles [N, C] into the nodes [B * nodes, C]."""
        grid = values.new_zeros(self.samples * math.prod(self.shape), values.shape[1])
        for node, weight in zip(self.nodes, self.weights, strict=True):
            grid = grid.index_add(0, node, values * weight.unsqueeze(1))
        return grid

    def gather(self, grid: Tensor) -> Tensor:
        """Interpolate values of nodes [B * nodes, C] at the particles [N, C]."""
        return torch.stack(
            [
                grid.index_select(0, node) * weight.unsqueeze(1)
                for node, weight in zip(self.nodes, self.weights, strict=True)
            ]
        ).sum(dim=0)

    def coordinates(self, like: Tensor) -> list[Tensor]:
        """Positions of the nodes along each axis [m], each of shape [B, nodes along it], of the type of `like`."""
        return [
            self.cell * (self.origin[:, axis, None] + torch.arange(count, device=like.device)).to(like.dtype)
            for axis, count in enumerate(self.shape)
        ]

    def within(self, field: Tensor, size: Tensor, axes: Iterable[int]) -> Tensor:
        """A field [B, X, Y(, Z), ...] whose values beyond the walls are those of the last node before the wall.

        size: of the boxes [m], shape [B, D]; axes: across which. A derivative at a wall then has no step in it.
        """
        for axis in axes:
            count = field.shape[axis + 1]
            node = self.origin[:, axis, None] + torch.arange(count, device=field.device)
            last = (size[:, axis, None].detach() / self.cell + 1.0e-4).floor().long()
            index = torch.minimum(node.clamp(min=0), last) - self.origin[:, axis, None]
            shape = [len(index), *(count if other == axis + 1 else 1 for other in range(1, field.dim()))]
            field = field.gather(axis + 1, index.view(shape).expand(field.shape))
        return field

    def cells(self, size: Tensor) -> tuple[list[Tensor], list[Tensor]]:
        """Where the nodes' cells, of the same edge around them, begin and end in the box [0, size] along each axis [m].

        size: [m], shape [B, D]; each of the results is of shape [B, nodes along an axis].
        """
        nodes = self.coordinates(size)
        begin = [(node - 0.5 * self.cell).clamp(min=0.0) for node in nodes]
        end = [torch.minimum(node + 0.5 * self.cell, size[:, axis, None]) for axis, node in enumerate(nodes)]
        return begin, [torch.maximum(first, last) for first, last in zip(begin, end, strict=True)]


def stencil_of(positions: Tensor, size: Tensor, cell: float, batch: Tensor | None) -> Stencil:
    """The stencil of `positions` [m], shape [N, D], on grids with cells of edge `cell` in the boxes [0, size].

    size: [m], shape [B, D]; batch: sample of each particle, shape [N], absent where there is one.
    """
    dimension = positions.shape[1]
    scaled = positions / cell
    base = scaled.detach().floor().long()
    index = torch.zeros(len(base), dtype=torch.long, device=base.device) if batch is None else batch
    spread = index.unsqueeze(1).expand(-1, dimension)
    far = torch.zeros(len(size), dimension, dtype=torch.long, device=base.device)
    first = far.scatter_reduce(0, spread, base, "amin", include_self=False)
    last = far.scatter_reduce(0, spread, base, "amax", include_self=False)
    origin = (first - MARGIN).clamp(min=-1)
    counts = -((origin - last - MARGIN - 2) // MULTIPLE) * MULTIPLE
    shape = tuple(int(count) for count in counts.amax(dim=0).tolist())
    own = None
    if len(size) > 1:
        own = torch.ones(len(size), *shape, 1, dtype=positions.dtype, device=positions.device)
        for axis, count in enumerate(shape):
            part = torch.arange(count, device=positions.device) < counts[:, axis, None]
            own = own * part.view(len(size), *(-1 if other == axis else 1 for other in range(dimension)), 1)
    above = scaled - base
    strides = [math.prod(shape[axis + 1 :]) for axis in range(dimension)]
    inside = base - origin.index_select(0, index)
    corner = (inside * torch.tensor(strides, device=base.device)).sum(dim=1) + index * math.prod(shape)
    nodes: list[Tensor] = []
    weights: list[Tensor] = []
    for bits in itertools.product((0, 1), repeat=dimension):
        nodes.append(corner + sum(bit * stride for bit, stride in zip(bits, strides, strict=True)))
        weight = torch.ones_like(scaled[:, 0])
        for axis, bit in enumerate(bits):
            weight = weight * (above[:, axis] if bit else 1.0 - above[:, axis])
        weights.append(weight)
    return Stencil(
        shape=shape, origin=origin, cell=cell, nodes=torch.stack(nodes), weights=torch.stack(weights), own=own
    )


def column_features(stencil: Stencil, volume: Tensor, size: Tensor) -> Tensor:
    """The column of material through each node: [packing, overburden, height, slope], shape [B * nodes, D + 2].

    volume: of each particle [m^D], shape [N]; size: of the boxes [m], shape [B, D].

    | packing    | volume of the particles over the volume of the node's cell [-]             |
    | overburden | height of the column of material above the node [-], in REFERENCE_HEIGHTs |
    | height     | height of the whole column at the node's x (and z) [-], likewise          |
    | slope      | derivative of that height along x (and z) [-], zero along y: left out     |

    A released column and a settled deposit differ in the stress, which is no feature of the particles. The overburden
    is its vertical part at rest, and the slope of the surface drives the flow.
    """
    shape, cell = stencil.shape, stencil.cell
    dimension = len(shape)
    filled = stencil.scatter(volume.unsqueeze(1)).view(stencil.samples, *shape) / cell**dimension
    # A node on a wall stands for half a cell: divide, or the material beside a wall would look loose.
    begin, end = stencil.cells(size)
    shares = [
        ((last - first) / cell)
        .clamp(min=LEAST_SHARE)
        .view(len(size), *(-1 if other == axis else 1 for other in range(dimension)))
        for axis, (first, last) in enumerate(zip(begin, end, strict=True))
    ]
    layers = filled * (cell / REFERENCE_HEIGHT)
    packing = filled / shares[UP]
    for share in (share for axis, share in enumerate(shares) if axis != UP):
        layers, packing = layers / share, packing / share
    above = layers.flip(UP + 1).cumsum(UP + 1).flip(UP + 1) - 0.5 * layers
    height = layers.sum(UP + 1, keepdim=True)
    level = [axis for axis in range(dimension) if axis != UP]
    extended = stencil.within(height, size, level)
    slopes = [torch.gradient(extended, spacing=cell / REFERENCE_HEIGHT, dim=axis + 1)[0] for axis in level]
    channels = [packing, above, height.expand_as(filled), *(slope.expand_as(filled) for slope in slopes)]
    return torch.stack(channels, dim=-1).view(-1, dimension + 2)


LEAST_SHARE = 0.25
"""Of a cell that a wall cuts off, at least this counts as room: what lies on the wall is not infinitely dense."""
