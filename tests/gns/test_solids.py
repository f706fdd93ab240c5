"""Solids: distances and directions with exact gradients, nothing ever inside, and the share of a cell they cover."""

import math

import pytest
import torch
from torch import Tensor

from gns.model.grid import stencil_of
from gns.model.solids import GRAZE, SKIN, feature_count, keep_out, nearest_baffle, occupancy, solid_features

CUTOFF = 0.06
ROOM = {2: (1.0, 0.5), 3: (1.0, 0.5, 0.8)}
PADDING = [[-10.0, -10.0, -10.0], [-10.0, -10.0, -10.0]]


def boxes(*corners: list[list[float]], dimension: int = 2, dtype: torch.dtype = torch.float64) -> Tensor:
    """Baffles of one sample, given in 3D, without their z in 2D."""
    return torch.tensor(corners, dtype=dtype)[None, :, :, :dimension].clone()


def scattered(dimension: int) -> Tensor:
    """Two samples: a free box and three that touch each other, floor and wall; a thin box, the free one and padding."""
    free = [[0.3, 0.1, 0.3], [0.4, 0.3, 0.4]]
    pair = [[[0.6, 0.0, 0.0], [0.7, 0.3, 0.12]], [[0.7, 0.0, 0.0], [0.8, 0.2, 0.12]]]
    upon = [[0.6, 0.3, 0.0], [0.7, 0.4, 0.3]]
    thin = [[0.0, 0.0, 0.5], [0.02, 0.35, 0.8]]
    first = boxes(free, *pair, upon, dimension=dimension)
    return torch.cat((first, boxes(thin, free, PADDING, PADDING, dimension=dimension)))


def near_surfaces(baffles: Tensor, count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Points around the boxes of both samples, outside and inside, and their samples."""
    batch = torch.randint(len(baffles), (count,), generator=generator)
    number = torch.randint(2, (count,), generator=generator)
    box = baffles[batch, number]
    share = 2.0 * torch.rand(count, baffles.shape[3], generator=generator, dtype=baffles.dtype) - 0.5
    return box[:, 0] + share * (box[:, 1] - box[:, 0]), batch


def is_inside(points: Tensor, baffles: Tensor, batch: Tensor) -> Tensor:
    """Which points are inside a baffle."""
    lower, upper = baffles[batch].unbind(2)
    return ((points[:, None] > lower) & (points[:, None] < upper)).all(2).any(1)


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


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(("position", "distance", "normal"), EXAMPLES)
def test_distance_and_direction_at_known_positions(
    dimension: int, position: tuple[float, float], distance: float, normal: tuple[float, float] | None
) -> None:
    point = torch.tensor([[*position, 0.35]], dtype=torch.float64)[:, :dimension]
    got, direction = nearest_baffle(point, boxes(BOX, PADDING, dimension=dimension), None, CUTOFF)
    assert got.item() == pytest.approx(distance, abs=1e-12)
    if normal is not None:
        expected = torch.tensor([[*normal, 0.0]], dtype=torch.float64)[:, :dimension] * (1.0 - distance / CUTOFF)
        torch.testing.assert_close(direction, expected, atol=1e-12, rtol=0.0)


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_gradient_is_that_of_central_differences(dimension: int) -> None:
    generator = torch.Generator().manual_seed(0)
    baffles = scattered(dimension).requires_grad_()
    points, batch = near_surfaces(baffles.detach(), 60, generator)
    points.requires_grad_()
    distance, _ = nearest_baffle(points, baffles, batch, CUTOFF)
    assert 5 < int((distance < 0.0).sum()) < 50
    assert torch.autograd.gradcheck(
        lambda x, b: nearest_baffle(x, b, batch, CUTOFF), (points, baffles), eps=1e-7, atol=1e-5
    )


def test_the_gradient_of_a_face_and_of_a_corner_are_the_normals() -> None:
    points = torch.tensor([[0.42, 0.2], [0.43, 0.34], [0.4, 0.2], [0.35, 0.3]], dtype=torch.float64, requires_grad=True)
    baffles = boxes(BOX).requires_grad_()
    distance, _ = nearest_baffle(points, baffles, None, CUTOFF)
    (to_points,) = torch.autograd.grad(distance.sum(), points, retain_graph=True)
    normals = torch.tensor([[1.0, 0.0], [0.6, 0.8], [1.0, 0.0], [0.0, 1.0]], dtype=torch.float64)
    torch.testing.assert_close(to_points, normals)
    (to_corners,) = torch.autograd.grad(distance.sum(), baffles)
    torch.testing.assert_close(to_corners[0, 0, 1], -normals.sum(0))
    assert not to_corners[0, 0, 0].any()


@pytest.mark.parametrize("dimension", [2, 3])
def test_no_gradient_is_ever_undefined_or_large(dimension: int) -> None:
    baffles = boxes(BOX, [[0.4, 0.0, 0.3], [0.5, 0.3, 0.4]], PADDING, dimension=dimension, dtype=torch.float32)
    corners = torch.cartesian_prod(*baffles[0, 0].T)
    middle = baffles[0, 0].mean(0)
    edges = torch.stack([corners[0].lerp(corners[1], share) for share in (0.0, 0.3, 1.0)])
    faces = torch.stack((torch.cat((baffles[0, 0, 1, :1], middle[1:])), torch.cat((baffles[0, 0, 0, :1], middle[1:]))))
    tiny = torch.cat((corners + 1e-7, corners - 1e-7, corners + 1e-20))
    points = torch.cat((corners, corners, edges, faces, middle[None], tiny)).requires_grad_()
    baffles.requires_grad_()
    distance, direction = nearest_baffle(points, baffles, None, CUTOFF)
    weights = torch.linspace(-1.0, 2.0, direction.numel()).view_as(direction)
    to_points, to_corners = torch.autograd.grad(
        (distance / CUTOFF).sum() + (direction * weights).sum(), (points, baffles)
    )
    assert torch.isfinite(distance).all()
    assert torch.isfinite(direction).all()
    assert torch.isfinite(to_corners).all()
    # The edges are rounded: the direction turns over a tenth of the cutoff, not at once.
    assert to_points.norm(dim=1).max() < 3.0 * 2.0 * 10.0 / CUTOFF


@pytest.mark.parametrize("dimension", [2, 3])
def test_features_are_continuous_everywhere(dimension: int) -> None:
    baffles = boxes(BOX, [[0.46, 0.0, 0.2], [0.56, 0.35, 0.5]], dimension=dimension)
    # Between the two boxes, along their edges, over their tops and beyond the cutoff.
    turns = torch.linspace(0.0, 1.0, 40001, dtype=torch.float64)
    path = torch.stack(
        (0.24 + 0.4 * turns, 0.2 + 0.14 * torch.sin(40.0 * turns), 0.35 + 0.15 * torch.sin(23.0 * turns))
    )
    path = path[:dimension].T
    outside = ~is_inside(path, baffles, torch.zeros(len(path), dtype=torch.long))
    features = solid_features(path, ROOM[dimension], baffles, None, CUTOFF, with_baffles=True)
    jumps = (features[1:] - features[:-1]).norm(dim=1) / (path[1:] - path[:-1]).norm(dim=1)
    assert (features[outside, 2 * dimension] < 1.0).sum() > 10000
    assert jumps[outside[1:] & outside[:-1]].max() < 2.0 * 10.0 / CUTOFF


@pytest.mark.parametrize("dimension", [2, 3])
def test_features_without_baffles_are_those_far_from_any(dimension: int) -> None:
    generator = torch.Generator().manual_seed(0)
    size = ROOM[dimension]
    points = torch.rand(50, dimension, generator=generator) * torch.tensor(size)
    far = boxes(PADDING, PADDING, dimension=dimension, dtype=torch.float32)
    features = solid_features(points, size, far, None, CUTOFF, with_baffles=True)
    assert features.shape == (50, feature_count(dimension, True))
    torch.testing.assert_close(features, solid_features(points, size, None, None, CUTOFF, with_baffles=True))
    torch.testing.assert_close(features, solid_features(points, size, far[:, :0], None, CUTOFF, with_baffles=True))
    walls = solid_features(points, size, None, None, CUTOFF, with_baffles=False)
    assert walls.shape == (50, feature_count(dimension, False))
    torch.testing.assert_close(features[:, : 2 * dimension], walls)
    expected = torch.cat((points, torch.tensor(size) - points), dim=1).clamp(max=CUTOFF) / CUTOFF
    torch.testing.assert_close(walls, expected)


def test_baffles_of_other_samples_have_no_effect() -> None:
    both = torch.cat((boxes(BOX), boxes(PADDING)))
    point = torch.tensor([[0.42, 0.2], [0.42, 0.2]], dtype=torch.float64)
    distance, direction = nearest_baffle(point, both, torch.tensor([0, 1]), CUTOFF)
    torch.testing.assert_close(distance, torch.tensor([0.02, CUTOFF], dtype=torch.float64))
    assert direction[0].any()
    assert not direction[1].any()


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
    ((0.2, 0.4), (0.6, 0.6), (0.6, 0.5)),  # far away, against the ceiling
    ((0.31, 0.2), (0.32, 0.2), (0.3, 0.2)),  # inside before: as from the nearest face
    ((0.35, 0.2), (0.42, 0.2), (0.3, 0.2)),  # through the whole box, from inside
]


@pytest.mark.parametrize(("start", "end", "expected"), MOVES)
@pytest.mark.parametrize("dimension", [2, 3])
def test_where_a_move_ends(
    dimension: int, start: tuple[float, float], end: tuple[float, float], expected: object
) -> None:
    before, after, stopped = (
        torch.tensor([[*position, 0.35]], dtype=torch.float64)[:, :dimension]  # type: ignore[misc]
        for position in (start, end, expected)
    )
    got = keep_out(after, before, ROOM[dimension], boxes(PADDING, BOX, dimension=dimension), None)
    torch.testing.assert_close(got, stopped, atol=1.01 * SKIN, rtol=0.0)
    assert 9.0 * SKIN < GRAZE


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("dimension", [2, 3])
def test_nothing_gets_in_or_out_whatever_the_moves(dimension: int, dtype: torch.dtype) -> None:
    generator = torch.Generator().manual_seed(0)
    baffles = scattered(dimension).to(dtype)
    size = ROOM[dimension]
    ends = torch.tensor(size, dtype=dtype)
    count = 3000
    points = torch.rand(count, dimension, generator=generator).to(dtype) * ends
    points = torch.cat((points, points.round(decimals=1)))
    batch = torch.randint(2, (len(points),), generator=generator)
    # What begins inside, or in the seam of two baffles, is freed.
    points = keep_out(points, points, size, baffles, batch)
    velocity = torch.randn(len(points), dimension, generator=generator).to(dtype) * 0.02
    held = torch.zeros(len(points), dtype=torch.bool)
    for _ in range(25):
        velocity += 0.01 * torch.randn(velocity.shape, generator=generator).to(dtype)
        velocity *= 0.03 / velocity.norm(dim=1, keepdim=True).clamp(min=0.03)
        velocity[:, 1] -= 0.01
        moved = keep_out(points + velocity, points, size, baffles, batch)
        assert moved.min() >= 0.0
        assert (moved <= ends).all()
        assert not is_inside(moved, baffles, batch).any()
        # Nor do they pass through: no way is longer than the move, and none leads through the middle of a box.
        along = torch.linspace(0.0, 1.0, 12, dtype=dtype).view(-1, 1, 1)
        ways = points.lerp(moved, along).flatten(0, 1)
        lower, upper = baffles[batch.repeat(12)].unbind(2)
        inner = ((ways[:, None] > lower + GRAZE) & (ways[:, None] < upper - GRAZE)).all(2).any(1)
        assert not inner.any()
        held |= (moved != points + velocity).any(1)
        velocity, points = moved - points, moved
    assert held.float().mean() > 0.5


def test_the_seams_between_baffles_and_walls_are_closed() -> None:
    # A tall box beside a low one: a point slides down the side of the tall one to the top of the low one.
    pair = boxes([[0.6, 0.0, 0.0], [0.7, 0.3, 0.1]], [[0.7, 0.0, 0.0], [0.8, 0.2, 0.1]], dtype=torch.float32)
    fall = torch.tensor([[-0.01, -0.02]])
    point = torch.tensor([[0.72, 0.27]])
    for _ in range(8):
        point = keep_out(point + fall, point, (1.0, 0.5), pair, None)
    torch.testing.assert_close(point, torch.tensor([[0.7, 0.2]]), atol=2.0 * SKIN, rtol=0.0)
    # The same beside a wall, onto a box that touches it, and on top of it along the wall.
    beside = boxes([[0.0, 0.0, 0.0], [0.1, 0.2, 0.1]], dtype=torch.float32)
    point = torch.tensor([[0.02, 0.27]])
    for _ in range(8):
        point = keep_out(point + fall, point, (1.0, 0.5), beside, None)
    torch.testing.assert_close(point, torch.tensor([[0.0, 0.2]]), atol=2.0 * SKIN, rtol=0.0)


def test_a_particle_inside_goes_to_a_face_that_nothing_covers() -> None:
    # Nearest is the floor, then the neighbour, then the top.
    pair = boxes([[0.6, 0.0, 0.0], [0.7, 0.1, 0.1]], [[0.7, 0.0, 0.0], [0.8, 0.2, 0.1]])
    point = torch.tensor([[0.68, 0.01], [0.68, 0.05], [0.72, 0.12]], dtype=torch.float64)
    got = keep_out(point, point, (1.0, 0.5), pair, None)
    expected = torch.tensor([[0.6, 0.01], [0.68, 0.1], [0.7, 0.12]], dtype=torch.float64)
    torch.testing.assert_close(got, expected, atol=2.0 * SKIN, rtol=0.0)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_particle_on_a_face_moves_with_the_face(dimension: int) -> None:
    generator = torch.Generator().manual_seed(1)
    baffles = scattered(dimension)
    size = ROOM[dimension]
    target, batch = near_surfaces(baffles, 200, generator)
    start, _ = near_surfaces(baffles, 200, generator)
    start = keep_out(start, start, size, baffles, batch)
    target = start + 0.03 * torch.randn(start.shape, generator=generator, dtype=start.dtype).clamp(-1.0, 1.0)
    kept = keep_out(target, start, size, baffles, batch)
    held = (kept != target).any(1)
    assert held.sum() > 25
    target, start, batch = target[held], start[held], batch[held]
    # Keep what no small change of a corner sends elsewhere: the choice of the face is discontinuous.
    shift = 1e-6 * torch.randn(baffles.shape, generator=generator, dtype=baffles.dtype)
    moves = [keep_out(target, start, size, baffles + sign * shift, batch) - kept[held] for sign in (-1.0, 1.0)]
    steady = torch.stack(moves).abs().amax((0, 2)) < 1e-5
    assert steady.float().mean() > 0.9
    target, start, batch = target[steady], start[steady], batch[steady]
    baffles.requires_grad_()
    target.requires_grad_()

    def move(x: Tensor, b: Tensor) -> Tensor:
        return keep_out(x, start, size, b, batch)

    assert torch.autograd.gradcheck(move, (target, baffles), eps=1e-8, atol=1e-5)


def test_a_particle_on_a_wall_has_its_whole_gradient() -> None:
    point = torch.tensor([[0.0, 0.2], [-0.1, 0.2]], dtype=torch.float64, requires_grad=True)
    keep_out(point, point.detach(), (1.0, 0.5), None, None).sum().backward()
    torch.testing.assert_close(point.grad, torch.tensor([[1.0, 1.0], [0.0, 1.0]], dtype=torch.float64))


@pytest.mark.parametrize("dimension", [2, 3])
def test_occupancy_is_the_share_of_a_cell(dimension: int) -> None:
    cell = 0.04
    generator = torch.Generator().manual_seed(0)
    baffles = scattered(dimension)
    size = ROOM[dimension]
    points = stencil_of(torch.rand(5, dimension, generator=generator).double() * 0.4, size, cell, None, 1)
    share = occupancy(points.shape, cell, size, baffles, 2)
    assert share.shape == (2 * math.prod(points.shape), 1)
    assert share.min() == 0.0
    assert share.max() == pytest.approx(1.0)
    # Sampled: the share of random points of a cell that lie inside a baffle.
    nodes = torch.cartesian_prod(*(torch.arange(count) for count in points.shape)).double() * cell
    random = torch.rand(1000, 1, dimension, generator=generator).double()
    some = torch.randperm(len(nodes), generator=generator)[:150]
    begin, end = (nodes[some] - 0.5 * cell).clamp(min=0.0), torch.minimum(nodes[some] + 0.5 * cell, torch.tensor(size))
    positions = (begin + random * (end - begin)).flatten(0, 1)
    for sample in (0, 1):
        inside = is_inside(positions, baffles, torch.full((len(positions),), sample)).view(1000, -1)
        got = share.view(2, -1)[sample, some]
        torch.testing.assert_close(got, inside.double().mean(0), atol=0.08, rtol=0.0)
    baffles = baffles + 1e-3 * torch.rand(baffles.shape, generator=generator).double()
    small = tuple(count // 3 for count in points.shape)
    assert torch.autograd.gradcheck(
        lambda b: occupancy(small, 3.0 * cell, size, b, 2), baffles.requires_grad_(), eps=1e-7, atol=1e-5
    )


def test_occupancy_without_baffles_and_beyond_the_wall() -> None:
    # The grid's last node lies beyond the wall: its cell holds nothing of the domain.
    shape = stencil_of(torch.tensor([[0.1, 0.1]]), (0.41, 0.4), 0.1, None, 1).shape
    assert shape == (6, 5)
    full = boxes([[0.0, 0.0, 0.0], [0.41, 0.2, 0.1]], dtype=torch.float32)
    share = occupancy(shape, 0.1, (0.41, 0.4), full, 1).view(shape)
    torch.testing.assert_close(share[2], torch.tensor([1.0, 1.0, 0.5, 0.0, 0.0]))
    torch.testing.assert_close(share[5], torch.zeros(5))
    like = torch.zeros(1, dtype=torch.float64)
    assert occupancy(shape, 0.1, (0.41, 0.4), None, 3, like).shape == (90, 1)
    assert occupancy(shape, 0.1, (0.41, 0.4), None, 3, like).dtype == torch.float64
    assert not occupancy(shape, 0.1, (0.41, 0.4), None, 3).any()
