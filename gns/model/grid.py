"""The background grid: points to grid nodes and back with multilinear weights, differentiable in the positions."""

import itertools
import math
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class Stencil:
    """The grid nodes around each point and the point's share in them.

    Grid values are flat, shape [B * nodes, C], node index fastest in the last axis of `shape`.
    """

    shape: tuple[int, ...]
    """Grid nodes along each axis, walls included."""
    cell: float
    """Edge of a grid cell [m]."""
    samples: int
    """Samples in the batch, B."""
    nodes: Tensor
    """Flat index of the 2^D nodes around each point, shape [2^D, N]."""
    shares: Tensor
    """Multilinear weights, they sum to one over the first axis, shape [2^D, N]."""

    def scatter(self, values: Tensor) -> Tensor:
        """Sum values of points [N, C] into the nodes [B * nodes, C]."""
        grid = values.new_zeros(self.samples * math.prod(self.shape), values.shape[1])
        for node, share in zip(self.nodes, self.shares, strict=True):
            grid = grid.index_add(0, node, values * share.unsqueeze(1))
        return grid

    def gather(self, grid: Tensor) -> Tensor:
        """Interpolate values of nodes [B * nodes, C] at the points [N, C]."""
        return torch.stack(
            [
                grid.index_select(0, node) * share.unsqueeze(1)
                for node, share in zip(self.nodes, self.shares, strict=True)
            ]
        ).sum(dim=0)


def stencil(positions: Tensor, size: tuple[float, ...], cell: float, batch: Tensor | None, samples: int) -> Stencil:
    """The grid of edge about `cell` that spans the box [0, size], seen from `positions` [m], shape [N, D]."""
    shape = tuple(math.ceil(length / cell - 1.0e-6) + 1 for length in size)
    place = positions / cell
    limit = torch.tensor([count - 2 for count in shape], device=positions.device)
    base = torch.minimum(place.detach().floor().long().clamp(min=0), limit)
    above = place - base
    strides = [math.prod(shape[axis + 1 :]) for axis in range(len(shape))]
    first = (base * torch.tensor(strides, device=positions.device)).sum(dim=1)
    if batch is not None:
        first = first + batch * math.prod(shape)
    nodes: list[Tensor] = []
    shares: list[Tensor] = []
    for corner in itertools.product((0, 1), repeat=len(shape)):
        nodes.append(first + sum(bit * stride for bit, stride in zip(corner, strides, strict=True)))
        share = torch.ones_like(place[:, 0])
        for axis, bit in enumerate(corner):
            share = share * (above[:, axis] if bit else 1.0 - above[:, axis])
        shares.append(share)
    return Stencil(shape=shape, cell=cell, samples=samples, nodes=torch.stack(nodes), shares=torch.stack(shares))


def surroundings(points: Stencil, volume: Tensor) -> Tensor:
    """What weighs on each node and where the surface lies: [packing, overburden, height, slope], [B * nodes, D + 2].

    volume: of each point [m^D], shape [N].

    | packing    | volume of the points over the volume of the node's cell [-]             |
    | overburden | height of the column of material above the node [-], in REFERENCE_HEIGHTs |
    | height     | height of the whole column at the node's x (and z) [-], likewise          |
    | slope      | derivative of that height along x (and z) [-], zero along y: left out     |

    A column just let go and a settled heap differ in the stress, which the points do not carry. The overburden is
    its vertical part at rest, and the slope of the surface is what drives the flow.
    """
    shape, cell = points.shape, points.cell
    dimension = len(shape)
    filled = points.scatter(volume.unsqueeze(1)).view(points.samples, *shape) / cell**dimension
    inner = torch.ones_like(filled[:1])
    for axis in range(dimension):
        for wall in (0, -1):
            inner.select(axis + 1, wall).mul_(0.5)
    layers = filled * (cell / REFERENCE_HEIGHT)
    # A node on a wall stands for half a cell: divide, or the material beside a wall would look loose.
    for axis in (axis for axis in range(dimension) if axis != UP):
        half = layers.new_ones(shape[axis])
        half[[0, -1]] = 2.0
        layers = layers * half.view([-1 if other == axis + 1 else 1 for other in range(dimension + 1)])
    above = layers.flip(UP + 1).cumsum(UP + 1).flip(UP + 1) - 0.5 * layers
    height = layers.sum(UP + 1, keepdim=True)
    slopes = [
        torch.gradient(height, spacing=cell / REFERENCE_HEIGHT, dim=axis + 1)[0]
        for axis in range(dimension)
        if axis != UP
    ]
    channels = [filled / inner, above, height.expand_as(filled), *(slope.expand_as(filled) for slope in slopes)]
    return torch.stack(channels, dim=-1).view(-1, dimension + 2)


UP = 1
"""The axis that points up."""
REFERENCE_HEIGHT = 0.1
"""Unit of overburden and height [m]."""
