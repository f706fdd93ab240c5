"""The radius graph: its edges against SciPy's tree, its offsets against brute force, and its smooth ends."""

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from datasets.errors import WorkFailed
from gns.network.graph import mean_envelope_sum, radius_graph
from gns.network.messages import messages


def assert_right(positions: Tensor, radius: float, batch: Tensor | None = None) -> None:
    """SciPy's pairs of slightly more than the radius, then those within it, in the order of receivers and senders."""
    points = positions.double().numpy()
    samples = np.zeros(len(points), dtype=int) if batch is None else batch.numpy()
    pairs = [np.empty((0, 2), dtype=int)]
    for sample in np.unique(samples):
        (members,) = np.nonzero(samples == sample)
        pairs.append(members[cKDTree(points[members]).query_pairs(radius * (1.0 + 1e-9), output_type="ndarray")])
    one_way = np.concatenate(pairs)
    square = sum((points[one_way[:, 0], axis] - points[one_way[:, 1], axis]) ** 2 for axis in range(points.shape[1]))
    one_way = one_way[square <= radius * radius]
    senders, receivers = np.concatenate((one_way, one_way[:, ::-1])).T
    order = np.lexsort((senders, receivers))
    graph = radius_graph(positions, radius, batch)
    np.testing.assert_array_equal(graph.edge_index.numpy(), np.stack((senders[order], receivers[order])))
    counts = np.bincount(receivers, minlength=len(positions))
    np.testing.assert_array_equal(graph.starts.numpy(), np.concatenate(([0], np.cumsum(counts))))


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("count", [0, 1, 2, 30, 5000])
def test_random_clouds_of_separate_samples(count: int, dimension: int) -> None:
    generator = torch.Generator().manual_seed(count)
    positions = torch.rand(count, dimension, generator=generator) - 0.3
    radius = 0.05 if dimension == 2 else 0.1
    assert_right(positions, radius)
    # Sample 2 is empty; the samples overlap and come in any order.
    assert_right(positions, radius, torch.tensor([0, 1, 3])[torch.randint(3, (count,), generator=generator)])


@pytest.mark.parametrize("share", [1.0, 1.0 / 2.0, 1.0 / 3.0])
@pytest.mark.parametrize("kind", [torch.float32, torch.float64])
def test_particles_at_just_the_radius_on_the_edges_of_cells(share: float, kind: torch.dtype) -> None:
    radius = 0.025
    assert_right((torch.cartesian_prod(*[torch.arange(9.0)] * 3) * share * radius + 0.1).to(kind), radius)


def test_particles_that_coincide_and_one_that_is_far_away() -> None:
    positions = torch.rand(40, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64).repeat(3, 1)
    assert_right(positions, 0.15)
    # It costs neither memory nor neighbours.
    positions[7] = torch.tensor((1.0e15, -1.0e15))
    assert_right(positions, 0.15)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_positions_that_are_not_finite_end_a_rollout_in_one_line(value: float) -> None:
    positions = torch.zeros(5, 2)
    positions[3, 1] = value
    with pytest.raises(WorkFailed, match="no longer finite"):
        radius_graph(positions, 0.1)


def test_a_message_fades_out_with_zero_value_and_slope() -> None:
    one = torch.ones(2, 1, dtype=torch.float64)
    for distance, value, slope in ((0.5, 0.5625, -1.5), (1.0 - 1e-9, 0.0, 0.0)):
        apart = torch.tensor(2.0 * distance, dtype=torch.float64, requires_grad=True)
        positions = torch.stack((torch.zeros(2, dtype=torch.float64), torch.stack((apart, torch.zeros_like(apart)))))
        # silu(40) is 40: what is left is the envelope.
        sent = messages(20.0 * one, 20.0 * one, torch.zeros(3, 1, dtype=torch.float64), radius_graph(positions, 2.0))
        (gradient,) = torch.autograd.grad(sent[0, 0], apart)
        assert sent[0].item() / 40.0 == pytest.approx(value, abs=1e-8)
        assert 2.0 * gradient.item() / 40.0 == pytest.approx(slope, abs=1e-8)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_particles_that_coincide_have_finite_gradients(dtype: torch.dtype) -> None:
    positions = torch.zeros(2, 2, dtype=dtype, requires_grad=True)
    ones = [torch.ones(*shape, dtype=dtype) for shape in ((2, 4), (2, 4), (3, 4))]
    (gradient,) = torch.autograd.grad(messages(*ones, radius_graph(positions, 1.0)).sum(), positions)
    assert torch.isfinite(gradient).all()


@pytest.mark.parametrize(("dimension", "count"), [(2, 60), (3, 24)])
def test_the_mean_envelope_sum_is_that_of_a_lattice(dimension: int, count: int) -> None:
    spacing = 1.0 / count
    axis = np.arange(-count, count + 1) * spacing
    lattice = np.stack(np.meshgrid(*[axis] * dimension, indexing="ij"), axis=-1)
    square = np.square(lattice).sum(axis=-1)
    total = np.square(np.clip(1.0 - square, 0.0, None)).sum()
    assert mean_envelope_sum(1.0, spacing**dimension, dimension) == pytest.approx(total, rel=1e-3)


def random_inputs(dimension: int, width: int) -> list[Tensor]:
    """Positions, receiver, sender and weight."""
    torch.manual_seed(0)
    shapes = (40, width), (40, width), (dimension + 1, width)
    return [torch.rand(40, dimension), *(torch.randn(*shape) for shape in shapes)]


def summed(inputs: list[Tensor]) -> Tensor:
    """The messages; in double precision by their definition."""
    positions, *others = inputs
    return messages(*others, radius_graph(positions, 0.4))


# Widths that fill no vector, one, and more with a rest.
@pytest.mark.parametrize("width", [1, 37])
@pytest.mark.parametrize("dimension", [2, 3])
def test_the_fused_sum_equals_the_definition(dimension: int, width: int) -> None:
    inputs = random_inputs(dimension, width)
    # Far out on both sides of the sigmoid too.
    inputs[1][0], inputs[1][1] = 300.0, -300.0
    expected = summed([tensor.double() for tensor in inputs]).float()
    torch.testing.assert_close(summed(inputs), expected, atol=5e-5, rtol=5e-5)


@pytest.mark.parametrize("frozen", [None, 0, 3])
@pytest.mark.parametrize("dimension", [2, 3])
def test_its_gradients_are_those_of_the_definition(frozen: int | None, dimension: int) -> None:
    inputs, seed = random_inputs(dimension, 21), torch.randn(40, 21)
    gradients = []
    for dtype in (torch.float32, torch.float64):
        copies = [tensor.to(dtype) for tensor in inputs]
        leaves = [leaf.requires_grad_() for index, leaf in enumerate(copies) if index != frozen]
        gradients.append(torch.autograd.grad(summed(copies), leaves, seed.to(dtype)))
    for got, expected in zip(*gradients, strict=True):
        torch.testing.assert_close(got, expected.float(), atol=5e-4, rtol=5e-4)


def test_nan_stays_visible() -> None:
    inputs = random_inputs(2, 16)
    sender, receiver = radius_graph(inputs[0], 0.4).edge_index[:, 0].tolist()
    inputs[2][sender] = torch.nan
    assert summed(inputs)[receiver].isnan().any()
