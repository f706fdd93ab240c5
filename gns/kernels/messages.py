"""Message passing, the inner loop: what a point hears from its neighbours.

Interaction network after Sanchez-Gonzalez et al. 2020 (Learning to simulate complex physics with graph networks),
rearranged to be cheap. Their message is a network of the concatenation [x_i, x_j, e_ij]. Its first layer splits into
W_i x_i + W_j x_j + W_e e_ij, so that two of three products are per point. Its last layer is linear, hence may follow
the sum over the neighbours: it is per point too, part of the node's update. What is left per edge is

    m_i = sum_j w_ij silu(a_i + b_j + W_e e_ij)

  a_i, b_j   products of receiver and sender      w_ij   envelope of the edge
  e_ij       offset and distance over the radius  W_e    `weight`

The edges carry no latents of their own; the offsets are given anew to every layer.
"""

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from gns.kernels import edges as kernel
from gns.kernels.linear import Linear
from gns.model.graph import Graph


def message_sum(receiver: Tensor, sender: Tensor, weight: Tensor, graph: Graph) -> Tensor:
    """m [N, C] from a [N, C], b [N, C], W_e [D + 1, C] and the graph.

    The definition, for any device: it stores several tensors of size [E, C]. On a CPU use `FusedSum`, which equals it.
    """
    inner = receiver.index_select(0, graph.receivers) + sender.index_select(0, graph.senders) + graph.offsets @ weight
    messages = graph.envelope * functional.silu(inner)
    return messages.new_zeros(receiver.shape).index_add(0, graph.receivers, messages)


class FusedSum(torch.autograd.Function):
    """The same on a CPU, edge by edge. Nothing of size [E, C] is ever stored: the backward pass computes it anew."""

    @staticmethod
    def forward(
        ctx: Any,
        receiver: Tensor,
        sender: Tensor,
        weight: Tensor,
        offsets: Tensor,
        envelope: Tensor,
        senders: Tensor,
        starts: Tensor,
    ) -> Tensor:
        """a [N, C], b [N, C], W_e [D + 1, C], e [E, D + 1], w [E, 1], senders [E], starts [N + 1] to m [N, C]."""
        receiver, sender, weight = receiver.contiguous(), sender.contiguous(), weight.contiguous()
        offsets, envelope = offsets.contiguous(), envelope.contiguous()
        ctx.save_for_backward(receiver, sender, weight, offsets, envelope, senders, starts)
        total = torch.empty_like(receiver)
        kernel.sums(
            receiver.numpy(), sender.numpy(), offsets.numpy(), weight.numpy(), envelope.view(-1).numpy(),
            senders.numpy(), starts.numpy(), total.numpy(),
        )  # fmt: skip
        return total

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        """Gradients with respect to the first five inputs."""
        receiver, sender, weight, offsets, envelope, senders, starts = ctx.saved_tensors
        positions_matter = ctx.needs_input_grad[3] or ctx.needs_input_grad[4]
        weight_matters = ctx.needs_input_grad[2]
        to_receiver, to_sender = torch.zeros_like(receiver), torch.zeros_like(sender)
        to_offsets, to_envelope = torch.empty_like(offsets), torch.empty_like(envelope)
        to_weight = torch.zeros_like(weight)
        kernel.gradients(
            receiver.numpy(), sender.numpy(), offsets.numpy(), weight.numpy(), envelope.view(-1).numpy(),
            senders.numpy(), starts.numpy(), gradients[0].contiguous().numpy(),
            to_receiver.numpy(), to_sender.numpy(), to_offsets.numpy(), to_weight.numpy(), to_envelope.view(-1).numpy(),
            positions_matter, weight_matters,
        )  # fmt: skip
        return (
            to_receiver,
            to_sender,
            to_weight if weight_matters else None,
            to_offsets if positions_matter else None,
            to_envelope if positions_matter else None,
            None,
            None,
        )


class Interaction(nn.Module):
    """m [N, C] from node latents x [N, C] and a graph."""

    def __init__(self, width: int, dimension: int) -> None:
        super().__init__()
        self.from_receiver = Linear(width, width)
        self.from_sender = Linear(width, width, bias=False)
        self.from_offset = Linear(dimension + 1, width, bias=False)

    def forward(self, x: Tensor, graph: Graph) -> Tensor:
        """What each point hears."""
        receiver, sender, weight = self.from_receiver(x), self.from_sender(x), self.from_offset.weight.T
        if x.device.type != "cpu":
            return message_sum(receiver, sender, weight, graph)
        total: Tensor = FusedSum.apply(  # type: ignore[no-untyped-call]
            receiver, sender, weight, graph.offsets, graph.envelope, graph.senders, graph.starts
        )
        return total
