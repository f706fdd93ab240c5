"""The background grid: particles to nodes and back, the column of material and the free space at a node.

Weights are multilinear; everything is differentiable in the positions, the ground and the baffles.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import reduce

import torch
from torch import Tensor

from datasets.geometry.ground import plan_axes
from gns.settings import UP
from gns.surroundings.solids import Below, Boxes, rotated
from gns.surroundings.state import Conditions, Ground, Input

REFERENCE_HEIGHT = 0.1  # unit of overburden and height [m]
MARGIN = 3  # least number of nodes around the particles, except where the box ends
MULTIPLE = 4  # numbers of nodes are multiples of this, so that few grid shapes occur
LEAST_SHARE = 0.25  # least free share of a cell cut off by a wall: the material on the wall is not that dense
CORNERS = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))  # of a box in its plane over its half, counterclockwise


@dataclass(frozen=True, kw_only=True)
class Stencil:
    """The grid nodes around each particle and their weights. A sample's grid covers only its particles, with nodes at
    multiples of the cell from the box's lower corner. Values are flat, [B * nodes, C], the last axis fastest."""

    shape: tuple[int, ...]  # grid nodes along each axis, the same for all samples
    origin: Tensor  # the first node of each sample, counted from the lower corner of its box, int64, shape [B, D]
    cell: float  # edge of a grid cell [m]
    nodes: Tensor  # flat index of the 2^D nodes around each particle, shape [2^D, N]
    weights: Tensor  # multilinear weights, they sum to one over the first axis, shape [2^D, N]
    own: Tensor | None = None  # 1 at nodes that a sample alone would have, else 0, [B, *`shape`, 1]; None if all are

    @property
    def samples(self) -> int:
        return len(self.origin)

    def scatter(self, values: Tensor) -> Tensor:
        """Sum values of particles [N, C] into the nodes [B * nodes, C]."""
        grid = values.new_zeros(self.samples * math.prod(self.shape), values.shape[1])
        return grid.index_add_(0, self.nodes.flatten(), (self.weights.unsqueeze(2) * values).flatten(0, 1))

    def gather(self, grid: Tensor) -> Tensor:
        """Interpolate values of nodes [B * nodes, C] at the particles [N, C]."""
        around = grid.index_select(0, self.nodes.flatten()).view(*self.nodes.shape, -1)
        return (self.weights.unsqueeze(2) * around).sum(dim=0)

    def coordinates(self, like: Tensor) -> list[Tensor]:
        """Positions of the nodes along each axis [m], each of shape [B, nodes along it], of the type of `like`."""
        counted = [torch.arange(count, device=like.device) for count in self.shape]
        return [self.cell * (self.origin[:, i, None] + nodes).to(like.dtype) for i, nodes in enumerate(counted)]

    def within(self, field: Tensor, size: Tensor, axes: Iterable[int]) -> Tensor:
        """A field [B, X, Y(, Z), ...] whose values beyond walls across `axes` repeat the last node, so that a
        derivative at a wall has no step. size: of the boxes [m], shape [B, D]."""
        for axis in axes:
            count = field.shape[axis + 1]
            node = self.origin[:, axis, None] + torch.arange(count, device=field.device)
            last = (size[:, axis, None].detach() / self.cell + 1.0e-4).floor().long()
            index = torch.minimum(node.clamp(min=0), last) - self.origin[:, axis, None]
            shape = [len(index), *(count if other == axis + 1 else 1 for other in range(1, field.dim()))]
            field = field.gather(axis + 1, index.view(shape).expand(field.shape))
        return field

    def cells(self, size: Tensor) -> tuple[list[Tensor], list[Tensor]]:
        """Begin and end of the nodes' cells in the box [0, size] along each axis [m], each [B, nodes along it]."""
        nodes = self.coordinates(size)
        begin = [(node - 0.5 * self.cell).clamp(min=0.0) for node in nodes]
        end = [torch.minimum(node + 0.5 * self.cell, size[:, axis, None]) for axis, node in enumerate(nodes)]
        return begin, [torch.maximum(first, last) for first, last in zip(begin, end, strict=True)]


def stencil_of(positions: Tensor, size: Tensor, cell: float, batch: Tensor | None) -> Stencil:
    """The stencil of `positions` [m], shape [N, D], on grids with cells of edge `cell` in the boxes [0, size].
    size: [m], shape [B, D]; batch: sample of each particle, shape [N], None if there is only one."""
    scaled, dimension = positions / cell, positions.shape[1]
    base = scaled.detach().floor().long()
    index = torch.zeros_like(base[:, 0]) if batch is None else batch
    sample, none = index.unsqueeze(1).expand(-1, dimension), base.new_zeros(size.shape)
    first, last = (none.scatter_reduce(0, sample, base, end, include_self=False) for end in ("amin", "amax"))
    origin = (first - MARGIN).clamp(min=-1)
    counts = -((origin - last - MARGIN - 2) // MULTIPLE) * MULTIPLE
    shape = tuple(int(count) for count in counts.amax(dim=0).tolist())
    inside = None
    if len(size) > 1:
        parts = [torch.arange(count, device=base.device) < counts[:, axis, None] for axis, count in enumerate(shape)]
        inside = reduce(torch.mul, (spread(part, axis, dimension) for axis, part in enumerate(parts)))
        inside = inside.unsqueeze(-1).to(scaled)
    above = scaled - base
    strides = torch.tensor([math.prod(shape[axis + 1 :]) for axis in range(dimension)], device=base.device)
    corner = ((base - origin.index_select(0, index)) * strides).sum(dim=1) + index * math.prod(shape)
    bits = torch.cartesian_prod(*[torch.arange(2, device=base.device)] * dimension)
    nodes = corner + (bits * strides).sum(dim=1, keepdim=True)
    weights = reduce(torch.mul, torch.where(bits.unsqueeze(1) > 0, above, 1.0 - above).unbind(dim=2))
    return Stencil(shape=shape, origin=origin, cell=cell, nodes=nodes, weights=weights, own=inside)


def spread(values: Tensor, axis: int, dimension: int) -> Tensor:
    """Values along an axis [B, X] as a field in all axes of space, with one node along the others."""
    return values.view(len(values), *(-1 if other == axis else 1 for other in range(dimension)))


def column_features(stencil: Stencil, conditions: Conditions) -> Tensor:
    """The column of material through each node, shape [B * nodes, D + 2].

    | packing    | volume of the particles over the volume of the node's cell [-]                                |
    | overburden | height of the column above the node, the vertical stress at rest, in REFERENCE_HEIGHTs [-]    |
    | height     | height of the whole column at the node's x (and z), likewise [-]                              |
    | slope      | derivative of that height along x (and z) [-]                                                 |
    """
    size, shape, cell, level = conditions.size, stencil.shape, stencil.cell, plan_axes(len(stencil.shape))
    filled = stencil.scatter(conditions.volume.unsqueeze(1)).view(stencil.samples, *shape) / cell ** len(shape)
    # A node on a wall represents half a cell: undivided, the material beside a wall would look loose.
    shares = [((last - first) / cell).clamp(min=LEAST_SHARE) for first, last in zip(*stencil.cells(size), strict=True)]
    layers, packing = filled * (cell / REFERENCE_HEIGHT), filled / spread(shares[UP], UP, len(shape))
    for axis in level:
        share = spread(shares[axis], axis, len(shape))
        layers, packing = layers / share, packing / share
    above = layers.flip(UP + 1).cumsum(UP + 1).flip(UP + 1) - 0.5 * layers
    height = layers.sum(UP + 1, keepdim=True)
    extended = stencil.within(height, size, level)
    slopes = [torch.gradient(extended, spacing=cell / REFERENCE_HEIGHT, dim=axis + 1)[0] for axis in level]
    channels = [channel.expand_as(filled) for channel in (packing, above, height, *slopes)]
    return torch.stack(channels, dim=-1).view(-1, len(channels))


def occupancy(stencil: Stencil, conditions: Conditions) -> Tensor:
    """Share of each node's cell that lies beyond the walls, below the ground or in baffles [-], shape [B * nodes, 1]. A
    cell is the box with the grid's cell size around its node. Baffles take a share of what walls and ground leave."""
    begin, end = stencil.cells(conditions.size)
    length = [last - first for first, last in zip(begin, end, strict=True)]
    axes = "xyz"[: len(length)]
    room = torch.einsum(f"{','.join('b' + axis for axis in axes)}->b{axes}", *(side / stencil.cell for side in length))
    if conditions.ground is not None:
        room = room * (1.0 - _buried(conditions.ground, begin, end))
    if conditions.baffles is not None:
        boxes = Boxes.of_conditions(conditions)
        inverse = [torch.where(side > 0.0, 1.0 / torch.where(side > 0.0, side, 1.0), 0.0) for side in length]
        parts = {}
        for axis, name in enumerate(axes):
            lower, upper = (boxes.middle[:, :, axis, None] + sign * boxes.half[:, :, axis, None] for sign in (-1, 1))
            overlap = torch.minimum(upper, end[axis].unsqueeze(1)) - torch.maximum(lower, begin[axis].unsqueeze(1))
            parts[name] = overlap.clamp(min=0.0) * inverse[axis].unsqueeze(1)
        if conditions.baffle_turn is not None:
            # Boundaries between successive cells along these axes.
            x, z = (torch.cat((begin[i][:, :1], torch.minimum(end[i], end[i][:, -1:])), dim=1) for i in (0, -1))
            del parts[axes[0]], parts[axes[-1]]
            parts[axes[0] + axes[-1]] = _area(boxes, x, z) * inverse[0][:, None, :, None] * inverse[-1][:, None, None]
        terms = ",".join("bk" + name for name in parts)
        room = room * (1.0 - torch.einsum(f"{terms}->b{axes}", *parts.values())).clamp(min=0.0)
    return (1.0 - room).clamp(min=0.0).reshape(-1, 1)


# Channels of a grid node, from a stencil and the conditions.
CHANNELS = {
    "packing, overburden, height and slope of the column": Input(lambda s: s.dimension + 2, column_features),
    "share of the cell that is no room": Input(lambda s: 1, occupancy),
}


def _area(boxes: Boxes, x: Tensor, z: Tensor) -> Tensor:
    """Area of turned boxes, in the plane in which they are turned, in each cell [m^2], shape [B, K, X, Z].
    x, z: edges of the cells along the first and the last axis [m], [B, X + 1] and [B, Z + 1]. A cell has the mixed
    difference of F(x, z), the area at smaller coordinates, by Green's theorem -sum_e int min(zeta_e(s) - z, 0) ds over
    the edges e of the box, each with its ordinate zeta_e(s) at abscissas s up to x."""
    assert boxes.turn is not None
    half = torch.stack((boxes.half[..., 0], boxes.half[..., -1]), dim=-1)
    corners = half.unsqueeze(2) * half.new_tensor(CORNERS)
    vertices = rotated(corners, *(component.unsqueeze(2) for component in boxes.turn))
    # Beyond any vertex, at which the gradient would be ambiguous.
    extent = 1.1 * vertices.detach().abs().amax(dim=2)
    # Measured from the middle of the box: [B, K, 1, X + 1].
    x, z = (
        (edges.unsqueeze(1) - boxes.middle[..., axis, None]).clamp(-extent[..., axis, None], extent[..., axis, None])
        for axis, edges in ((0, x), (-1, z))
    )
    x, z = x.unsqueeze(2), z.unsqueeze(2).unsqueeze(3)
    (s0, zeta0), (s1, zeta1) = (points.unsqueeze(3).unbind(4) for points in (vertices, vertices.roll(-1, dims=2)))
    run = s1 - s0
    rise = torch.where(run == 0.0, 0.0, (zeta1 - zeta0) / torch.where(run == 0.0, 1.0, run))
    first, last = torch.minimum(s0, x), torch.minimum(s1, x)
    g0 = (zeta0 + (first - s0) * rise).unsqueeze(4) - z
    # An edge across the first axis has no rise, but a derivative with respect to its turn.
    g1 = torch.where(s1 <= x, zeta1, zeta0 + (last - s0) * rise).unsqueeze(4) - z
    low0, low1 = g0.clamp(max=0.0), g1.clamp(max=0.0)
    mixed = (low0 < 0.0) != (low1 < 0.0)
    # The mean of min(g, 0) over an edge on which g is linear.
    crossing = -0.5 * (low0 + low1).square() / torch.where(mixed, (g1 - g0).abs(), 1.0)
    mean = torch.where(mixed, crossing, 0.5 * (low0 + low1))
    area = -((last - first).unsqueeze(4) * mean).sum(dim=2)
    return area.diff(dim=2).diff(dim=3)


def _buried(ground: Ground, begin: list[Tensor], end: list[Tensor]) -> Tensor:
    """Share of the nodes' cells that lies below the ground [-], shape [B, X, Y(, Z)]. begin, end: of the part of a cell
    inside the box along each axis [m], shape [B, nodes along it]."""
    dimension = len(begin)
    middles = [spread(0.5 * (begin[axis] + end[axis]), axis, dimension) for axis in range(dimension)]
    middles[UP] = torch.zeros_like(middles[UP][:, :, :1])
    shape = [len(begin[0]), *(middle.shape[axis + 1] for axis, middle in enumerate(middles))]
    points = torch.stack([middle.expand(shape).flatten() for middle in middles], dim=1)
    batch = torch.arange(shape[0], device=points.device).repeat_interleave(math.prod(shape[1:]))
    elevation = Below(points, ground, batch).value(ground.elevation).view(shape)
    low, high = (spread(bounds[UP], UP, dimension) for bounds in (begin, end))
    below = torch.minimum((elevation - low).clamp(min=0.0), high - low)
    return torch.where(high > low, below / torch.where(high > low, high - low, 1.0), 0.0)
