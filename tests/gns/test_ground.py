"""The ground: distance, slope and friction of a plane exactly, and nothing ever below it."""

import dataclasses
import math

import pytest
import torch
from torch import Tensor

from gns.contact import keep_out
from gns.solids import Below, Boxes, nearest_ground, solid_features
from gns.state import Ground
from tests.gns.surroundings import ROOM, boxes, conditions, plane

CUTOFF = 0.06
RISE = (0.3, -0.2)
dimensions = pytest.mark.parametrize("dimension", [2, 3])


def scattered_points(dimension: int, count: int, seed: int = 0) -> Tensor:
    """Anywhere in the room."""
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(count, dimension, generator=generator).double() * torch.tensor(
        ROOM[dimension], dtype=torch.float64
    )


def elevation(points: Tensor) -> Tensor:
    """Of the plane below points [m]."""
    plan = torch.cat((points[:, :1], points[:, 2:]), dim=1)
    return 0.1 + (plan * torch.tensor(RISE, dtype=torch.float64)[: plan.shape[1]]).sum(1)


def bumpy(dimension: int, samples: int = 1) -> Ground:
    """Ground of random elevations up to 0.15 m."""
    generator = torch.Generator().manual_seed(5)
    like = plane(dimension)
    shape = (samples, *like.elevation.shape[1:])
    return dataclasses.replace(
        like,
        elevation=0.15 * torch.rand(shape, generator=generator).double(),
        friction=like.friction.expand(shape),
    )


@dimensions
def test_a_plane_has_its_distance_direction_and_friction(dimension: int) -> None:
    points = scattered_points(dimension, 200)
    rise = torch.tensor(RISE[: dimension - 1], dtype=torch.float64)
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
        own = dataclasses.replace(ground, elevation=h, friction=mu)
        return solid_features(x, conditions(len(x), dimension=dimension, ground=own, batch=batch), CUTOFF)

    assert torch.autograd.gradcheck(features, (points, raster, rough), eps=1e-7, atol=1e-5, fast_mode=True)

    def kept(x: Tensor, h: Tensor) -> Tensor:
        own = dataclasses.replace(ground, elevation=h)
        return keep_out(x, x.detach(), conditions(len(x), dimension=dimension, ground=own, batch=batch))

    assert torch.autograd.gradcheck(kept, (points, raster), eps=1e-8, atol=1e-5, fast_mode=True)


@dimensions
def test_motion_along_a_slope_stays_and_motion_into_it_loses_its_normal_part(dimension: int) -> None:
    around = conditions(50, dimension=dimension, ground=plane(dimension))
    points = 0.2 + 0.5 * scattered_points(dimension, 50)
    points[:, 1] = elevation(points)
    along = torch.tensor([0.01, 0.01 * RISE[0], 0.0]).double()[:dimension]
    torch.testing.assert_close(keep_out(points + along, points, around), points + along, atol=1e-12, rtol=0.0)
    lift = torch.tensor([0.0, 0.01, 0.0], dtype=torch.float64)[:dimension]
    assert torch.equal(keep_out(points + along + lift, points, around), points + along + lift)
    normal = torch.tensor([-RISE[0], 1.0, -RISE[1]]).double()[:dimension]
    normal = normal / normal.norm()
    torch.testing.assert_close(keep_out(points + along - 0.005 * normal, points, around), points + along)


@dimensions
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("turn", [None, 0.4])
def test_nothing_is_ever_below_the_ground_or_in_a_baffle_on_it(
    dimension: int, dtype: torch.dtype, turn: float | None
) -> None:
    generator = torch.Generator().manual_seed(0)
    ground = bumpy(dimension, samples=2).to(dtype=dtype)
    upright = boxes([[0.3, 0.0, 0.3], [0.4, 0.3, 0.5]], [[0.6, 0.0, 0.1], [0.7, 0.25, 0.3]], dimension=dimension)
    # In 2D a turned box would leave its corner free above the ground: it stands on it in 3D alone.
    angles = None if turn is None or dimension == 2 else torch.full((2, 2), turn, dtype=dtype)
    count = 500
    batch = torch.randint(2, (count,), generator=generator)
    around = dataclasses.replace(
        conditions(count, upright.to(dtype).expand(2, -1, -1, -1), batch=batch, turn=angles), ground=ground
    )
    solid = Boxes.of_conditions(around).select(batch)
    points = torch.rand(count, dimension, generator=generator).to(dtype) * around.size[batch]
    points = keep_out(points, points, around)
    velocity = 0.02 * torch.randn(count, dimension, generator=generator).to(dtype)
    for _ in range(20):
        velocity += 0.01 * torch.randn(velocity.shape, generator=generator).to(dtype)
        velocity[:, 1] -= 0.01
        moved = keep_out(points + velocity, points, around)
        below = Below(moved, ground, batch).value(ground.elevation) - moved[:, 1]
        assert below.max() < (1e-6 if dtype == torch.float32 else 1e-12)
        assert not solid.contain(moved, 0.0).any()
        assert (moved >= 0.0).all()
        assert (moved <= around.size[batch]).all()
        velocity, points = 0.9 * (moved - points), moved
