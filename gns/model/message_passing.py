"""The sum of the messages, defined with PyTorch Geometric: for any device, and the reference of the fused kernels.

Importing PyTorch Geometric takes seconds, so that `gns.model.interaction` imports this module only where it runs.
"""

from torch import Tensor
from torch.nn import functional
from torch_geometric.nn import MessagePassing

from gns.model.graph import Graph


class MessageSum(MessagePassing):  # type: ignore[misc]
    """m_i = sum_j w_ij silu(a_i + b_j + W_e e_ij); see `gns.model.interaction`."""

    def __init__(self) -> None:
        super().__init__(aggr="sum", flow="source_to_target")

    def forward(self, receiver: Tensor, sender: Tensor, weight: Tensor, graph: Graph) -> Tensor:
        """m [N, C] from a [N, C], b [N, C], W_e [D + 1, C] and the graph; stores messages of size [E, C]."""
        total: Tensor = self.propagate(
            graph.edge_index,
            a=receiver,
            b=sender,
            edge_attr=graph.edge_attr @ weight,
            edge_weight=graph.edge_weight,
            size=(len(receiver), len(receiver)),
        )
        return total

    def message(self, a_i: Tensor, b_j: Tensor, edge_attr: Tensor, edge_weight: Tensor) -> Tensor:
        """The message along each edge [E, C]; i is its receiver, j its sender."""
        return edge_weight * functional.silu(a_i + b_j + edge_attr)
