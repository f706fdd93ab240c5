"""The graph network simulator as the literature writes it, plainly.

Sanchez-Gonzalez et al. 2020 (Learning to simulate complex physics with graph networks, ICML), the network of the
reference paper: encode, process, decode. In each of the process's layers, with residual connections for both,

    e_ij' = f([x_i, x_j, e_ij])            x_i' = g([x_i, sum_j e_ij'])

  x_i    latents of a node [N, C]          f, g  perceptrons with a LayerNorm at their end, one pair per layer
  e_ij   latents of an edge [E, C]

It is never trained here. Its times and its memory are those of any weights.
"""

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor, nn

from gns.model.state import Conditions, State


def perceptron(inputs: int, width: int, hidden_layers: int, outputs: int, *, norm: bool = True) -> nn.Sequential:
    """A network of `hidden_layers` hidden layers, normalised at its end unless it decodes."""
    modules: list[nn.Module] = []
    for _ in range(hidden_layers):
        modules += [nn.Linear(inputs, width), nn.ReLU()]
        inputs = width
    return nn.Sequential(*modules, nn.Linear(inputs, outputs), *([nn.LayerNorm(outputs)] if norm else []))


class MessagePassing(nn.Module):
    """One layer of message passing."""

    def __init__(self, width: int, hidden_layers: int) -> None:
        super().__init__()
        self.edge = perceptron(3 * width, width, hidden_layers, width)
        self.node = perceptron(2 * width, width, hidden_layers, width)

    def forward(self, x: Tensor, e: Tensor, senders: Tensor, receivers: Tensor) -> tuple[Tensor, Tensor]:
        """Latents of nodes [N, C] and of edges [E, C], after one layer."""
        message = self.edge(torch.cat((x[receivers], x[senders], e), dim=1))
        received = torch.zeros_like(x).index_add(0, receivers, message)
        return x + self.node(torch.cat((x, received), dim=1)), e + message


class Textbook(nn.Module):
    """One step of a flow: x(t + dt) from x(t) and the last displacements; the interface of `gns.model.simulator`."""

    def __init__(
        self, *, dimension: int, radius: float, history: int, width: int = 128, layers: int = 10, hidden_layers: int = 2
    ) -> None:
        """radius: [m]; history: past displacements; hidden_layers: of every perceptron."""
        super().__init__()
        self.radius = radius
        # displacements, distances to the walls, tan(phi)
        features = history * dimension + 2 * dimension + 1
        self.encode_nodes = perceptron(features, width, hidden_layers, width)
        self.encode_edges = perceptron(dimension + 1, width, hidden_layers, width)
        self.layers = nn.ModuleList(MessagePassing(width, hidden_layers) for _ in range(layers))
        self.decoder = perceptron(width, width, hidden_layers, dimension, norm=False)

    def forward(self, state: State, conditions: Conditions) -> State:
        """One step. Differentiable in the state and in friction; its output is small, for it is never trained."""
        positions = state.positions
        senders, receivers = neighbours(positions, self.radius, conditions.batch)
        offset = (positions[senders] - positions[receivers]) / self.radius
        distance = (offset.square().sum(dim=1, keepdim=True) + 1.0e-12).sqrt()
        walls = torch.cat((positions, conditions.of_particles(conditions.size) - positions), dim=1) / self.radius
        motion = state.displacements.movedim(0, 1).flatten(1) / self.radius
        x = self.encode_nodes(torch.cat((motion, walls.clamp(max=1.0), conditions.friction.unsqueeze(1)), dim=1))
        e = self.encode_edges(torch.cat((offset, distance), dim=1))
        for layer in self.layers:
            x, e = layer(x, e, senders, receivers)
        moved = state.displacements[-1] + 1.0e-3 * self.radius * self.decoder(x)
        return State(
            positions=positions + moved, displacements=torch.cat((state.displacements[1:], moved.unsqueeze(0)))
        )


def neighbours(positions: Tensor, radius: float, batch: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Senders and receivers of all pairs closer than `radius` [m], by SciPy's tree, anew in each step; [E] each.

    batch: the sample that each node belongs to, shape [N]; no edge joins two samples.
    """
    separated = positions.detach().double().numpy()
    if batch is not None:
        separated = np.column_stack((separated, 2.0 * radius * batch.numpy()))
    pairs = torch.from_numpy(cKDTree(separated).query_pairs(radius, output_type="ndarray"))
    return torch.cat((pairs[:, 0], pairs[:, 1])), torch.cat((pairs[:, 1], pairs[:, 0]))
