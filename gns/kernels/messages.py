"""The sum of the messages on a CPU, fused: defined in `gns.model.interaction`, and equal to it within rounding."""

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from gns.kernels import edges as kernel

if TYPE_CHECKING:
    from gns.model.graph import Graph


def fused_message_sum(receiver: Tensor, sender: Tensor, weight: Tensor, graph: "Graph") -> Tensor:
    """m [N, C] from a [N, C], b [N, C], W_e [D + 1, C] and a graph on the CPU."""
    total: Tensor = FusedSum.apply(  # type: ignore[no-untyped-call]
        receiver, sender, weight, graph.edge_attr, graph.edge_weight, graph.edge_index[0], graph.starts
    )
    return total


class FusedSum(torch.autograd.Function):
    """Edge by edge: nothing of size [E, C] is ever stored, and the backward pass computes it anew."""

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
        with_positions = ctx.needs_input_grad[3] or ctx.needs_input_grad[4]
        with_weight = ctx.needs_input_grad[2]
        to_receiver, to_sender = torch.zeros_like(receiver), torch.zeros_like(sender)
        to_offsets, to_envelope = torch.empty_like(offsets), torch.empty_like(envelope)
        to_weight = torch.zeros_like(weight)
        kernel.gradients(
            receiver.numpy(), sender.numpy(), offsets.numpy(), weight.numpy(), envelope.view(-1).numpy(),
            senders.numpy(), starts.numpy(), gradients[0].contiguous().numpy(),
            to_receiver.numpy(), to_sender.numpy(), to_offsets.numpy(), to_weight.numpy(), to_envelope.view(-1).numpy(),
            with_positions, with_weight,
        )  # fmt: skip
        return (
            to_receiver,
            to_sender,
            to_weight if with_weight else None,
            to_offsets if with_positions else None,
            to_envelope if with_positions else None,
            None,
            None,
        )
