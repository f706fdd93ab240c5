"""The background grid: particles to grid nodes and back with multilinear weights, differentiable in the positions."""

import itertools
import math
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class Stencil:
    """The grid nodes around each particle and their weights.

    Grid values are flat, shape [B * nodes, C], node index fastest in the last axis of `shape`.
    """

    shape: tuple[int, ...]
    """Grid nodes along each axis, walls included."""
    cell: float
    """Edge of a grid cell [m]."""
    samples: int
    """Samples in the batch, B."""
    nodes: Tensor
    """Flat index of the 2^D nodes around each particle, shape [2^D, N]."""
    weights: Tensor
    """Multilinear weights, they sum to one over the first axis, shape [2^D, N]."""

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


def stencil_of(positions: Tensor, size: tuple[float, ...], cell: float, batch: Tensor | None, samples: int) -> Stencil:
    """The stencil of `positions` [m], shape [N, D], on a grid with cells of edge `cell` over the box [0, size]."""
    shape = tuple(math.ceil(length / cell - 1.0e-6) + 1 for length in size)
    scaled = positions / cell
    limit = torch.tensor([count - 2 for count in shape], device=positions.device)
    base = torch.minimum(scaled.detach().floor().long().clamp(min=0), limit)
    above = scaled - base
    strides = [math.prod(shape[axis + 1 :]) for axis in range(len(shape))]
    first = (base * torch.tensor(strides, device=positions.device)).sum(dim=1)
    if batch is not None:
        first = first + batch * math.prod(shape)
    nodes: list[Tensor] = []
    weights: list[Tensor] = []
    for corner in itertools.product((0, 1), repeat=len(shape)):
        nodes.append(first + sum(bit * stride for bit, stride in zip(corner, strides, strict=True)))
        weight = torch.ones_like(scaled[:, 0])
        for axis, bit in enumerate(corner):
            weight = weight * (above[:, axis] if bit else 1.0 - above[:, axis])
        weights.append(weight)
    return Stencil(shape=shape, cell=cell, samples=samples, nodes=torch.stack(nodes), weights=torch.stack(weights))


def column_features(stencil: Stencil, volume: Tensor) -> Tensor:
    """The column of material through each node: [packing, overburden, height, slope], shape [B * nodes, D + 2].

    volume: of each particle [m^D], shape [N].

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
