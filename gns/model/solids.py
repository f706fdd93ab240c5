"""Walls, ground and baffles as geometry: features of their distance, and the projection that keeps particles outside.

Everything is differentiable in the corners and turns of the baffles and the elevations of the ground, as exactly as in
the positions; any number of baffles costs next to nothing, because only the particles near one are processed.
"""

import torch
from torch import Tensor

from gns.model.boxes import Boxes, entered
from gns.model.ground import above, lifted, nearest_ground
from gns.model.state import Conditions

ROUNDING = 0.1
"""Radius to which edges are rounded for the outward direction of a baffle, as a share of the cutoff radius.

The direction from a sharp edge turns by any angle within any distance, and its gradient would have no bound.
"""
SKIN = 1.0e-5
"""Distance from a face at which particles are held [m]: neither rounding nor the joint of two baffles admits one."""
SLACK = 0.1 * SKIN
"""How far within that distance rounding may put a particle [m]."""
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
    if conditions.baffles is not None:
        near.append(nearest_baffle(positions, conditions, cutoff))
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


def nearest_baffle(positions: Tensor, conditions: Conditions, cutoff: float) -> tuple[Tensor, Tensor, Tensor]:
    """Signed distance [m], shape [N], of the nearest baffle; outward direction [-], [N, D], and friction [-], [N].

    Direction and friction as `solid_features` weighs them. With q = |x| - half the box, per axis and x from its middle
    in its own axes, the distance of a box is |max(q, 0)| outside and max(q), negative, inside (the exact distance
    function of a box, e.g. Ericson, Real-time collision detection, 2004, section 5.1). It is cut off at `cutoff` [m].
    """
    distance = positions.new_full((len(positions),), cutoff)
    direction = torch.zeros_like(positions)
    rough = torch.zeros_like(distance)
    boxes = Boxes.of_conditions(conditions)
    near = _close(boxes, positions, positions, cutoff, conditions.batch)
    if len(near) == 0:
        return distance, direction, rough
    row = _samples(near, conditions.batch)
    boxes = boxes.select(row)
    x = boxes.own(positions.index_select(0, near))
    q = x.abs() - boxes.half
    square = q.clamp(min=0.0).square().sum(dim=2)
    outside = square > 0.0
    # The root has no slope at zero: on the surface the distance is that to the face.
    distances = torch.where(outside, torch.where(outside, square, 1.0).sqrt(), q.max(dim=2).values)
    weight = (1.0 - distances / cutoff).clamp(min=0.0)
    total = weight.sum(dim=1, keepdim=True)
    weight = weight * (weight / torch.where(total > 0.0, total, 1.0))
    normals = boxes.world_vectors(_normals(x, boxes.half, q, ROUNDING * cutoff))
    nearest = distances.min(dim=1).values.clamp(max=cutoff)
    assert conditions.baffle_friction is not None
    friction = conditions.baffle_friction.index_select(0, row)
    return (
        distance.index_copy(0, near, nearest),
        direction.index_copy(0, near, (weight.unsqueeze(2) * normals).sum(dim=1)),
        rough.index_copy(0, near, (weight * friction).sum(dim=1)),
    )


def _close(boxes: Boxes, first: Tensor, last: Tensor, margin: float, batch: Tensor | None) -> Tensor:
    """Indices of the particles whose way from `first` to `last` [N, D] comes close to a baffle of their sample.

    To within `margin` [m], or what is about it: boxes are compared along the axes of the scene. A sample's baffles are
    put into a single box first, which most particles are far from.
    """
    with torch.no_grad():
        low, high = torch.minimum(first, last), torch.maximum(first, last)
        lower, upper = boxes.middle - boxes.half_extent - margin, boxes.middle + boxes.half_extent + margin
        if batch is None:
            ends = lower.amin(dim=1), upper.amax(dim=1)
            some = ((low < ends[1]) & (high > ends[0])).all(dim=1).nonzero().squeeze(1)
            low, high = low.index_select(0, some).unsqueeze(1), high.index_select(0, some).unsqueeze(1)
        else:
            # Absent baffles are far outside: all that they would add to such a box is room.
            some = torch.arange(len(low), device=low.device)
            low, high, lower, upper = low.unsqueeze(1), high.unsqueeze(1), lower[batch], upper[batch]
        return some[((low < upper) & (high > lower)).all(dim=2).any(dim=1)]


def _samples(near: Tensor, batch: Tensor | None) -> Tensor:
    """The sample of each of these particles."""
    return torch.zeros_like(near) if batch is None else batch.index_select(0, near)


def _normals(x: Tensor, half: Tensor, q: Tensor, radius: float) -> Tensor:
    """Outward unit normals [n, K, D] of boxes whose edges are rounded to `radius` [m], at `x`, in their own axes.

    They point from the box that is smaller by the radius on every side; q: of `nearest_baffle`, [n, K, D].
    """
    arm = (q + half.clamp(max=radius)).clamp(min=0.0)
    square = arm.square().sum(dim=2, keepdim=True)
    outside = square > 0.0
    # Deep inside it is the normal of the nearest face.
    face = torch.nn.functional.one_hot(q.argmax(dim=2), q.shape[2]).to(q)
    normal = torch.where(outside, arm / torch.where(outside, square, 1.0).sqrt(), face)
    return torch.where(x < 0.0, -normal, normal)


def keep_out(positions: Tensor, before: Tensor, conditions: Conditions) -> Tensor:
    """Positions [m], shape [N, D], of particles that move from `before` towards `positions` and are stopped by solids.

    The walls of the box [0, size] and the ground stop them, and so do the baffles: a particle whose path enters a
    baffle, or crosses it, is held at a distance SKIN from the first face on its path, and its motion along that face
    remains. A particle on a face follows it: the gradient in the corner is one. A particle that was inside before
    counts as having been at the nearest face that is free. Where turned baffles leave no way along a face, as between
    a face and a wall that it meets at an acute angle, the particle stays where it was.
    """
    size, batch, ground = conditions.of_particles(conditions.size), conditions.batch, conditions.ground
    kept = _clamped(positions, size)
    if ground is not None:
        # What a wall sends back from its way along the normal may be below the ground again.
        kept = lifted(_clamped(above(kept, ground, batch), size), ground, batch)
    if conditions.baffles is None:
        return kept
    boxes = Boxes.of_conditions(conditions).grown(SKIN)
    near = _close(boxes, before, kept, 0.0, batch)
    if len(near) == 0:
        return kept
    row = _samples(near, batch)
    boxes, ends = boxes.select(row), conditions.size.index_select(0, row)
    fixed = boxes.each(Tensor.detach)
    point = kept.index_select(0, near)
    start = _clamped(before.detach().index_select(0, near), ends.detach())
    start = _freed(start, ends.detach(), fixed)
    own_start = fixed.own(start)
    is_turned = boxes.cosine is not None
    # Where a box has stopped a particle, its new path is clear of that box, whatever stops it next: a round each. Of
    # turned ones that is so but for the next one to send it back.
    for _ in range(boxes.half.shape[1] * (2 if is_turned else 1)):
        box, axis, along = entered(own_start, fixed.own(point.detach()), fixed.half, graze=GRAZE, slack=SLACK)
        hit = (box >= 0).nonzero().squeeze(1)
        if len(hit) == 0:
            break
        point = point.index_copy(0, hit, _stopped(point[hit], boxes.select(hit).one(box[hit]), axis[hit], along[hit]))
        if is_turned:
            point = _clamped(point, ends)
    own = None if batch is None else row
    if ground is not None:
        point = lifted(point, ground, own)
    if is_turned:
        # Of smaller boxes, or rounding would stop what slides along a face.
        box, *_ = entered(own_start, fixed.own(point.detach()), fixed.half - SLACK, graze=GRAZE, slack=0.0)
        point = torch.where((box >= 0).unsqueeze(1), start, point)
        if ground is not None:
            point = lifted(point, ground, own)
    return kept.index_copy(0, near, point)


def _stopped(point: Tensor, box: Boxes, axis: Tensor, along: Tensor) -> Tensor:
    """Positions [n, D] moved to a face of a box, K = 1: across `axis` [n], the lower one where paths go `along` it."""
    across = torch.nn.functional.one_hot(axis, point.shape[1]).to(point).unsqueeze(1)
    half = (box.half * across).sum(dim=2)
    shift = torch.where(along.unsqueeze(1), -half, half) - (box.own(point) * across).sum(dim=2)
    return point + shift * box.world_vectors(across).squeeze(1)


def _clamped(points: Tensor, size: Tensor) -> Tensor:
    """Positions [n, D] clamped to the box [0, size]; size: [n or 1, D]."""
    # Not by torch.minimum, which would halve the gradient of a particle that rests exactly on a wall.
    points = points.clamp(min=0.0)
    return torch.where(points > size, size, points)


def _freed(points: Tensor, size: Tensor, boxes: Boxes) -> Tensor:
    """Positions [n, D], those inside a box moved to its nearest face that neither a wall nor another box covers."""
    inside = boxes.contain(points, SLACK)
    stuck = inside.any(dim=1).nonzero().squeeze(1)
    if len(stuck) == 0:
        return points
    point, ends, boxes = points[stuck], size[stuck], boxes.select(stuck)
    count, dimension = point.shape
    row, number = torch.arange(count, device=points.device), inside[stuck].int().argmax(dim=1)
    box = boxes.one(number)
    # One candidate for each of the 2 D faces, the lower ones first: [n, 2 D, D].
    axes = torch.eye(dimension, dtype=point.dtype, device=point.device).expand(count, -1, -1)
    faces = torch.stack((-box.half, box.half), dim=1).squeeze(2)
    shift = (faces - box.own(point)).flatten(1)
    directions = box.each(lambda part: part.expand(-1, dimension, *part.shape[2:])).world_vectors(axes).repeat(1, 2, 1)
    moved = point.unsqueeze(1) + shift.unsqueeze(2) * directions
    each = boxes.select(row.repeat_interleave(2 * dimension))
    covered = each.contain(moved.flatten(0, 1), SLACK).view(count, 2 * dimension, -1)
    covered[row, :, number] = False
    beyond = ((moved < -SLACK) | (moved > ends.unsqueeze(1) + SLACK)).any(dim=2)
    effort = shift.abs() + (covered.any(dim=2) | beyond) * ends.norm(dim=1, keepdim=True)
    return points.index_copy(0, stuck, moved[row, effort.argmin(dim=1)])
