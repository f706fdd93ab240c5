"""Walls, floor and baffles as geometry: features of their distance, and the projection that keeps particles outside.

Baffles are boxes, `baffles` [m], shape [B, K, 2, D]: lower and upper corner of K boxes in each of B samples. A sample
with fewer has boxes of no size far outside the domain. Everything is differentiable in the corners, as exactly as in
the positions; any number of baffles costs next to nothing, because only the particles near one are processed.
"""

import math

import torch
from torch import Tensor

ROUNDING = 0.1
"""Radius to which edges are rounded for the outward direction of a baffle, as a share of the cutoff radius.

The direction from a sharp edge turns by any angle within any distance, and its gradient would have no bound.
"""
SKIN = 1.0e-5
"""Distance from a face at which particles are held [m]: neither rounding nor the joint of two baffles admits one."""
GRAZE = 1.0e-3
"""A path that cuts off less than this of a baffle's corner passes it [m]."""


def feature_count(dimension: int, with_baffles: bool) -> int:
    """Number of `solid_features`."""
    return 2 * dimension + (1 + dimension if with_baffles else 0)


def solid_features(
    positions: Tensor,
    size: tuple[float, ...],
    baffles: Tensor | None,
    batch: Tensor | None,
    cutoff: float,
    *,
    with_baffles: bool,
) -> Tensor:
    """Features of the solids closer than `cutoff` [m] to the particles: shape [N, `feature_count`].

    positions: [m], shape [N, D]; size: extent of the box [0, size] [m]; batch: sample of each particle, shape [N].

    | distance to the walls | lower ones, then upper ones, over the cutoff, at most 1 [-]            |
    | distance to a baffle  | of the nearest one over the cutoff, at most 1 [-]; only `with_baffles` |
    | outward direction     | see `nearest_baffle`; only `with_baffles`                              |

    Without baffles in the scene, their distance is that of the cutoff.
    """
    walls = torch.cat((positions, positions.new_tensor(size) - positions), dim=1) / cutoff
    parts = [walls.clamp(max=1.0)]
    if with_baffles:
        if baffles is None:
            parts += [torch.ones_like(positions[:, :1]), torch.zeros_like(positions)]
        else:
            distance, direction = nearest_baffle(positions, baffles, batch, cutoff)
            parts += [(distance / cutoff).unsqueeze(1), direction]
    return torch.cat(parts, dim=1)


def nearest_baffle(positions: Tensor, baffles: Tensor, batch: Tensor | None, cutoff: float) -> tuple[Tensor, Tensor]:
    """Signed distance [m], shape [N], and outward direction [-], shape [N, D], of the nearest baffle.

    With q = |x - centre| - half the box, per axis, the distance of a box is |max(q, 0)| outside and max(q), negative,
    inside (the exact distance function of a box, e.g. Ericson, Real-time collision detection, 2004, section 5.1). It
    is cut off at `cutoff` [m]. The direction is the sum of the boxes' outward unit normals n,

        sum_k (w_k^2 / sum_j w_j) n_k        w = max(1 - distance / cutoff, 0)

    so n (1 - distance / cutoff) near a single one. It is continuous where another baffle becomes the nearest, and
    where the last one leaves the cutoff.
    """
    distance = positions.new_full((len(positions),), cutoff)
    direction = torch.zeros_like(positions)
    lower, upper = _corners(baffles, batch)
    x = positions.unsqueeze(1)
    near = ((x > lower - cutoff) & (x < upper + cutoff)).all(dim=2).any(dim=1).nonzero().squeeze(1)
    if len(near) == 0:
        return distance, direction
    x = x.index_select(0, near)
    if batch is not None:
        lower, upper = lower.index_select(0, near), upper.index_select(0, near)
    q = torch.maximum(lower - x, x - upper)
    square = q.clamp(min=0.0).square().sum(dim=2)
    outside = square > 0.0
    # The root has no slope at zero: on the surface the distance is that to the face.
    distances = torch.where(outside, torch.where(outside, square, 1.0).sqrt(), q.max(dim=2).values)
    weight = (1.0 - distances / cutoff).clamp(min=0.0)
    total = weight.sum(dim=1, keepdim=True)
    weight = weight * (weight / torch.where(total > 0.0, total, 1.0))
    sum_of_normals = (weight.unsqueeze(2) * _normals(x, lower, upper, q, ROUNDING * cutoff)).sum(dim=1)
    nearest = distances.min(dim=1).values.clamp(max=cutoff)
    return distance.index_copy(0, near, nearest), direction.index_copy(0, near, sum_of_normals)


def _normals(x: Tensor, lower: Tensor, upper: Tensor, q: Tensor, radius: float) -> Tensor:
    """Outward unit normals [n, K, D] of boxes whose edges are rounded to `radius` [m], at `x` [n, 1, D].

    They point from the box that is smaller by the radius on every side; q: of `nearest_baffle`, [n, K, D].
    """
    half = 0.5 * (upper - lower)
    arm = (q + half.clamp(max=radius)).clamp(min=0.0)
    square = arm.square().sum(dim=2, keepdim=True)
    outside = square > 0.0
    # Deep inside it is the normal of the nearest face.
    face = torch.nn.functional.one_hot(q.argmax(dim=2), q.shape[2]).to(q)
    normal = torch.where(outside, arm / torch.where(outside, square, 1.0).sqrt(), face)
    return torch.where(x < lower + half, -normal, normal)


def keep_out(
    positions: Tensor, before: Tensor, size: tuple[float, ...], baffles: Tensor | None, batch: Tensor | None
) -> Tensor:
    """Positions [m], shape [N, D], of particles that move from `before` towards `positions` and are stopped by solids.

    The walls of the box [0, size] stop them, and so do the baffles: a particle whose path enters a baffle, or crosses
    it, is held at a distance SKIN from the first face on its path, and its motion along that face remains.
    A particle on a face follows it: the gradient in the corner is one. A particle that was inside before counts as
    having been at the nearest face that is free.
    """
    kept = _clamped(positions, size)
    if baffles is None:
        return kept
    lower, upper = _corners(baffles, batch)
    lower, upper = lower - SKIN, upper + SKIN
    with torch.no_grad():
        first, last = torch.minimum(before, kept).unsqueeze(1), torch.maximum(before, kept).unsqueeze(1)
        near = ((first < upper) & (last > lower)).all(dim=2).any(dim=1).nonzero().squeeze(1)
    if len(near) == 0:
        return kept
    point = kept.index_select(0, near)
    lower, upper = (
        corner.expand(len(near), -1, -1) if batch is None else corner.index_select(0, near) for corner in (lower, upper)
    )
    start = _clamped(before.detach().index_select(0, near), size)
    start = _freed(start, size, lower.detach(), upper.detach())
    # Where a box has stopped a particle, its new path is clear of that box, whatever stops it next: a round each.
    for _ in range(baffles.shape[1]):
        box, axis, rises = _entered(start, point.detach(), lower.detach(), upper.detach())
        if not bool((box >= 0).any()):
            break
        row = torch.arange(len(near), device=box.device)
        index = box.clamp(min=0)
        face = torch.where(rises, lower[row, index, axis], upper[row, index, axis]).unsqueeze(1)
        stopped = (axis.unsqueeze(1) == torch.arange(len(size), device=box.device)) & (box >= 0).unsqueeze(1)
        point = torch.where(stopped, face, point)
    return kept.index_copy(0, near, point)


def _clamped(points: Tensor, size: tuple[float, ...]) -> Tensor:
    """Positions [n, D] clamped to the box [0, size]."""
    # Bounds as numbers: a clamp to tensors would halve the gradient of a particle that rests exactly on a wall.
    return torch.stack([points[:, axis].clamp(0.0, length) for axis, length in enumerate(size)], dim=1)


def _entered(start: Tensor, end: Tensor, lower: Tensor, upper: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The box that each path from `start` to `end` [n, D] enters first, -1 where none; along which axis; if it rises.

    By the slab method (Kay and Kajiya 1986): the path is inside between the last of the axes' entries and the first
    of their exits. lower, upper: [m], shape [n, K, D].
    """
    path = (end - start).unsqueeze(1)
    x = start.unsqueeze(1)
    still = path == 0.0
    divisor = torch.where(still, 1.0, path)
    entry, leave = (lower - x) / divisor, (upper - x) / divisor
    between = (x > lower) & (x < upper)
    entry, leave = (
        torch.where(still, torch.where(between, -math.inf, math.inf), torch.minimum(entry, leave)),
        torch.where(still, torch.where(between, math.inf, -math.inf), torch.maximum(entry, leave)),
    )
    entered, axis = entry.max(dim=2)
    cut = (leave.min(dim=2).values.clamp(max=1.0) - entered) * path.norm(dim=2)
    ended_inside = ((end.unsqueeze(1) > lower) & (end.unsqueeze(1) < upper)).all(dim=2)
    hit = ended_inside | ((entered >= 0.0) & (cut > GRAZE))
    earliest, box = torch.where(hit, entered, math.inf).min(dim=1)
    axis = axis.gather(1, box.unsqueeze(1)).squeeze(1)
    rises = path.squeeze(1).gather(1, axis.unsqueeze(1)).squeeze(1) > 0.0
    return torch.where(earliest < math.inf, box, -1), axis, rises


def _freed(points: Tensor, size: tuple[float, ...], lower: Tensor, upper: Tensor) -> Tensor:
    """Positions [n, D], those inside a box moved to its nearest face that neither a wall nor another box covers."""
    inside = ((points.unsqueeze(1) > lower) & (points.unsqueeze(1) < upper)).all(dim=2)
    stuck = inside.any(dim=1).nonzero().squeeze(1)
    if len(stuck) == 0:
        return points
    point, lower, upper = points[stuck], lower[stuck], upper[stuck]
    row, box = torch.arange(len(stuck), device=points.device), inside[stuck].int().argmax(dim=1)
    faces = torch.stack((lower[row, box], upper[row, box]), dim=1)
    ends = point.new_tensor(size)
    # One candidate for each of the 2 D faces [n, 2, D], moved along one axis: [n, 2, D, D].
    along = torch.eye(len(size), dtype=torch.bool, device=points.device)
    moved = torch.where(along, faces.unsqueeze(3), point.view(-1, 1, 1, len(size)))
    others = torch.arange(lower.shape[1], device=points.device) != box.unsqueeze(1)
    within = (moved.unsqueeze(3) > lower[:, None, None]) & (moved.unsqueeze(3) < upper[:, None, None])
    covered = (within.all(dim=4) & others[:, None, None]).any(dim=3) | (faces < 0.0) | (faces > ends)
    effort = (faces - point.unsqueeze(1)).abs() + covered * ends.norm()
    best = effort.flatten(1).argmin(dim=1)
    return points.index_copy(0, stuck, moved.flatten(1, 2)[row, best])


def occupancy(
    shape: tuple[int, ...],
    cell: float,
    size: tuple[float, ...],
    baffles: Tensor | None,
    samples: int,
    like: Tensor | None = None,
) -> Tensor:
    """Share of each grid node's cell that baffles cover [-], shape [samples * nodes, 1], as in `gns.model.grid`.

    shape, cell, size: of the grid, its edge [m] and the box that it spans [m]. A node's cell is the box of that edge
    around it, as far as it is in the domain. like: without baffles, type and device of the zeros.
    """
    nodes = math.prod(shape)
    if baffles is None:
        return torch.zeros(samples * nodes, 1) if like is None else like.new_zeros(samples * nodes, 1)
    covered = baffles.new_ones(*baffles.shape[:2], *(1 for _ in shape))
    for axis, (count, length) in enumerate(zip(shape, size, strict=True)):
        middle = cell * torch.arange(count, dtype=baffles.dtype, device=baffles.device)
        begin, end = (middle - 0.5 * cell).clamp(min=0.0), (middle + 0.5 * cell).clamp(max=length)
        lower, upper = baffles[:, :, 0, axis].unsqueeze(2), baffles[:, :, 1, axis].unsqueeze(2)
        overlap = (torch.minimum(upper, end) - torch.maximum(lower, begin)).clamp(min=0.0)
        # The last node can lie so far beyond the wall that nothing of its cell is in the domain.
        share = overlap / torch.where(end > begin, end - begin, 1.0)
        covered = covered * share.view(*share.shape[:2], *(-1 if other == axis else 1 for other in range(len(shape))))
    return covered.sum(dim=1).view(samples * nodes, 1)


def _corners(baffles: Tensor, batch: Tensor | None) -> tuple[Tensor, Tensor]:
    """Lower and upper corners of the boxes in each particle's sample [m], shape [N or 1, K, D]."""
    boxes = baffles if batch is None else baffles.index_select(0, batch)
    return boxes[:, :, 0], boxes[:, :, 1]
