"""The fused messages are the definition, and so is their gradient."""

import pytest
import torch

from gns import messages
from gns.graph import radius_graph
from gns.messages import FusedMessages, Interaction


def test_the_fused_form_equals_the_definition() -> None:
    torch.manual_seed(0)
    graph = radius_graph(torch.rand(300, 2, dtype=torch.float64), 0.2)
    layer = Interaction(8, 2).double()
    x = torch.randn(300, 8, dtype=torch.float64)
    assert graph.edge_index.shape[1] > 2 * messages.EDGES_AT_ONCE
    assert layer.fuse
    fused = layer(x, graph.edge_index, graph.offsets, graph.envelope)
    layer.fuse = False
    torch.testing.assert_close(fused, layer(x, graph.edge_index, graph.offsets, graph.envelope))


def test_the_gradient_of_every_input_is_right(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(messages, "EDGES_AT_ONCE", 7)
    torch.manual_seed(0)
    graph = radius_graph(torch.rand(12, 2, dtype=torch.float64), 0.5)
    senders, receivers = graph.edge_index.as_tensor()
    assert len(senders) > 14
    inputs = [torch.randn(*shape, dtype=torch.float64) for shape in ((12, 4), (12, 4), (len(senders), 3), (3, 4))]
    inputs.append(torch.rand(len(senders), 1, dtype=torch.float64))
    for tensor in inputs:
        tensor.requires_grad_()
    assert torch.autograd.gradcheck(lambda *given: FusedMessages.apply(*given, senders, receivers), inputs)
