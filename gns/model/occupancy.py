"""How much of the cells of the background grid walls, ground and baffles leave no room in, differentiable."""

import math

import torch
from torch import Tensor

from gns.model.boxes import Boxes, rotated
from gns.model.grid import UP, Stencil
from gns.model.ground import Below
from gns.model.state import Conditions, Ground

CORNERS = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))
"""Of a box in the plane in which it is turned, over its half, counterclockwise."""


def occupancy(stencil: Stencil, conditions: Conditions) -> Tensor:
    """Share of each grid node's cell that is no room for material [-], shape [B * nodes, 1], as in `gns.model.grid`.

    A node's cell is the box of that edge around it. What is no room: what lies beyond the walls of the box, below the
    ground and in baffles, which take their share of what the other two leave.
    """
    begin, end = stencil.cells(conditions.size)
    length = [last - first for first, last in zip(begin, end, strict=True)]
    axes = "xyz"[: len(length)]
    room = torch.einsum(f"{','.join('b' + axis for axis in axes)}->b{axes}", *(each / stencil.cell for each in length))
    if conditions.ground is not None:
        room = room * (1.0 - _buried(conditions.ground, begin, end))
    if conditions.baffles is not None:
        boxes = Boxes.of_conditions(conditions)
        inverse = [torch.where(each > 0.0, 1.0 / torch.where(each > 0.0, each, 1.0), 0.0) for each in length]
        parts = {}
        for axis, name in enumerate(axes):
            lower, upper = (boxes.middle[:, :, axis, None] + sign * boxes.half[:, :, axis, None] for sign in (-1, 1))
            overlap = torch.minimum(upper, end[axis].unsqueeze(1)) - torch.maximum(lower, begin[axis].unsqueeze(1))
            parts[name] = overlap.clamp(min=0.0) * inverse[axis].unsqueeze(1)
        if conditions.baffle_turn is not None:
            plane = axes[0] + axes[-1]
            area = _area(boxes, _edges(begin[0], end[0]), _edges(begin[-1], end[-1]))
            parts = {name: part for name, part in parts.items() if name not in plane}
            parts[plane] = area * inverse[0][:, None, :, None] * inverse[-1][:, None, None, :]
        terms = ",".join("bk" + name for name in parts)
        room = room * (1.0 - torch.einsum(f"{terms}->b{axes}", *parts.values())).clamp(min=0.0)
    return (1.0 - room).clamp(min=0.0).reshape(-1, 1)


def _edges(begin: Tensor, end: Tensor) -> Tensor:
    """Where cells that follow each other along an axis meet [m], shape [B, X + 1], of their begins and ends [B, X]."""
    return torch.cat((begin[:, :1], torch.minimum(end, end[:, -1:])), dim=1)


def _area(boxes: Boxes, x: Tensor, z: Tensor) -> Tensor:
    """Area of turned boxes, in the plane in which they are turned, in each cell [m^2], shape [B, K, X, Z].

    x, z: edges of the cells along the first and the last axis [m], shapes [B, X + 1] and [B, Z + 1]. F(x, z), the area
    at smaller coordinates than these, is by Green's theorem -sum_e int min(zeta_e(s) - z, 0) ds over the edges e of the
    box, each with its ordinate zeta_e(s) at abscissas s up to x; a cell has the mixed difference of F.
    """
    assert boxes.cosine is not None
    assert boxes.sine is not None
    half = torch.stack((boxes.half[..., 0], boxes.half[..., -1]), dim=-1)
    corners = half.unsqueeze(2) * half.new_tensor(CORNERS)
    vertices = rotated(corners, boxes.cosine.unsqueeze(2), boxes.sine.unsqueeze(2))
    # Farther than any vertex, where the gradient would be one of two.
    extent = 1.1 * vertices.detach().abs().amax(dim=2)
    # From the middle of the box: [B, K, 1, X + 1].
    x, z = (
        (edges.unsqueeze(1) - boxes.middle[..., axis, None]).clamp(-extent[..., axis, None], extent[..., axis, None])
        for axis, edges in ((0, x), (-1, z))
    )
    x, z = x.unsqueeze(2), z.unsqueeze(2).unsqueeze(3)
    (s0, zeta0), (s1, zeta1) = (each.unsqueeze(3).unbind(4) for each in (vertices, vertices.roll(-1, dims=2)))
    run = s1 - s0
    rise = torch.where(run == 0.0, 0.0, (zeta1 - zeta0) / torch.where(run == 0.0, 1.0, run))
    first, last = torch.minimum(s0, x), torch.minimum(s1, x)
    g0 = (zeta0 + (first - s0) * rise).unsqueeze(4) - z
    # An edge across the first axis has no rise, but a slope with its turn.
    g1 = torch.where(s1 <= x, zeta1, zeta0 + (last - s0) * rise).unsqueeze(4) - z
    low0, low1 = g0.clamp(max=0.0), g1.clamp(max=0.0)
    mixed = (low0 < 0.0) != (low1 < 0.0)
    across = (g1 - g0).abs()
    # The mean of min(g, 0) over an edge on which g is linear.
    crossing = -0.5 * (low0 + low1).square() / torch.where(mixed, across, 1.0)
    mean = torch.where(mixed, crossing, 0.5 * (low0 + low1))
    area = -((last - first).unsqueeze(4) * mean).sum(dim=2)
    return area.diff(dim=2).diff(dim=3)


def _buried(ground: Ground, begin: list[Tensor], end: list[Tensor]) -> Tensor:
    """Share of the cells of the nodes that lies below the ground [-], shape [B, X, Y(, Z)].

    begin, end: of the part of a cell that is in the box along each axis [m], shape [B, nodes along it].
    """
    samples = len(begin[0])
    plan = [axis for axis in range(len(begin)) if axis != UP]
    middles = [0.5 * (begin[axis] + end[axis]) for axis in plan]
    shape = [middle.shape[1] for middle in middles]
    spread = [
        middle.view(samples, *(-1 if other == number else 1 for other in range(len(plan)))).expand(samples, *shape)
        for number, middle in enumerate(middles)
    ]
    spread.insert(UP, torch.zeros_like(spread[0]))
    points = torch.stack([each.reshape(-1) for each in spread], dim=1)
    batch = torch.arange(samples, device=points.device).repeat_interleave(math.prod(shape))
    elevation = Below(points, ground, batch).value(ground.elevation).view(samples, *shape).unsqueeze(2)
    low, high = (each[UP].view(samples, 1, -1, *(1,) * (len(shape) - 1)) for each in (begin, end))
    below = torch.minimum((elevation - low).clamp(min=0.0), high - low)
    return torch.where(high > low, below / torch.where(high > low, high - low, 1.0), 0.0)
