"""Both cell lists against SciPy's tree, and lists of candidates against a fresh search."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from datasets.command_line import WorkFailed
from gns.kernels import neighbours as module
from gns.kernels.neighbours import Edges, NeighbourList, closer, closer_by_torch, neighbours, neighbours_by_torch
from gns.model.simulator import Simulator
from gns.model.state import Conditions, State
from gns.unroll import unroll

Cloud = Callable[..., tuple[State, Conditions]]
Find = Callable[[Tensor, float, Tensor | None], Edges]
both = pytest.mark.parametrize("find", [neighbours, neighbours_by_torch])


def oracle(positions: Tensor, radius: float, batch: Tensor | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Senders and receivers in order: SciPy's pairs of a hair more than the radius, then those that are near."""
    points = positions.double().numpy()
    samples = np.zeros(len(points), dtype=int) if batch is None else batch.numpy()
    pairs = [np.empty((0, 2), dtype=int)]
    for sample in np.unique(samples):
        (members,) = np.nonzero(samples == sample)
        tree = cKDTree(points[members])
        pairs.append(members[tree.query_pairs(radius * (1.0 + 1e-9), output_type="ndarray")])
    one_way = np.concatenate(pairs)
    square = sum((points[one_way[:, 0], axis] - points[one_way[:, 1], axis]) ** 2 for axis in range(points.shape[1]))
    one_way = one_way[square <= radius * radius]
    senders, receivers = np.concatenate((one_way, one_way[:, ::-1])).T
    order = np.lexsort((senders, receivers))
    return senders[order], receivers[order]


def assert_right(edges: Edges, positions: Tensor, radius: float, batch: Tensor | None = None) -> None:
    senders, receivers = oracle(positions, radius, batch)
    np.testing.assert_array_equal(edges.senders.numpy(), senders)
    np.testing.assert_array_equal(edges.receivers.numpy(), receivers)
    counts = np.bincount(receivers, minlength=len(positions))
    np.testing.assert_array_equal(edges.starts.numpy(), np.concatenate(([0], np.cumsum(counts))))
    assert {tensor.dtype for tensor in (edges.senders, edges.receivers, edges.starts)} == {torch.int64}


def assert_same(edges: Edges, others: Edges) -> None:
    for name in ("senders", "receivers", "starts"):
        assert torch.equal(getattr(edges, name), getattr(others, name)), name


def lattice(count: int, spacing: float, dimension: int) -> Tensor:
    return torch.cartesian_prod(*[torch.arange(float(count))] * dimension) * spacing


@both
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("count", [0, 1, 2, 30, 700])
def test_random_clouds_in_samples_that_never_meet(find: Find, count: int, dimension: int) -> None:
    generator = torch.Generator().manual_seed(count)
    positions = torch.rand(count, dimension, generator=generator) - 0.3
    radius = 0.1 if dimension == 2 else 0.2
    assert_right(find(positions, radius, None), positions, radius)
    # Sample 2 is empty; the samples lie in each other and come in any order.
    batch = torch.tensor([0, 1, 3])[torch.randint(3, (count,), generator=generator)]
    assert_right(find(positions, radius, batch), positions, radius, batch)


@both
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("share", [1.0, 1.0 / 2.0, 1.0 / 3.0])
@pytest.mark.parametrize("kind", [torch.float32, torch.float64])
def test_points_at_just_the_radius_on_the_edges_of_cells(
    find: Find, dimension: int, share: float, kind: torch.dtype
) -> None:
    """Some distances are the radius but for rounding: both must round alike."""
    radius = 0.025
    positions = (lattice(9, share * radius, dimension) + 0.1).to(kind)
    assert_right(find(positions, radius, None), positions, radius)


@both
def test_points_that_coincide(find: Find) -> None:
    positions = torch.rand(40, 2, generator=torch.Generator().manual_seed(0)).repeat(3, 1)
    assert_right(find(positions, 0.15, None), positions, 0.15)
    heap = torch.full((90, 3), 0.7)
    edges = find(heap, 0.02, None)
    assert len(edges.senders) == 90 * 89
    assert_right(edges, heap, 0.02)


@both
@pytest.mark.parametrize("away", [1.0e3, 1.0e15])
def test_one_point_that_flew_off_costs_neither_memory_nor_neighbours(find: Find, away: float) -> None:
    positions = lattice(12, 0.01, 2).double()
    positions[7] = torch.tensor((away, -away))
    assert_right(find(positions, 0.025, None), positions, 0.025)


@both
@pytest.mark.parametrize(("dimension", "radius"), [(2, 0.0125), (3, 0.06)])
def test_a_large_cloud(find: Find, dimension: int, radius: float) -> None:
    positions = torch.rand(20_000, dimension, generator=torch.Generator().manual_seed(3))
    assert_right(find(positions, radius, None), positions, radius)


def test_blocks_of_candidates_do_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "POINTS_AT_ONCE", 37)
    positions = torch.rand(200, 2, generator=torch.Generator().manual_seed(1))
    assert_right(neighbours_by_torch(positions, 0.1), positions, 0.1)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
def test_a_gpu_finds_the_same() -> None:
    positions = torch.rand(3_000, 3, generator=torch.Generator().manual_seed(1))
    batch = torch.arange(3_000) % 3
    candidates = neighbours(positions.cuda(), 0.12, batch.cuda())
    for edges in (neighbours(positions.cuda(), 0.1, batch.cuda()), closer(candidates, positions.cuda(), 0.1)):
        assert edges.senders.is_cuda
        ours = Edges(senders=edges.senders.cpu(), receivers=edges.receivers.cpu(), starts=edges.starts.cpu())
        assert_right(ours, positions, 0.1, batch)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_rollout_that_blew_up_is_told_in_a_line(value: float) -> None:
    positions = torch.zeros(5, 2)
    calm = NeighbourList(0.1)
    for _ in range(3):
        calm(positions)
    positions[3, 1] = value
    for find in (lambda: neighbours(positions, 0.1), lambda: calm(positions)):
        with pytest.raises(WorkFailed, match="no longer finite"):
            find()


@pytest.mark.parametrize("dimension", [2, 3])
def test_candidates_give_what_a_fresh_search_gives_in_a_walk_there_and_back(dimension: int) -> None:
    generator = torch.Generator().manual_seed(dimension)
    radius, positions = 0.15, torch.rand(300, dimension, generator=generator)
    batch = torch.arange(300) % 2
    drift = torch.randn(positions.shape, generator=generator)
    # The furthest point moves by 0.03 radii a step, where a skin of 0.3 radii serves five, and then by 0.12.
    steps = [0.03 * radius / drift.norm(dim=1).max() * drift * (1.0 if step < 20 else 4.0) for step in range(25)]
    walk = [positions]
    for step in steps:
        walk.append(walk[-1] + step)
    followed = NeighbourList(radius)
    for points in walk + walk[::-1]:
        assert_same(followed(points, batch), neighbours(points, radius, batch))
    calls = 2 * len(walk)
    assert calls / 5 < followed.searches < calls / 2, followed.searches


@pytest.mark.parametrize("dimension", [2, 3])
def test_candidates_serve_until_a_point_has_moved_by_half_the_skin(dimension: int) -> None:
    """Two points that close in on each other from just outside the radius and the skin."""
    radius, skin = 0.1, 0.04
    apart = torch.zeros(2, dimension, dtype=torch.float64)
    apart[1, 0] = radius + skin + 1e-4
    inwards = torch.zeros_like(apart)
    inwards[0, 0], inwards[1, 0] = 1.0, -1.0
    near = NeighbourList(radius, skin)
    near(apart)
    for moved, searches, edges in ((0.0, 2, 0), (0.0199, 2, 0), (0.0201, 3, 2), (0.0199, 4, 0), (0.0, 4, 0)):
        assert len(near(apart + moved * inwards).senders) == edges
        assert near.searches <= searches


def test_a_fast_flow_is_searched_anew_and_a_deposit_is_not() -> None:
    positions, radius = lattice(15, 0.01, 2), 0.025
    flow, rest = NeighbourList(radius), NeighbourList(radius)
    for step in range(10):
        flow(positions + 0.1 * radius * step)
        rest(positions)
    assert (flow.searches, rest.searches) == (10, 2)
    assert flow._candidates is None


def test_candidates_of_others_are_not_used() -> None:
    """Another batch, other points, points that moved in place."""
    positions, radius = torch.rand(60, 2, generator=torch.Generator().manual_seed(5)), 0.2
    batches = (None, torch.arange(60) % 2, torch.arange(60) // 20)
    found = NeighbourList(radius)
    for batch in batches:
        for _ in range(3):
            assert_same(found(positions, batch), neighbours(positions, radius, batch))
    for points in (positions[:50], torch.cat((positions, positions[:, :1]), dim=1), positions[:0]):
        for _ in range(3):
            assert_same(found(points), neighbours(points, radius))
    positions = positions.double()
    for _ in range(3):
        found(positions)
    positions[:30] += 0.3
    assert_same(found(positions), neighbours(positions, radius))


def test_candidates_are_sifted_alike_on_any_device() -> None:
    positions = torch.rand(400, 3, generator=torch.Generator().manual_seed(6))
    candidates = neighbours(positions, 0.25)
    fresh = neighbours(positions, 0.2)
    assert len(fresh.senders) < len(candidates.senders)
    assert_same(closer(candidates, positions, 0.2), fresh)
    assert_same(closer_by_torch(candidates, positions, 0.2), fresh)


def test_a_rollout_and_its_gradient_are_those_of_fresh_searches(lively: Simulator, cloud: Cloud) -> None:
    state, conditions = cloud(lower=(0.45, 0.0))
    lively.requires_grad_(False)
    start = state.positions.requires_grad_()
    followed = unroll(lively, state, conditions, 6)[-1]
    now = state
    for _ in range(6):
        now = lively(now, conditions)
    assert torch.equal(followed, now.positions)
    weights = torch.randn(followed.shape, generator=torch.Generator().manual_seed(0))
    (ours,), (fresh,) = (torch.autograd.grad((end * weights).sum(), start) for end in (followed, now.positions))
    torch.testing.assert_close(ours, fresh)
