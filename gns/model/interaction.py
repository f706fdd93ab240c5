"""The interaction network of a message-passing step.

After Sanchez-Gonzalez et al. 2020 (Learning to simulate complex physics with graph networks), rearranged to be cheap.
Their message is a network of the concatenation [x_i, x_j, e_ij]. Its first layer splits into W_i x_i + W_j x_j +
W_e e_ij, so that two of three products are per node. Its last layer is linear, hence may follow the sum over the
neighbours: it is per node too, part of the node's update. What is left per edge is

    m_i = sum_j w_ij silu(a_i + b_j + W_e e_ij)

| symbol   | variable                    | meaning                                             |
| a_i, b_j | `from_receiver`, `from_sender` | linear in the latents of receiver and sender     |
| W_e      | `from_offset`               | weight of the edge's features                       |
| e_ij     | `Graph.edge_attr`           | offset and distance over the cutoff radius          |
| w_ij     | `Graph.edge_weight`         | envelope, zero at the cutoff radius                 |

The edges carry no latents of their own; their features enter every step anew.
"""

from functools import cache

import torch
from torch import Tensor, nn

from gns.kernels.messages import fused_message_sum
from gns.model.graph import Graph


class Interaction(nn.Module):
    """m [N, C] from node latents x [N, C] and a graph."""

    def __init__(self, width: int, dimension: int) -> None:
        super().__init__()
        self.from_receiver = nn.Linear(width, width)
        self.from_sender = nn.Linear(width, width, bias=False)
        self.from_offset = nn.Linear(dimension + 1, width, bias=False)

    def forward(self, x: Tensor, graph: Graph) -> Tensor:
        """The sum of the messages to each node."""
        receiver, sender = self.from_receiver(x), self.from_sender(x)
        # Half precision under autocast is not for sums; double stays double.
        full = torch.promote_types(receiver.dtype, torch.float32)
        receiver, sender = receiver.to(full), sender.to(full)
        weight = self.from_offset.weight.T
        if x.is_cpu:
            return fused_message_sum(receiver, sender, weight, graph)
        return message_sum(receiver, sender, weight, graph)


def message_sum(receiver: Tensor, sender: Tensor, weight: Tensor, graph: Graph) -> Tensor:
    """m [N, C] from a [N, C], b [N, C], W_e [D + 1, C] and the graph, by its definition in PyTorch Geometric."""
    total: Tensor = _definition()(receiver, sender, weight, graph)
    return total


@cache
def _definition() -> nn.Module:
    from gns.model.message_passing import MessageSum

    return MessageSum()
