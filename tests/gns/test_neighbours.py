"""Both cell lists against SciPy's tree, and PyTorch Geometric's edges in our order."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
import torch_geometric
from scipy.spatial import cKDTree
from torch import Tensor

from datasets.command_line import WorkFailed
from gns.kernels import neighbours as module
from gns.kernels.neighbours import Edges, neighbours, neighbours_by_pyg, neighbours_by_torch

Find = Callable[[Tensor, float, Tensor | None], Edges]
both = pytest.mark.parametrize("find", [neighbours, neighbours_by_torch])


def oracle(positions: Tensor, radius: float, batch: Tensor | None = None) -> np.ndarray:
    """Senders and receivers in order [2, E]: SciPy's pairs of slightly more than the radius, then those within it."""
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
    return np.stack((senders[order], receivers[order]))


def assert_right(edges: Edges, positions: Tensor, radius: float, batch: Tensor | None = None) -> None:
    expected = oracle(positions, radius, batch)
    np.testing.assert_array_equal(edges.edge_index.numpy(), expected)
    counts = np.bincount(expected[1], minlength=len(positions))
    np.testing.assert_array_equal(edges.starts.numpy(), np.concatenate(([0], np.cumsum(counts))))
    assert {edges.edge_index.dtype, edges.starts.dtype} == {torch.int64}


def lattice(count: int, spacing: float, dimension: int) -> Tensor:
    return torch.cartesian_prod(*[torch.arange(float(count))] * dimension) * spacing


@both
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("count", [0, 1, 2, 30, 700])
def test_random_clouds_of_separate_samples(find: Find, count: int, dimension: int) -> None:
    generator = torch.Generator().manual_seed(count)
    positions = torch.rand(count, dimension, generator=generator) - 0.3
    radius = 0.1 if dimension == 2 else 0.2
    assert_right(find(positions, radius, None), positions, radius)
    # Sample 2 is empty; the samples overlap and come in any order.
    batch = torch.tensor([0, 1, 3])[torch.randint(3, (count,), generator=generator)]
    assert_right(find(positions, radius, batch), positions, radius, batch)


@both
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("share", [1.0, 1.0 / 2.0, 1.0 / 3.0])
@pytest.mark.parametrize("kind", [torch.float32, torch.float64])
def test_particles_at_just_the_radius_on_the_edges_of_cells(
    find: Find, dimension: int, share: float, kind: torch.dtype
) -> None:
    """Some distances are the radius but for rounding: both must round alike."""
    radius = 0.025
    positions = (lattice(9, share * radius, dimension) + 0.1).to(kind)
    assert_right(find(positions, radius, None), positions, radius)


@both
def test_particles_that_coincide(find: Find) -> None:
    positions = torch.rand(40, 2, generator=torch.Generator().manual_seed(0)).repeat(3, 1)
    assert_right(find(positions, 0.15, None), positions, 0.15)
    pile = torch.full((90, 3), 0.7)
    assert find(pile, 0.02, None).edge_index.shape == (2, 90 * 89)


@both
@pytest.mark.parametrize("distance", [1.0e3, 1.0e15])
def test_a_far_particle_costs_neither_memory_nor_neighbours(find: Find, distance: float) -> None:
    positions = lattice(12, 0.01, 2).double()
    positions[7] = torch.tensor((distance, -distance))
    assert_right(find(positions, 0.025, None), positions, 0.025)


@both
@pytest.mark.parametrize(("dimension", "radius"), [(2, 0.0125), (3, 0.06)])
def test_a_large_cloud(find: Find, dimension: int, radius: float) -> None:
    positions = torch.rand(20_000, dimension, generator=torch.Generator().manual_seed(3))
    assert_right(find(positions, radius, None), positions, radius)


def test_blocks_of_candidates_do_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "BLOCK", 37)
    positions = torch.rand(200, 2, generator=torch.Generator().manual_seed(1))
    assert_right(neighbours_by_torch(positions, 0.1), positions, 0.1)


def test_edges_of_pyg_come_in_our_order(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a stand-in for pyg-lib, which has no wheel: edges in any order, and cut off at the limit."""

    def radius_graph(x: Tensor, r: float, batch: Tensor | None, max_num_neighbors: int) -> Tensor:
        index = torch.from_numpy(oracle(x, r, batch))
        rank = torch.arange(index.shape[1]) - torch.searchsorted(index[1].contiguous(), index[1].contiguous())
        index = index[:, rank < max_num_neighbors]
        return index[:, torch.randperm(index.shape[1])]

    positions = torch.rand(300, 2, generator=torch.Generator().manual_seed(2)).double()
    batch = torch.arange(300) // 100
    monkeypatch.setattr(torch_geometric.typing, "WITH_RADIUS", False)
    assert neighbours_by_pyg(positions, 0.1, batch) is None
    monkeypatch.setattr(torch_geometric.typing, "WITH_RADIUS", True)
    monkeypatch.setattr(torch_geometric.nn, "radius_graph", radius_graph)
    edges = neighbours_by_pyg(positions, 0.1, batch)
    assert edges is not None
    assert_right(edges, positions, 0.1, batch)
    # Samples out of order, and more neighbours than the limit.
    assert neighbours_by_pyg(positions, 0.1, batch.flip(0)) is None
    assert neighbours_by_pyg(torch.zeros(400, 2, dtype=torch.float64), 0.1) is None


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
def test_a_gpu_finds_the_same() -> None:
    positions = torch.rand(3_000, 3, generator=torch.Generator().manual_seed(1))
    batch = torch.arange(3_000) % 3
    edges = neighbours(positions.cuda(), 0.1, batch.cuda())
    assert edges.edge_index.is_cuda
    assert_right(Edges(edge_index=edges.edge_index.cpu(), starts=edges.starts.cpu()), positions, 0.1, batch)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_positions_that_are_not_finite_end_a_rollout_in_one_line(value: float) -> None:
    positions = torch.zeros(5, 2)
    positions[3, 1] = value
    with pytest.raises(WorkFailed, match="no longer finite"):
        neighbours(positions, 0.1)
