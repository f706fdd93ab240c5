"""The fused sum of the messages is its definition in PyTorch Geometric, and so are its gradients."""

import pytest
import torch
from torch import Tensor

from gns.graph import Graph, radius_graph
from gns.messages import message_sum, messages


def random_inputs(dimension: int, width: int) -> tuple[Graph, list[Tensor]]:
    """A random graph, and receiver, sender and weight."""
    torch.manual_seed(0)
    graph = radius_graph(torch.rand(40, dimension), 0.4)
    shapes = (40, width), (40, width), (dimension + 1, width)
    return graph, [torch.randn(*shape) for shape in shapes]


# Widths that fill no vector, one, and more with a rest.
@pytest.mark.parametrize("width", [1, 37])
@pytest.mark.parametrize("dimension", [2, 3])
def test_the_fused_sum_equals_the_definition(dimension: int, width: int) -> None:
    graph, inputs = random_inputs(dimension, width)
    # Far out on both sides of the sigmoid too.
    inputs[0][0], inputs[0][1] = 300.0, -300.0
    expected = message_sum(*inputs, graph)
    torch.testing.assert_close(messages(*inputs, graph), expected, atol=2e-5, rtol=2e-5)


@pytest.mark.parametrize("frozen", ["nothing", "positions", "weight"])
@pytest.mark.parametrize("dimension", [2, 3])
def test_its_gradients_are_those_of_the_definition(frozen: str, dimension: int) -> None:
    graph, inputs = random_inputs(dimension, 21)
    seed = torch.randn(40, 21)
    leaves = [*inputs[:2], *([] if frozen == "weight" else inputs[2:])]
    if frozen != "positions":
        leaves += [graph.edge_attr, graph.edge_weight]
    for leaf in leaves:
        leaf.requires_grad_()
    fused, defined = (torch.autograd.grad(form(*inputs, graph), leaves, seed) for form in (messages, message_sum))
    for got, expected in zip(fused, defined, strict=True):
        torch.testing.assert_close(got, expected, atol=2e-4, rtol=2e-4)


def test_nan_stays_visible() -> None:
    graph, inputs = random_inputs(2, 16)
    sender, receiver = graph.edge_index[:, 0].tolist()
    inputs[1][sender] = torch.nan
    assert messages(*inputs, graph)[receiver].isnan().any()
