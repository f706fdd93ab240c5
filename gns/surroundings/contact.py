"""The projection that keeps particles out of walls, ground and baffles, differentiable in all of these."""

import math

import torch
from torch import Tensor

from gns.settings import UP
from gns.surroundings.solids import Below, Boxes, close_to, upward
from gns.surroundings.state import Conditions, Ground

SKIN = 1.0e-5  # distance from a face at which particles are held [m]: none passes by rounding or through a joint
SLACK = 0.1 * SKIN  # how far inside that distance rounding may move a particle [m]
GRAZE = 1.0e-3  # a path that cuts off less than this of a baffle's corner passes it [m]


def keep_out(positions: Tensor, before: Tensor, conditions: Conditions) -> Tensor:
    """Positions [m], shape [N, D], of particles that move from `before` towards `positions` and are stopped by solids.
    The walls of the box [0, size] and the ground stop them. A particle whose path enters or crosses a baffle is held at
    a distance SKIN from the first face on its path, and its motion along that face remains: the gradient in the corner
    is one. A particle that was inside before counts as having been at the nearest free face. Where turned baffles leave
    no path along a face, such as where it meets a wall at an acute angle, the particle stays where it was."""
    size, batch, ground = conditions.of_particles(conditions.size), conditions.batch, conditions.ground
    kept = _clamped(positions, size)
    if ground is not None:
        # A particle moved along the normal and sent back by a wall may be below the ground again.
        kept = lifted(_clamped(above(kept, ground, batch), size), ground, batch)
    if conditions.baffles is None:
        return kept
    boxes = Boxes.of_conditions(conditions, SKIN)
    near, row = close_to(boxes, before, kept, 0.0, batch)
    if len(near) == 0:
        return kept
    boxes, ends = boxes.select(row), conditions.size.index_select(0, row)
    fixed = boxes.mapped(Tensor.detach)
    point = kept.index_select(0, near)
    start = _clamped(before.detach().index_select(0, near), ends.detach())
    start = _freed(start, ends.detach(), fixed)
    start_in_axes = fixed.in_axes(start)
    is_turned = boxes.turn is not None
    # After a box has stopped a particle, its new path avoids that box, whatever stops it next: one round per box. With
    # turned boxes this holds unless the next one sends it back.
    for _ in range(boxes.half.shape[1] * (2 if is_turned else 1)):
        box, axis, along = entered(start_in_axes, fixed.in_axes(point.detach()), fixed.half, graze=GRAZE, slack=SLACK)
        hit = (box >= 0).nonzero().squeeze(1)
        if len(hit) == 0:
            break
        point = point.index_copy(0, hit, _stopped(point[hit], boxes.select(hit).one(box[hit]), axis[hit], along[hit]))
        if is_turned:
            point = _clamped(point, ends)
    near_batch = None if batch is None else row
    if ground is not None:
        point = lifted(point, ground, near_batch)
    if is_turned:
        # With smaller boxes, since otherwise rounding would stop particles that slide along a face.
        box, *_ = entered(start_in_axes, fixed.in_axes(point.detach()), fixed.half - SLACK, graze=GRAZE, slack=0.0)
        point = torch.where((box >= 0).unsqueeze(1), start, point)
        if ground is not None:
            point = lifted(point, ground, near_batch)
    return kept.index_copy(0, near, point)


def _stopped(point: Tensor, box: Boxes, axis: Tensor, along: Tensor) -> Tensor:
    """Positions [n, D] moved to a face of a box, K = 1: across `axis` [n], the lower one where paths go `along` it."""
    across = torch.nn.functional.one_hot(axis, point.shape[1]).to(point).unsqueeze(1)
    half = (box.half * across).sum(dim=2)
    shift = torch.where(along.unsqueeze(1), -half, half) - (box.in_axes(point) * across).sum(dim=2)
    return point + shift * box.world_vectors(across).squeeze(1)


def _clamped(points: Tensor, size: Tensor) -> Tensor:
    """Positions [n, D] clamped to the box [0, size]; size: [n or 1, D]."""
    # Not torch.minimum, which would halve the gradient of a particle that rests exactly on a wall.
    points = points.clamp(min=0.0)
    return torch.where(points > size, size, points)


def _freed(points: Tensor, size: Tensor, boxes: Boxes) -> Tensor:
    """Positions [n, D]; those inside a box are moved to its nearest face not covered by a wall or another box."""
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
    shift = (torch.stack((-box.half, box.half), dim=1).squeeze(2) - box.in_axes(point)).flatten(1)
    normals = box.mapped(lambda part: part.expand(-1, dimension, *part.shape[2:])).world_vectors(axes).repeat(1, 2, 1)
    moved = point.unsqueeze(1) + shift.unsqueeze(2) * normals
    repeated = boxes.select(row.repeat_interleave(2 * dimension))
    covered = repeated.contain(moved.flatten(0, 1), SLACK).view(count, 2 * dimension, -1)
    covered[row, :, number] = False
    beyond = ((moved < -SLACK) | (moved > ends.unsqueeze(1) + SLACK)).any(dim=2)
    effort = shift.abs() + (covered.any(dim=2) | beyond) * ends.norm(dim=1, keepdim=True)
    return points.index_copy(0, stuck, moved[row, effort.argmin(dim=1)])


def entered(start: Tensor, end: Tensor, half: Tensor, *, graze: float, slack: float) -> tuple[Tensor, Tensor, Tensor]:
    """The box that each path enters first, -1 if none; the axis of entry; whether the path goes along this axis. Each
    [n]. start, end: of the paths in the axes of the boxes [m], both [n, K, D]; half: [n, K, D]. A path that cuts off
    less than `graze` [m] of a box passes it; one that starts less than `slack` inside enters it. By the slab method
    (Kay and Kajiya 1986): a path is inside between the last of the axes' entries and the first of their exits."""
    path = end - start
    still = path == 0.0
    divisor = torch.where(still, 1.0, path)
    entry, leave = (-half - start) / divisor, (half - start) / divisor
    between = start.abs() < half
    entry, leave = (
        torch.where(still, torch.where(between, -math.inf, math.inf), torch.minimum(entry, leave)),
        torch.where(still, torch.where(between, math.inf, -math.inf), torch.maximum(entry, leave)),
    )
    last_entry, axis = entry.max(dim=2)
    # Only the path itself: a crossing before its start does not count.
    cut = (leave.min(dim=2).values.clamp(max=1.0) - last_entry.clamp(min=0.0)) * path.norm(dim=2)
    outside = last_entry * path.gather(2, axis.unsqueeze(2)).squeeze(2).abs() >= -2.0 * slack
    hit = (end.abs() < half - slack).all(dim=2) | (outside & (cut > graze))
    earliest, box = torch.where(hit, last_entry, math.inf).min(dim=1)
    axis = axis.gather(1, box.unsqueeze(1)).squeeze(1)
    row = torch.arange(len(box), device=box.device)
    return torch.where(earliest < math.inf, box, -1), axis, path[row, box, axis] > 0.0


def above(points: Tensor, ground: Ground, batch: Tensor | None) -> Tensor:
    """Positions [n, D]; those below the ground are moved onto it along its normal, and the rest straight up."""
    below = Below(points, ground, batch)
    with torch.no_grad():
        buried = (below.value(ground.elevation) > points[:, UP]).nonzero().squeeze(1)
    if len(buried) == 0:
        return points
    point = points.index_select(0, buried)
    buried_batch = None if batch is None else batch.index_select(0, buried)
    height, slope = Below(point, ground, buried_batch).value_and_slope(ground.elevation)
    normal = upward(slope)
    point = point + ((height - point[:, UP]) * normal[:, UP]).unsqueeze(1) * normal
    return points.index_copy(0, buried, lifted(point, ground, buried_batch))


def lifted(points: Tensor, ground: Ground, batch: Tensor | None) -> Tensor:
    """Positions [n, D]; those below the ground are moved straight up to it."""
    height = Below(points, ground, batch).value(ground.elevation)
    y = points[:, UP]
    # Not torch.maximum, which would halve the gradient of a particle that rests exactly on the ground.
    return torch.cat((points[:, :UP], torch.where(height > y, height, y).unsqueeze(1), points[:, UP + 1 :]), dim=1)
