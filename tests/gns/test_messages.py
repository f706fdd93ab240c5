"""The fused messages are the definition, and so is their gradient."""

import pytest
import torch
from torch import Tensor

from gns.kernels.messages import FusedSum, Interaction, message_sum
from gns.model.graph import Graph, radius_graph


def random_inputs(dimension: int, width: int, dtype: torch.dtype) -> tuple[Graph, list[Tensor]]:
    """A random graph, and receiver, sender and weight."""
    torch.manual_seed(0)
    graph = radius_graph(torch.rand(40, dimension, dtype=dtype), 0.4)
    shapes = (40, width), (40, width), (dimension + 1, width)
    return graph, [torch.randn(*shape, dtype=dtype) for shape in shapes]


def fused(graph: Graph, inputs: list[Tensor]) -> Tensor:
    total: Tensor = FusedSum.apply(*inputs, graph.offsets, graph.envelope, graph.senders, graph.starts)
    return total


# Widths that fill no vector, one, and several with a rest.
@pytest.mark.parametrize("width", [1, 16, 37])
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 2e-5), (torch.float64, 1e-12)])
def test_the_fused_sum_equals_the_definition(dimension: int, width: int, dtype: torch.dtype, tolerance: float) -> None:
    graph, inputs = random_inputs(dimension, width, dtype)
    # Far out on both sides of the sigmoid too.
    inputs[0][0], inputs[0][1] = 300.0, -300.0
    torch.testing.assert_close(fused(graph, inputs), message_sum(*inputs, graph), atol=tolerance, rtol=tolerance)


@pytest.mark.parametrize("positions_matter", [True, False])
@pytest.mark.parametrize("weight_matters", [True, False])
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 2e-4), (torch.float64, 1e-10)])
def test_its_gradients_are_those_of_the_definition(
    positions_matter: bool, weight_matters: bool, dimension: int, dtype: torch.dtype, tolerance: float
) -> None:
    graph, inputs = random_inputs(dimension, 21, dtype)
    inputs[2].requires_grad_(weight_matters)
    wanted = torch.randn(40, 21, dtype=dtype)
    gradients = []
    for form in (lambda: fused(graph, inputs), lambda: message_sum(*inputs, graph)):
        leaves = [*inputs[:2], *([inputs[2]] if weight_matters else [])]
        if positions_matter:
            leaves += [graph.offsets, graph.envelope]
        for leaf in leaves:
            leaf.requires_grad_()
        gradients.append(torch.autograd.grad(form(), leaves, wanted))
    for got, expected in zip(*gradients, strict=True):
        torch.testing.assert_close(got, expected, atol=tolerance, rtol=tolerance)


def test_a_point_without_neighbours_hears_nothing() -> None:
    positions = torch.tensor([[0.0, 0.0], [0.1, 0.0], [5.0, 5.0]])
    layer = Interaction(8, 2)
    heard = layer(torch.randn(3, 8), radius_graph(positions, 0.2))
    assert heard[2].abs().max() == 0.0
    assert heard[0].abs().max() > 0.0


def test_nan_stays_visible() -> None:
    graph, inputs = random_inputs(2, 16, torch.float32)
    inputs[1][int(graph.senders[0])] = torch.nan
    assert fused(graph, inputs)[int(graph.receivers[0])].isnan().any()
