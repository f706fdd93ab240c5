"""The radius graph against brute force, and its smooth ends."""

import numpy as np
import pytest
import torch

from gns.model.graph import mean_envelope_sum, radius_graph


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("count", [1, 2, 150])
def test_edges_and_offsets_are_those_of_brute_force(dimension: int, count: int) -> None:
    positions = torch.rand(count, dimension, generator=torch.Generator().manual_seed(count))
    batch = torch.arange(count) % 3
    offsets = positions.unsqueeze(0) - positions.unsqueeze(1)
    near = (offsets.norm(dim=2) <= 0.2) & (batch.unsqueeze(1) == batch) & ~torch.eye(count, dtype=torch.bool)
    receivers, senders = near.nonzero().T
    graph = radius_graph(positions, 0.2, batch)
    assert torch.equal(graph.edge_index[1], receivers)
    assert torch.equal(graph.edge_index[0], senders)
    assert torch.equal(graph.starts.diff(), near.sum(dim=1))
    offset = offsets[receivers, senders] / 0.2
    torch.testing.assert_close(graph.edge_attr, torch.cat((offset, offset.norm(dim=1, keepdim=True)), dim=1))


def test_an_edge_fades_out_with_zero_value_and_slope() -> None:
    for distance, value, slope in ((0.5, 0.5625, -1.5), (1.0 - 1e-9, 0.0, 0.0)):
        apart = torch.tensor(distance, dtype=torch.float64, requires_grad=True)
        positions = torch.stack((torch.zeros(2, dtype=torch.float64), torch.stack((apart, torch.zeros_like(apart)))))
        envelope = radius_graph(positions, 1.0).edge_weight
        (gradient,) = torch.autograd.grad(envelope[0, 0], apart)
        assert envelope[0].item() == pytest.approx(value, abs=1e-8)
        assert gradient.item() == pytest.approx(slope, abs=1e-8)


def test_particles_that_coincide_have_finite_gradients() -> None:
    positions = torch.zeros(2, 2, requires_grad=True)
    graph = radius_graph(positions, 1.0)
    (gradient,) = torch.autograd.grad(graph.edge_attr.sum() + graph.edge_weight.sum(), positions)
    assert torch.isfinite(gradient).all()


@pytest.mark.parametrize(("dimension", "count"), [(2, 60), (3, 24)])
def test_the_mean_envelope_sum_is_that_of_a_lattice(dimension: int, count: int) -> None:
    spacing = 1.0 / count
    axis = np.arange(-count, count + 1) * spacing
    lattice = np.stack(np.meshgrid(*[axis] * dimension, indexing="ij"), axis=-1)
    square = np.square(lattice).sum(axis=-1)
    total = np.square(np.clip(1.0 - square, 0.0, None)).sum()
    assert mean_envelope_sum(1.0, spacing**dimension, dimension) == pytest.approx(total, rel=1e-3)
