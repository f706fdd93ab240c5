"""The fused sum of the messages is its definition in PyTorch Geometric, and so are its gradients and the network."""

import pytest
import torch
from torch import Tensor

from gns import network
from gns.graph import Graph, radius_graph
from gns.messages import message_sum, messages
from gns.simulator import Simulator
from tests.gns.conftest import Cloud


def random_inputs(dimension: int, width: int, dtype: torch.dtype) -> tuple[Graph, list[Tensor]]:
    """A random graph, and receiver, sender and weight."""
    torch.manual_seed(0)
    graph = radius_graph(torch.rand(40, dimension, dtype=dtype), 0.4)
    shapes = (40, width), (40, width), (dimension + 1, width)
    return graph, [torch.randn(*shape, dtype=dtype) for shape in shapes]


# Widths that fill no vector, one, and more with a rest.
@pytest.mark.parametrize("width", [1, 37])
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 2e-5), (torch.float64, 1e-12)])
def test_the_fused_sum_equals_the_definition(dimension: int, width: int, dtype: torch.dtype, tolerance: float) -> None:
    graph, inputs = random_inputs(dimension, width, dtype)
    # Far out on both sides of the sigmoid too.
    inputs[0][0], inputs[0][1] = 300.0, -300.0
    expected = message_sum(*inputs, graph)
    torch.testing.assert_close(messages(*inputs, graph), expected, atol=tolerance, rtol=tolerance)


@pytest.mark.parametrize("with_positions", [True, False])
@pytest.mark.parametrize("with_weight", [True, False])
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 2e-4), (torch.float64, 1e-10)])
def test_its_gradients_are_those_of_the_definition(
    with_positions: bool, with_weight: bool, dimension: int, dtype: torch.dtype, tolerance: float
) -> None:
    graph, inputs = random_inputs(dimension, 21, dtype)
    inputs[2].requires_grad_(with_weight)
    seed = torch.randn(40, 21, dtype=dtype)
    leaves = [*inputs[:2], *([inputs[2]] if with_weight else [])]
    if with_positions:
        leaves += [graph.edge_attr, graph.edge_weight]
    for leaf in leaves:
        leaf.requires_grad_()
    fused, defined = (torch.autograd.grad(form(*inputs, graph), leaves, seed) for form in (messages, message_sum))
    for got, expected in zip(fused, defined, strict=True):
        torch.testing.assert_close(got, expected, atol=tolerance, rtol=tolerance)


def test_a_step_of_the_network_is_the_definitions(
    lively: Simulator, cloud: Cloud, monkeypatch: pytest.MonkeyPatch
) -> None:
    state, conditions = cloud(lower=(0.0, 0.0))
    friction = conditions.friction.requires_grad_()
    results = []
    for form in (messages, message_sum):
        monkeypatch.setattr(network, "messages", form)
        positions = lively(state, conditions).positions
        results.append((positions, *torch.autograd.grad(positions.square().sum(), friction)))
    for fused, defined in zip(*results, strict=True):
        torch.testing.assert_close(fused, defined, atol=1e-6, rtol=1e-4)


def test_nan_stays_visible() -> None:
    graph, inputs = random_inputs(2, 16, torch.float32)
    sender, receiver = graph.edge_index[:, 0].tolist()
    inputs[1][sender] = torch.nan
    assert messages(*inputs, graph)[receiver].isnan().any()
