"""The messages: each node's sum over its neighbours, defined with PyTorch Geometric, and compiled for a CPU.

    m_i = sum_j w_ij silu(a_i + b_j + W_e e_ij)

`message_sum` is the definition, a MessagePassing of PyTorch Geometric, and what runs on a GPU and in double precision.
On a CPU `FusedSum` gives the same within rounding: torch has no operation for this sum, and those to build it (gather,
product, sigmoid, scatter) move every edge through memory eight times. In the kernels of Numba an edge stays in
registers, a vector of channels at a time: on one core 15,000 edges of 64 channels take 0.3 ms, and 0.7 ms for their
gradients, against 2 and 9 ms in blocks of torch's operations.

| symbol   | variable             | meaning                                      |
| a_i, b_j | `receiver`, `sender` | linear in the latents of receiver and sender |
| W_e      | `weight`             | weight of the edge's features                |
| e_ij     | `Graph.edge_attr`    | offset and distance over the cutoff radius   |
| w_ij     | `Graph.edge_weight`  | envelope, zero at the cutoff radius          |
"""

from functools import cache
from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from gns.graph import Graph

FAST = {"contract", "reassoc", "nsz", "arcp"}
"""Sums may be reordered, which is what lets them fill vectors; NaN and infinity keep their meaning."""
LOG2_E = np.float32(1.4426950408889634)
LN_2 = np.float32(0.6931471805599453)
ZERO, ONE = np.float32(0.0), np.float32(1.0)
C2, C3, C4, C5, C6 = (np.float32(1.0 / k) for k in (2, 6, 24, 120, 720))
MAX_EXPONENT = np.float32(126.0)
"""Exponents of a float32 lie within this on both sides of zero."""
BIAS, MANTISSA_BITS = np.int32(127), np.int32(23)
"""Layout of a float32."""


def messages(receiver: Tensor, sender: Tensor, weight: Tensor, graph: Graph) -> Tensor:
    """m [N, C] from a [N, C], b [N, C], W_e [D + 1, C] and the graph."""
    if not receiver.is_cpu or receiver.dtype != torch.float32:
        return message_sum(receiver, sender, weight, graph)
    total: Tensor = FusedSum.apply(  # type: ignore[no-untyped-call]
        receiver, sender, weight, graph.edge_attr, graph.edge_weight, graph.edge_index[0], graph.starts
    )
    return total


def message_sum(receiver: Tensor, sender: Tensor, weight: Tensor, graph: Graph) -> Tensor:
    """`messages` by their definition, on any device; stores messages of size [E, C]."""
    size = (len(receiver), len(receiver))
    edge_attr = graph.edge_attr @ weight
    total: Tensor = _definition()(
        graph.edge_index, a=receiver, b=sender, edge_attr=edge_attr, edge_weight=graph.edge_weight, size=size
    )
    return total


@cache
def _definition() -> nn.Module:
    """The definition, made where it is first needed: to import PyTorch Geometric takes seconds."""
    from torch_geometric.nn import MessagePassing

    class MessageSum(MessagePassing):  # type: ignore[misc]
        """m_i = sum_j w_ij silu(a_i + b_j + W_e e_ij)."""

        def __init__(self) -> None:
            super().__init__(aggr="sum", flow="source_to_target")

        def forward(self, edge_index: Tensor, **of_nodes_and_edges: Any) -> Tensor:
            """Sum the messages at each receiver [N, C]."""
            return torch.as_tensor(self.propagate(edge_index, **of_nodes_and_edges))

        def message(self, a_i: Tensor, b_j: Tensor, edge_attr: Tensor, edge_weight: Tensor) -> Tensor:
            """The message along each edge [E, C]; i is its receiver, j its sender."""
            return edge_weight * functional.silu(a_i + b_j + edge_attr)

    return MessageSum()


class FusedSum(torch.autograd.Function):
    """Edge by edge on a CPU: nothing of size [E, C] is ever stored, and the backward pass computes it anew."""

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
        _sums(
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
        _gradients(
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


@numba.njit(inline="always", fastmath=FAST, error_model="numpy")
def _sigmoid(h: Any) -> Any:
    """1 / (1 + exp(-h)) to a few units in the last place, without a call, which would keep the loop from vectors.

    exp(-h) = 2^t = 2^n 2^f with |f| <= 1/2, and 2^f = exp(f ln 2) by its Taylor series.
    """
    t = -h * LOG2_E
    t = t if t < MAX_EXPONENT else MAX_EXPONENT
    t = t if t > -MAX_EXPONENT else -MAX_EXPONENT
    n = np.rint(t)
    f = (t - n) * LN_2
    series = C6
    series = series * f + C5
    series = series * f + C4
    series = series * f + C3
    series = series * f + C2
    series = series * f + ONE
    series = series * f + ONE
    # 2^n: its bits are the biased exponent of a float32.
    power = np.int32((np.int32(n) + BIAS) << MANTISSA_BITS).view(np.float32)
    return ONE / (ONE + series * power)


@numba.njit(fastmath=FAST, error_model="numpy", cache=True, nogil=True)
def _sums(receiver, sender, offsets, weight, envelope, senders, starts, total):  # type: ignore[no-untyped-def]
    """m_i = sum_j w_ij silu(a_i + b_j + W e_ij) for edges of 3 or 4 numbers e_ij."""
    channels, last = receiver.shape[1], offsets.shape[1] - 1
    for i in range(len(receiver)):
        a, m = receiver[i], total[i]
        for c in range(channels):
            m[c] = 0.0
        for e in range(starts[i], starts[i + 1]):
            b = sender[senders[e]]
            w, x, y, z = envelope[e], offsets[e, 0], offsets[e, 1], offsets[e, 2]
            # With three numbers the last comes twice, and counts once: a branch would cost more.
            r = offsets[e, last] if last == 3 else ZERO
            for c in range(channels):
                h = a[c] + b[c] + x * weight[0, c] + y * weight[1, c] + z * weight[2, c] + r * weight[last, c]
                m[c] += w * (h * _sigmoid(h))


@numba.njit(fastmath=FAST, error_model="numpy", cache=True, nogil=True)
def _gradients(  # type: ignore[no-untyped-def]
    receiver, sender, offsets, weight, envelope, senders, starts,
    gradient, to_receiver, to_sender, to_offsets, to_weight, to_envelope, with_positions, with_weight,
):  # fmt: skip
    """The gradients of that sum, given those of m_i. silu(h) = h s(h) has the slope s + silu (1 - s)."""
    channels, last = receiver.shape[1], offsets.shape[1] - 1
    inner = np.empty(channels, receiver.dtype)
    for i in range(len(receiver)):
        a, g, to_a = receiver[i], gradient[i], to_receiver[i]
        for e in range(starts[i], starts[i + 1]):
            b, to_b = sender[senders[e]], to_sender[senders[e]]
            w, x, y, z = envelope[e], offsets[e, 0], offsets[e, 1], offsets[e, 2]
            r = offsets[e, last] if last == 3 else ZERO
            along = ZERO
            # Loops that write to one array each: more of them the compiler cannot prove apart.
            for c in range(channels):
                h = a[c] + b[c] + x * weight[0, c] + y * weight[1, c] + z * weight[2, c] + r * weight[last, c]
                s = _sigmoid(h)
                activated = h * s
                along += g[c] * activated
                inner[c] = (s + activated * (ONE - s)) * g[c] * w
            for c in range(channels):
                to_a[c] += inner[c]
            for c in range(channels):
                to_b[c] += inner[c]
            if with_positions:
                to_envelope[e] = along
                for d in range(last + 1):
                    slope = ZERO
                    for c in range(channels):
                        slope += inner[c] * weight[d, c]
                    to_offsets[e, d] = slope
            if with_weight:
                for d in range(last + 1):
                    o = offsets[e, d]
                    for c in range(channels):
                        to_weight[d, c] += o * inner[c]
