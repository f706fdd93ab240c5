"""Baffles and ground, turned or not: distances, slopes and directions with exact gradients, and nothing ever inside."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from gns.surroundings.contact import GRAZE, SKIN, keep_out
from gns.surroundings.solids import Below, Boxes, nearest_baffle, nearest_ground, solid_features
from gns.surroundings.state import Ground
from tests.gns.scenery import PADDING, ROOM, boxes, conditions, double, gradients_hold, plane, scattered, turned_boxes

CUTOFF = 0.06
dimensions = pytest.mark.parametrize("dimension", [2, 3])


def of_baffles(points: Tensor, baffles: Tensor, **more: Any) -> tuple[Tensor, ...]:
    """Distance, direction and friction of the nearest baffle."""
    return nearest_baffle(points, conditions(len(points), baffles, **more), CUTOFF)


def near_surfaces(baffles: Tensor, count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Points around the boxes of both samples, outside and inside, and their samples."""
    batch = torch.randint(len(baffles), (count,), generator=generator)
    box = baffles[batch, torch.randint(2, (count,), generator=generator)]
    share = 2.0 * torch.rand(count, baffles.shape[3], generator=generator, dtype=baffles.dtype) - 0.5
    return box[:, 0] + share * (box[:, 1] - box[:, 0]), batch


BOX = [[0.3, 0.1, 0.3], [0.4, 0.3, 0.4]]
EXAMPLES = [
    # position, distance, unit normal; in x and y, where z is in the middle of the box
    ((0.27, 0.2), 0.03, (-1.0, 0.0)),
    ((0.45, 0.2), 0.05, (1.0, 0.0)),
    ((0.35, 0.31), 0.01, (0.0, 1.0)),
    ((0.39, 0.2), -0.01, (1.0, 0.0)),
    ((0.35, 0.25), -0.05, None),
    ((0.43, 0.33), 0.03 * math.sqrt(2.0), (math.sqrt(0.5), math.sqrt(0.5))),
    ((0.4, 0.2), 0.0, (1.0, 0.0)),
    ((0.4, 0.3), 0.0, (math.sqrt(0.5), math.sqrt(0.5))),
    ((0.47, 0.2), CUTOFF, (0.0, 0.0)),
]


@dimensions
@pytest.mark.parametrize(("position", "distance", "normal"), EXAMPLES)
def test_distance_and_direction_at_known_positions(
    dimension: int, position: tuple[float, float], distance: float, normal: tuple[float, float] | None
) -> None:
    point = double([[*position, 0.35]])[:, :dimension]
    got, direction, friction = of_baffles(point, boxes(BOX, PADDING, dimension=dimension))
    assert friction.item() == pytest.approx(0.2 * max(0.0, 1.0 - distance / CUTOFF))
    assert got.item() == pytest.approx(distance, abs=1e-12)
    if normal is not None:
        expected = double([[*normal, 0.0]])[:, :dimension] * (1.0 - distance / CUTOFF)
        torch.testing.assert_close(direction, expected, atol=1e-12, rtol=0.0)


@dimensions
def test_a_turned_box_is_as_far_as_the_box_from_points_turned_back(dimension: int) -> None:
    generator = torch.Generator().manual_seed(2)
    angle = 0.7
    middle, last = double([0.35, 0.2, 0.35])[:dimension], dimension - 1
    offset = 0.2 * torch.rand(200, dimension, generator=generator, dtype=torch.float64) - 0.1
    turned = offset.clone()
    turned[:, 0] = math.cos(angle) * offset[:, 0] - math.sin(angle) * offset[:, last]
    turned[:, last] = math.sin(angle) * offset[:, 0] + math.cos(angle) * offset[:, last]
    distance, direction, friction = of_baffles(middle + offset, boxes(BOX, dimension=dimension))
    ours = of_baffles(middle + turned, boxes(BOX, dimension=dimension), turn=double([[angle]]))
    torch.testing.assert_close(ours[0], distance)
    torch.testing.assert_close(ours[2], friction)
    torch.testing.assert_close((ours[1] * turned).sum(1), (direction * offset).sum(1))
    assert (distance < CUTOFF).sum() > 100


@dimensions
@pytest.mark.parametrize("is_turned", [False, True])
def test_the_gradient_is_that_of_central_differences(dimension: int, is_turned: bool) -> None:
    generator = torch.Generator().manual_seed(0)
    baffles, turn = turned_boxes(dimension) if is_turned else (scattered(dimension), torch.zeros(2, 4).double())
    points, batch = near_surfaces(baffles, 60, generator)
    distance, *_ = of_baffles(points, baffles, batch=batch, turn=turn)
    assert 5 < int((distance < 0.0).sum()) < 50
    inputs = tuple(tensor.requires_grad_() for tensor in (points, baffles, turn))
    assert gradients_hold(lambda x, b, t: of_baffles(x, b, batch=batch, turn=t), inputs)


MOVES = [
    # from, towards, where to: the box is 0.3 to 0.4 m wide and 0.1 to 0.3 m high
    ((0.29, 0.2), (0.31, 0.22), (0.3, 0.22)),  # into a face, sliding along it
    ((0.3 - SKIN, 0.2), (0.31, 0.18), (0.3, 0.18)),  # lying on the face
    ((0.3 - SKIN, 0.2), (0.29, 0.18), (0.29, 0.18)),  # leaving it
    ((0.3 - SKIN, 0.2), (0.3 - SKIN, 0.18), (0.3, 0.18)),  # along it
    ((0.3 - SKIN, 0.28), (0.31, 0.32), (0.3, 0.32)),  # along it and past its end
    ((0.25, 0.2), (0.45, 0.21), (0.3, 0.21)),  # through the whole box
    ((0.37, 0.35), (0.42, 0.26), (0.42, 0.3)),  # through its corner: enters from above
    ((0.396, 0.303), (0.404, 0.2965), (0.404, 0.2965)),  # past its corner, grazing it
    ((0.398, 0.303), (0.399, 0.2991), (0.399, 0.3)),  # into its corner, however little
    ((0.35, 0.05), (0.35, 0.15), (0.35, 0.1)),  # from below
    ((0.2, 0.4), (0.6, 0.6), (0.6, 0.5)),  # far off, against the ceiling
    ((0.31, 0.2), (0.32, 0.2), (0.3, 0.2)),  # inside before: as from the nearest face
    ((0.35, 0.2), (0.42, 0.2), (0.3, 0.2)),  # through the whole box, from inside
]


@pytest.mark.parametrize(("start", "end", "expected"), MOVES)
@dimensions
def test_where_a_move_ends(dimension: int, start: list[float], end: list[float], expected: list[float]) -> None:
    before, after, stopped = (double([[*position, 0.35]])[:, :dimension] for position in (start, end, expected))
    got = keep_out(after, before, conditions(1, boxes(PADDING, BOX, dimension=dimension)))
    torch.testing.assert_close(got, stopped, atol=1.01 * SKIN, rtol=0.0)
    assert 9.0 * SKIN < GRAZE


def test_a_particle_on_a_wall_has_its_whole_gradient() -> None:
    point = torch.tensor([[0.0, 0.2], [-0.1, 0.2]], dtype=torch.float64, requires_grad=True)
    keep_out(point, point.detach(), conditions(2)).sum().backward()
    torch.testing.assert_close(point.grad, double([[1.0, 1.0], [0.0, 1.0]]))


RISE = (0.3, -0.2)


def scattered_points(dimension: int, count: int, seed: int = 0) -> Tensor:
    """Anywhere in the room."""
    points = torch.rand(count, dimension, generator=torch.Generator().manual_seed(seed)).double()
    return points * torch.tensor(ROOM[dimension], dtype=torch.float64)


def elevation(points: Tensor) -> Tensor:
    """Of the plane below points [m]."""
    plan = torch.cat((points[:, :1], points[:, 2:]), dim=1)
    return 0.1 + (plan * double(RISE)[: plan.shape[1]]).sum(1)


def bumpy(dimension: int, samples: int = 1) -> Ground:
    """Ground of random elevations up to 0.15 m."""
    generator = torch.Generator().manual_seed(5)
    like = plane(dimension)
    shape = (samples, *like.elevation.shape[1:])
    heights = 0.15 * torch.rand(shape, generator=generator).double()
    return replace(like, elevation=heights, friction=like.friction.expand(shape))


@dimensions
def test_a_plane_has_its_distance_direction_and_friction(dimension: int) -> None:
    points = scattered_points(dimension, 200)
    rise = double(RISE[: dimension - 1])
    normal = torch.cat((-rise[:1], torch.ones(1).double(), -rise[1:])) / math.sqrt(1.0 + float(rise.square().sum()))
    exact = ((points[:, 1] - elevation(points)) * normal[1]).clamp(max=CUTOFF)
    distance, direction, friction = nearest_ground(points, plane(dimension), None, CUTOFF)
    torch.testing.assert_close(distance, exact)
    weight = 1.0 - exact / CUTOFF
    torch.testing.assert_close(direction, weight[:, None] * normal)
    torch.testing.assert_close(friction, weight * (0.4 + 0.1 * points[:, 0]))
    features = solid_features(points, conditions(len(points), dimension=dimension, ground=plane(dimension)), CUTOFF)
    torch.testing.assert_close(features[:, 2 * dimension], exact / CUTOFF)
    torch.testing.assert_close(features[:, 2 * dimension + 1 : 3 * dimension + 1], direction)
    torch.testing.assert_close(features[:, -1], friction)


@dimensions
def test_gradients_are_those_of_central_differences(dimension: int) -> None:
    points = scattered_points(dimension, 30).requires_grad_()
    batch = torch.arange(30) % 2
    ground = bumpy(dimension, samples=2)
    raster, rough = ground.elevation.requires_grad_(), ground.friction.clone().requires_grad_()

    def features(x: Tensor, h: Tensor, mu: Tensor) -> Tensor:
        varied = replace(ground, elevation=h, friction=mu)
        return solid_features(x, conditions(len(x), dimension=dimension, ground=varied, batch=batch), CUTOFF)

    assert gradients_hold(features, (points, raster, rough))

    def kept(x: Tensor, h: Tensor) -> Tensor:
        varied = replace(ground, elevation=h)
        return keep_out(x, x.detach(), conditions(len(x), dimension=dimension, ground=varied, batch=batch))

    assert gradients_hold(kept, (points, raster), eps=1e-8)


@dimensions
def test_motion_along_a_slope_stays_and_motion_into_it_loses_its_normal_part(dimension: int) -> None:
    around = conditions(50, dimension=dimension, ground=plane(dimension))
    points = 0.2 + 0.5 * scattered_points(dimension, 50)
    points[:, 1] = elevation(points)
    along = torch.tensor([0.01, 0.01 * RISE[0], 0.0]).double()[:dimension]
    torch.testing.assert_close(keep_out(points + along, points, around), points + along, atol=1e-12, rtol=0.0)
    lift = double([0.0, 0.01, 0.0])[:dimension]
    assert torch.equal(keep_out(points + along + lift, points, around), points + along + lift)
    normal = torch.tensor([-RISE[0], 1.0, -RISE[1]]).double()[:dimension]
    normal = normal / normal.norm()
    torch.testing.assert_close(keep_out(points + along - 0.005 * normal, points, around), points + along)


ON_GROUND = [[0.3, 0.0, 0.3], [0.4, 0.3, 0.5]], [[0.6, 0.0, 0.1], [0.7, 0.25, 0.3]]


@dimensions
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("is_turned", [False, True])
@pytest.mark.parametrize("on_ground", [False, True])
def test_nothing_gets_in_whatever_moves(dimension: int, dtype: torch.dtype, is_turned: bool, on_ground: bool) -> None:
    generator = torch.Generator().manual_seed(0)
    baffles, turn = scattered(dimension), torch.tensor([[0.3, -0.2, 0.5, 0.1], [0.2, 0.7, 0.0, 0.0]])
    if on_ground:
        baffles, turn = boxes(*ON_GROUND, dimension=dimension).expand(2, -1, -1, -1), torch.full((2, 2), 0.4)
        # In 2D a turned box would leave its corner free above the ground: it stands on it in 3D alone.
        is_turned = is_turned and dimension == 3
    # Those of the first sample overlap each other, the walls and the floor.
    own_turn = turn.to(dtype) if is_turned else None
    points = torch.rand(800, dimension, generator=generator).to(dtype) * torch.tensor(ROOM[dimension], dtype=dtype)
    points = torch.cat((points, points.round(decimals=1)))
    batch = torch.randint(2, (len(points),), generator=generator)
    ground = bumpy(dimension, samples=2).to(dtype=dtype) if on_ground else None
    around = conditions(len(points), baffles.to(dtype), batch=batch, turn=own_turn, ground=ground)
    solid = Boxes.of_conditions(around).select(batch)
    middle = Boxes.of_conditions(around).select(batch.repeat(12))
    # What begins inside, or in the seam of two baffles, is freed.
    points = keep_out(points, points, around)
    velocity = torch.randn(len(points), dimension, generator=generator).to(dtype) * 0.02
    held = torch.zeros(len(points), dtype=torch.bool)
    for _ in range(25):
        velocity += 0.01 * torch.randn(velocity.shape, generator=generator).to(dtype)
        velocity *= 0.03 / velocity.norm(dim=1, keepdim=True).clamp(min=0.03)
        velocity[:, 1] -= 0.01
        moved = keep_out(points + velocity, points, around)
        assert moved.min() >= 0.0
        assert (moved <= around.size[batch]).all()
        assert not solid.contain(moved, 0.0).any()
        if ground is None:
            # Nor do they pass through: no way is longer than the move, and none leads through the middle of a box.
            along = torch.linspace(0.0, 1.0, 12, dtype=dtype).view(-1, 1, 1)
            assert not middle.contain(points.lerp(moved, along).flatten(0, 1), GRAZE).any()
        else:
            below = Below(moved, ground, batch).value(ground.elevation) - moved[:, 1]
            assert below.max() < (1e-6 if dtype == torch.float32 else 1e-12)
        held |= (moved != points + velocity).any(1)
        velocity, points = moved - points, moved
    assert held.float().mean() > 0.5
