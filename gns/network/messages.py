"""The messages: each node's sum over its neighbours, defined with PyTorch Geometric, and compiled for a CPU.

    m_i = sum_j w_ij silu(a_i + b_j + W_x (x_j - x_i) + W_d d_ij)
    d_ij = |x_j - x_i|,   w_ij = (1 - d_ij^2)^2

`MessageSum` is the definition; it runs on a GPU and in double precision. On a CPU `FusedSum` gives the same within
rounding: torch operations (gather, product, sigmoid, scatter) move every edge through memory eight times; in the Numba
kernels it stays in registers. Terms linear in the offset are products per node, W_x x_j and -W_x x_i.

| symbol     | variable             | meaning                                                        |
| a_i, b_j   | `receiver`, `sender` | linear in the latents of receiver and sender, shape [N, C]     |
| W_x, W_d   | `weight`             | weight of offset and distance, shape [D + 1, C]                |
| x          | `Graph.positions`    | over the cutoff radius, shape [N, D]                           |
| w_ij       |                      | envelope, zero with zero slope at the cutoff radius            |
"""

from functools import cache
from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from gns.network.features import EDGES, SQUARE_FLOOR
from gns.network.graph import Graph
from gns.surroundings.state import computed

FAST = {"contract", "reassoc", "nsz", "arcp"}
"""Sums may be reordered, so that they can be vectorised; NaN and infinity keep their meaning."""
LOG2_E, LN_2 = np.float32(1.4426950408889634), np.float32(0.6931471805599453)
ZERO, ONE, FOUR = np.float32(0.0), np.float32(1.0), np.float32(4.0)
C2, C3, C4, C5, C6 = (np.float32(1.0 / k) for k in (2, 6, 24, 120, 720))
MAX_EXPONENT = np.float32(126.0)  # exponents of a float32 lie within this on both sides of zero
BIAS, MANTISSA_BITS = np.int32(127), np.int32(23)  # layout of a float32
FLOOR = np.float32(SQUARE_FLOOR)
FUSED = ("offset over the radius", "distance over the radius")  # the features of an edge that the kernels know


def messages(receiver: Tensor, sender: Tensor, weight: Tensor, graph: Graph) -> Tensor:
    """m [N, C] from a [N, C], b [N, C], the weight of `EDGES` (W_x and W_d) [D + 1, C] and the graph."""
    if not receiver.is_cpu or receiver.dtype == torch.float64 or tuple(EDGES) != FUSED:
        total = _definition()(graph.edge_index, a=receiver, b=sender, x=graph.positions, weight=weight)
        return torch.as_tensor(total)
    # Half-precision products, as in training, are summed in single precision.
    receiver, sender, weight = receiver.float(), sender.float(), weight.float()
    with torch.autocast("cpu", enabled=False):
        placed = graph.positions @ weight[:-1]
    fused: Tensor = FusedSum.apply(  # type: ignore[no-untyped-call]
        receiver - placed, sender + placed, weight[-1], graph.positions, graph.edge_index[0], graph.starts
    )
    return fused


@cache
def _definition() -> Any:
    """The definition, made when it is first needed: importing PyTorch Geometric takes seconds."""
    from torch_geometric.nn import MessagePassing

    class MessageSum(MessagePassing):  # type: ignore[misc]
        def forward(self, edge_index: Tensor, **given: Tensor) -> Tensor:
            return torch.as_tensor(self.propagate(edge_index, **given))

        def message(self, a_i: Tensor, b_j: Tensor, x_i: Tensor, x_j: Tensor, weight: Tensor) -> Tensor:
            """The message along each edge [E, C]; i is its receiver, j its sender."""
            offset = x_j - x_i
            envelope = (1.0 - offset.square().sum(dim=1, keepdim=True)).clamp(min=0.0).square()
            return envelope * functional.silu(a_i + b_j + computed(EDGES, offset) @ weight)

    return MessageSum(aggr="sum", flow="source_to_target")


class FusedSum(torch.autograd.Function):
    """Edge by edge on a CPU: nothing of size [E, C] is ever stored; the backward pass recomputes it."""

    @staticmethod
    def forward(
        ctx: Any, receiver: Tensor, sender: Tensor, weight: Tensor, positions: Tensor, senders: Tensor, starts: Tensor
    ) -> Tensor:
        """a - W_x x [N, C], b + W_x x [N, C], W_d [C], x [N, D], senders [E], starts [N + 1] to m [N, C]."""
        given = [tensor.contiguous() for tensor in (receiver, sender, weight, positions, senders, starts)]
        ctx.save_for_backward(*given)
        total = torch.empty_like(receiver)
        _sums(*(tensor.detach().numpy() for tensor in given), total.numpy())  # type: ignore[call-arg]
        return total

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        """Gradients with respect to the first four inputs."""
        given = ctx.saved_tensors
        of_inputs = [torch.zeros_like(tensor) for tensor in given[:4]]
        arrays = [tensor.detach().numpy() for tensor in (*given, gradients[0].contiguous(), *of_inputs)]
        _gradients(*arrays, *ctx.needs_input_grad[2:4])
        return *of_inputs, None, None


@numba.njit(inline="always", fastmath=FAST, error_model="numpy")
def _sigmoid(h: Any) -> Any:
    """1 / (1 + exp(-h)) to a few units in the last place, without a call, which would prevent vectorisation. exp(-h) =
    2^t = 2^n 2^f with |f| <= 1/2, and 2^f = exp(f ln 2) by its Taylor series."""
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


@numba.njit(inline="always", fastmath=FAST, error_model="numpy")
def _squares(positions, i, senders, squares):  # type: ignore[no-untyped-def]
    """d^2 of node i and each of its senders."""
    for e in range(len(senders)):
        squares[e] = ZERO
    for d in range(positions.shape[1]):
        for e in range(len(senders)):
            offset = positions[senders[e], d] - positions[i, d]
            squares[e] += offset * offset


@numba.njit(fastmath=FAST, error_model="numpy", cache=True, nogil=True)
def _sums(receiver, sender, weight, positions, senders, starts, total):  # type: ignore[no-untyped-def]
    """m_i = sum_j w_ij silu(a_i + b_j + W_d d_ij)."""
    channels = receiver.shape[1]
    squares = np.empty(max(1, (starts[1:] - starts[:-1]).max()), receiver.dtype)
    for i in range(len(receiver)):
        a, m, near = receiver[i], total[i], senders[starts[i] : starts[i + 1]]
        _squares(positions, i, near, squares)
        for c in range(channels):
            m[c] = ZERO
        for e in range(len(near)):
            b, distance, inside = sender[near[e]], np.sqrt(squares[e] + FLOOR), max(ONE - squares[e], ZERO)
            w = inside * inside
            for c in range(channels):
                h = a[c] + b[c] + distance * weight[c]
                m[c] += w * (h * _sigmoid(h))


@numba.njit(fastmath=FAST, error_model="numpy", cache=True, nogil=True)
def _gradients(  # type: ignore[no-untyped-def]
    receiver, sender, weight, positions, senders, starts,
    gradient, to_receiver, to_sender, to_weight, to_positions, with_weight, with_positions,
):  # fmt: skip
    """The gradients of that sum, given those of m_i. silu(h) = h s(h) has the slope s + silu (1 - s)."""
    channels, dimension = receiver.shape[1], positions.shape[1]
    inner = np.empty(channels, receiver.dtype)
    squares = np.empty(max(1, (starts[1:] - starts[:-1]).max()), receiver.dtype)
    for i in range(len(receiver)):
        a, g, to_a, near = receiver[i], gradient[i], to_receiver[i], senders[starts[i] : starts[i + 1]]
        _squares(positions, i, near, squares)
        for e in range(len(near)):
            j = near[e]
            b, to_b = sender[j], to_sender[j]
            distance, inside = np.sqrt(squares[e] + FLOOR), max(ONE - squares[e], ZERO)
            w, to_envelope, to_distance = inside * inside, ZERO, ZERO
            # One array per loop: the compiler cannot prove that several do not overlap.
            for c in range(channels):
                h = a[c] + b[c] + distance * weight[c]
                s = _sigmoid(h)
                activated = h * s
                slope = (s + activated * (ONE - s)) * g[c] * w
                to_envelope += g[c] * activated
                to_distance += slope * weight[c]
                inner[c] = slope
            for c in range(channels):
                to_a[c] += inner[c]
            for c in range(channels):
                to_b[c] += inner[c]
            if with_weight:
                for c in range(channels):
                    to_weight[c] += distance * inner[c]
            if with_positions:
                # d w / d(d^2) = -2 (1 - d^2), and d(d^2) / dx_j = 2 (x_j - x_i).
                along = to_distance / distance - FOUR * inside * to_envelope
                for d in range(dimension):
                    part = along * (positions[j, d] - positions[i, d])
                    to_positions[j, d] += part
                    to_positions[i, d] -= part
