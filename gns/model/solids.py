"""Walls, ground and baffles as geometry: features of their distance, and the projection that keeps particles outside.

Everything is differentiable in the corners of the baffles and the elevations of the ground, as exactly as in the
positions; any number of baffles costs next to nothing, because only the particles near one are processed.
"""

import math

import torch
from torch import Tensor

from gns.model.grid import UP, Stencil
from gns.model.state import Conditions, Ground

ROUNDING = 0.1
"""Radius to which edges are rounded for the outward direction of a baffle, as a share of the cutoff radius.

The direction from a sharp edge turns by any angle within any distance, and its gradient would have no bound.
"""
SKIN = 1.0e-5
"""Distance from a face at which particles are held [m]: neither rounding nor the joint of two baffles admits one."""
GRAZE = 1.0e-3
"""A path that cuts off less than this of a baffle's corner passes it [m]."""


def feature_count(dimension: int) -> int:
    """Number of `solid_features`."""
    return 2 * dimension + 2 + dimension


def solid_features(positions: Tensor, conditions: Conditions, cutoff: float) -> Tensor:
    """Features of the solids closer than `cutoff` [m] to the particles: shape [N, `feature_count`].

    positions: [m], shape [N, D].

    | distance to the walls  | lower ones, then upper ones, over the cutoff, at most 1 [-]                  |
    | distance to a solid    | of the nearest baffle or ground over the cutoff, at most 1 [-]               |
    | outward direction      | of these: sum_k (w_k^2 / sum_j w_j) n_k, w = max(1 - distance / cutoff, 0)   |
    | friction               | of these: sum_k (w_k^2 / sum_j w_j) mu_k [-]                                 |

    n is a solid's outward unit normal and mu its friction. All of it is continuous where another solid becomes the
    nearest, and where the last one leaves the cutoff.
    """
    size = conditions.of_particles(conditions.size)
    walls = torch.cat((positions, size - positions), dim=1) / cutoff
    features = [walls.clamp(max=1.0)]
    near = []
    if conditions.baffles is not None and conditions.baffle_friction is not None:
        friction = conditions.of_particles(conditions.baffle_friction)
        near.append(nearest_baffle(positions, conditions.baffles, friction, conditions.batch, cutoff))
    if conditions.ground is not None:
        near.append(nearest_ground(positions, conditions.ground, conditions.batch, cutoff))
    if not near:
        features += [torch.ones_like(positions[:, :1]), torch.zeros_like(positions), torch.zeros_like(positions[:, :1])]
    elif len(near) == 1:
        ((distance, direction, friction),) = near
        features += [(distance / cutoff).unsqueeze(1), direction, friction.unsqueeze(1)]
    else:
        distance = torch.stack([each[0] for each in near])
        weight = (1.0 - distance / cutoff).clamp(min=0.0)
        total = weight.sum(dim=0)
        weight = (weight / torch.where(total > 0.0, total, 1.0)).unsqueeze(2)
        directed = torch.stack([torch.cat((each[1], each[2].unsqueeze(1)), dim=1) for each in near])
        features += [(distance.min(dim=0).values / cutoff).unsqueeze(1), (weight * directed).sum(dim=0)]
    return torch.cat(features, dim=1)


def nearest_baffle(
    positions: Tensor, baffles: Tensor, friction: Tensor, batch: Tensor | None, cutoff: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Signed distance [m], shape [N], of the nearest baffle; outward direction [-], [N, D], and friction [-], [N].

    friction: of the baffles, for each particle [N or 1, K]; direction and friction as `solid_features` weighs them.
    With q = |x - centre| - half the box, per axis, the distance of a box is |max(q, 0)| outside and max(q), negative,
    inside (the exact distance function of a box, e.g. Ericson, Real-time collision detection, 2004, section 5.1). It
    is cut off at `cutoff` [m].
    """
    distance = positions.new_full((len(positions),), cutoff)
    direction = torch.zeros_like(positions)
    rough = torch.zeros_like(distance)
    lower, upper = _corners(baffles, batch)
    x = positions.unsqueeze(1)
    near = ((x > lower - cutoff) & (x < upper + cutoff)).all(dim=2).any(dim=1).nonzero().squeeze(1)
    if len(near) == 0:
        return distance, direction, rough
    x = x.index_select(0, near)
    if batch is not None:
        lower, upper = lower.index_select(0, near), upper.index_select(0, near)
        friction = friction.index_select(0, near)
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
    return (
        distance.index_copy(0, near, nearest),
        direction.index_copy(0, near, sum_of_normals),
        rough.index_copy(0, near, (weight * friction).sum(dim=1)),
    )


def nearest_ground(
    positions: Tensor, ground: Ground, batch: Tensor | None, cutoff: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Distance [m], outward direction and friction [-] of the ground, as `nearest_baffle` has those of baffles.

    The distance is that of the plane that touches the ground straight below, (y - h) / sqrt(1 + |grad h|^2).
    """
    height, slope, friction = _ground_below(positions, ground, batch)
    normal = _upward(slope)
    distance = ((positions[:, UP] - height) * normal[:, UP]).clamp(max=cutoff)
    weight = 1.0 - distance / cutoff
    return distance, weight.unsqueeze(1) * normal, weight * friction


def _ground_below(positions: Tensor, ground: Ground, batch: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
    """Elevation [m], [N], its slope along the axes in plan [-], [N, D - 1], and friction [-], [N], below particles."""
    plan = [axis for axis in range(positions.shape[1]) if axis != UP]
    shape = ground.elevation.shape[1:]
    index = torch.zeros(len(positions), dtype=torch.long, device=positions.device) if batch is None else batch
    parts = []
    for axis, count in zip(plan, shape, strict=True):
        scaled = (positions[:, axis] / ground.spacing).clamp(0.0, count - 1.0)
        base = scaled.detach().floor().long().clamp(max=count - 2)
        index = index * count + base
        parts.append(scaled - base)
    strides = [math.prod(shape[position + 1 :]) for position in range(len(shape))]
    elevation, friction = ground.elevation.reshape(-1), ground.friction.reshape(-1)

    def at(field: Tensor, *corner: int) -> Tensor:
        offset = sum(bit * stride for bit, stride in zip(corner, strides, strict=True))
        return field.index_select(0, index + offset)

    if len(shape) == 1:
        (s,) = parts
        low, high = at(elevation, 0), at(elevation, 1)
        slope = ((high - low) / ground.spacing).unsqueeze(1)
        return low + s * (high - low), slope, torch.lerp(at(friction, 0), at(friction, 1), s)
    s, t = parts
    corners = [[at(elevation, i, k) for k in (0, 1)] for i in (0, 1)]
    along = [torch.lerp(corners[i][0], corners[i][1], t) for i in (0, 1)]
    across = [torch.lerp(corners[0][k], corners[1][k], s) for k in (0, 1)]
    slope = torch.stack((along[1] - along[0], across[1] - across[0]), dim=1) / ground.spacing
    rough = [torch.lerp(at(friction, i, 0), at(friction, i, 1), t) for i in (0, 1)]
    return torch.lerp(along[0], along[1], s), slope, torch.lerp(rough[0], rough[1], s)


def _upward(slope: Tensor) -> Tensor:
    """Outward unit normals [N, D] of ground of this slope [N, D - 1]."""
    normal = torch.cat((-slope[:, :1], torch.ones_like(slope[:, :1]), -slope[:, 1:]), dim=1)
    return normal / normal.norm(dim=1, keepdim=True)


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


def keep_out(positions: Tensor, before: Tensor, conditions: Conditions) -> Tensor:
    """Positions [m], shape [N, D], of particles that move from `before` towards `positions` and are stopped by solids.

    The walls of the box [0, size] and the ground stop them, and so do the baffles: a particle whose path enters a
    baffle, or crosses it, is held at a distance SKIN from the first face on its path, and its motion along that face
    remains. A particle on a face follows it: the gradient in the corner is one. A particle that was inside before
    counts as having been at the nearest face that is free.
    """
    size, batch, baffles = conditions.of_particles(conditions.size), conditions.batch, conditions.baffles
    kept = _clamped(positions, size)
    if conditions.ground is not None:
        kept = _clamped(_above(kept, conditions.ground, batch), size)
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
    lower, upper, ends = (
        each.expand(len(near), *each.shape[1:]) if batch is None else each.index_select(0, near)
        for each in (lower, upper, size)
    )
    start = _clamped(before.detach().index_select(0, near), ends)
    start = _freed(start, ends.detach(), lower.detach(), upper.detach())
    # Where a box has stopped a particle, its new path is clear of that box, whatever stops it next: a round each.
    for _ in range(baffles.shape[1]):
        box, axis, rises = _entered(start, point.detach(), lower.detach(), upper.detach())
        if not bool((box >= 0).any()):
            break
        row = torch.arange(len(near), device=box.device)
        index = box.clamp(min=0)
        face = torch.where(rises, lower[row, index, axis], upper[row, index, axis]).unsqueeze(1)
        stopped = (axis.unsqueeze(1) == torch.arange(point.shape[1], device=box.device)) & (box >= 0).unsqueeze(1)
        point = torch.where(stopped, face, point)
    return kept.index_copy(0, near, point)


def _clamped(points: Tensor, size: Tensor) -> Tensor:
    """Positions [n, D] clamped to the box [0, size]; size: [n or 1, D]."""
    # Not by torch.minimum, which would halve the gradient of a particle that rests exactly on a wall.
    points = points.clamp(min=0.0)
    return torch.where(points > size, size, points)


def _above(points: Tensor, ground: Ground, batch: Tensor | None) -> Tensor:
    """Positions [n, D], those below the ground moved to it along its normal, what is left of the way straight up."""
    height, slope, _ = _ground_below(points, ground, batch)
    normal = _upward(slope)
    depth = ((height - points[:, UP]) * normal[:, UP]).clamp(min=0.0)
    points = points + depth.unsqueeze(1) * normal
    height, _, _ = _ground_below(points, ground, batch)
    missing = (height - points[:, UP]).clamp(min=0.0)
    lift = [torch.zeros_like(missing)] * points.shape[1]
    lift[UP] = missing
    return points + torch.stack(lift, dim=1)


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


def _freed(points: Tensor, size: Tensor, lower: Tensor, upper: Tensor) -> Tensor:
    """Positions [n, D], those inside a box moved to its nearest face that neither a wall nor another box covers."""
    inside = ((points.unsqueeze(1) > lower) & (points.unsqueeze(1) < upper)).all(dim=2)
    stuck = inside.any(dim=1).nonzero().squeeze(1)
    if len(stuck) == 0:
        return points
    point, lower, upper, ends = points[stuck], lower[stuck], upper[stuck], size[stuck].unsqueeze(1)
    dimension = point.shape[1]
    row, box = torch.arange(len(stuck), device=points.device), inside[stuck].int().argmax(dim=1)
    faces = torch.stack((lower[row, box], upper[row, box]), dim=1)
    # One candidate for each of the 2 D faces [n, 2, D], moved along one axis: [n, 2, D, D].
    along = torch.eye(dimension, dtype=torch.bool, device=points.device)
    moved = torch.where(along, faces.unsqueeze(3), point.view(-1, 1, 1, dimension))
    others = torch.arange(lower.shape[1], device=points.device) != box.unsqueeze(1)
    within = (moved.unsqueeze(3) > lower[:, None, None]) & (moved.unsqueeze(3) < upper[:, None, None])
    covered = (within.all(dim=4) & others[:, None, None]).any(dim=3) | (faces < 0.0) | (faces > ends)
    effort = (faces - point.unsqueeze(1)).abs() + covered * ends.norm(dim=2, keepdim=True)
    best = effort.flatten(1).argmin(dim=1)
    return points.index_copy(0, stuck, moved.flatten(1, 2)[row, best])


def occupancy(stencil: Stencil, conditions: Conditions) -> Tensor:
    """Share of each grid node's cell that is no room for material [-], shape [B * nodes, 1], as in `gns.model.grid`.

    A node's cell is the box of that edge around it. What is no room: what lies beyond the walls of the box, below the
    ground and in baffles.
    """
    begin, end = stencil.cells(conditions.size)
    length = [last - first for first, last in zip(begin, end, strict=True)]
    room = _outer(length)
    if conditions.ground is not None:
        room = room * (1.0 - _buried(stencil, conditions.ground, begin[UP], length[UP]))
    if conditions.baffles is not None:
        lower, upper = conditions.baffles[:, :, 0, :, None], conditions.baffles[:, :, 1, :, None]
        overlap = [
            (torch.minimum(upper[:, :, axis], last.unsqueeze(1)) - torch.maximum(lower[:, :, axis], first.unsqueeze(1)))
            for axis, (first, last) in enumerate(zip(begin, end, strict=True))
        ]
        room = room - _outer([each.clamp(min=0.0) for each in overlap]).sum(dim=1)
    return (1.0 - room / stencil.cell ** len(length)).clamp(min=0.0, max=1.0).reshape(-1, 1)


def _outer(parts: list[Tensor]) -> Tensor:
    """The product over the axes of a grid: of [..., X], [..., Y] (and [..., Z]) the one of shape [..., X, Y(, Z)]."""
    product = parts[0]
    for part in parts[1:]:
        product = product.unsqueeze(-1) * part.view(*part.shape[:-1], *(1,) * (product.dim() - part.dim() + 1), -1)
    return product


def _buried(stencil: Stencil, ground: Ground, bottom: Tensor, height: Tensor) -> Tensor:
    """Share of the cells of the nodes that lies below the ground [-], shape [B, X, Y(, Z)].

    bottom, height: of the part of a cell that is in the box [m], shape [B, Y].
    """
    nodes = stencil.coordinates(ground.elevation)
    plan = [axis for axis in range(len(nodes)) if axis != UP]
    samples, shape = stencil.samples, [nodes[axis].shape[1] for axis in plan]
    spread = [
        nodes[axis].view(samples, *(-1 if other == axis else 1 for other in plan)).expand(samples, *shape)
        for axis in plan
    ]
    spread.insert(UP, torch.zeros_like(spread[0]))
    points = torch.stack([each.reshape(-1) for each in spread], dim=1)
    batch = torch.arange(samples, device=points.device).repeat_interleave(math.prod(shape))
    elevation = _ground_below(points, ground, batch)[0].view(samples, *shape)
    # [B, X, Y(, Z)]: the vertical axis comes second.
    low = bottom.view(samples, 1, -1, *(1,) * (len(shape) - 1))
    room = height.view(samples, 1, -1, *(1,) * (len(shape) - 1))
    below = (elevation.unsqueeze(2) - low).clamp(min=0.0)
    return torch.where(room > 0.0, torch.minimum(below, room) / torch.where(room > 0.0, room, 1.0), 0.0)


def _corners(baffles: Tensor, batch: Tensor | None) -> tuple[Tensor, Tensor]:
    """Lower and upper corners of the boxes in each particle's sample [m], shape [N or 1, K, D]."""
    boxes = baffles if batch is None else baffles.index_select(0, batch)
    return boxes[:, :, 0], boxes[:, :, 1]
