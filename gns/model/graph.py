"""The graph: particles are nodes, and pairs closer than a cutoff radius are edges, in PyTorch Geometric's layout."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from gns.kernels.neighbours import neighbours


@dataclass(frozen=True, kw_only=True)
class Graph:
    """Directed edges, both ways between two nodes, sorted by receiver, then by sender."""

    edge_index: Tensor
    """Sender and receiver of each edge, int64, shape [2, E]."""
    starts: Tensor
    """First edge of each receiver, and the number of edges, shape [N + 1]."""
    edge_attr: Tensor
    """Edge features: sender minus receiver over the radius, then its length, shape [E, D + 1]."""
    edge_weight: Tensor
    """Envelope [-], shape [E, 1]: 1 at distance 0, falls to 0 with zero slope at the radius."""


def radius_graph(positions: Tensor, radius: float, batch: Tensor | None = None) -> Graph:
    """The graph of `positions` [m], shape [N, D], with cutoff `radius` [m].

    batch: the sample that each particle belongs to, shape [N].

    Features and envelope are differentiable in the positions. The envelope (1 - (d/R)^2)^2 makes the model's output
    continuously differentiable although neighbours come and go: at d = R its value and slope are zero.
    """
    edges = neighbours(positions, radius, batch)
    senders, receivers = edges.edge_index
    offset = (positions.index_select(0, senders) - positions.index_select(0, receivers)) / radius
    square = offset.square().sum(dim=1, keepdim=True)
    # Particles that the floor or a corner stopped can coincide: keep the slope of the root finite there.
    distance = (square + 1.0e-12).sqrt()
    return Graph(
        edge_index=edges.edge_index,
        starts=edges.starts,
        edge_attr=torch.cat((offset, distance), dim=1),
        edge_weight=(1.0 - square).clamp(min=0.0).square(),
    )


def mean_envelope_sum(radius: float, particle_volume: float, dimension: int) -> float:
    """Sum of the envelope over the neighbours of a particle inside a dense packing [-].

    The mean of (1 - r^2)^2 over the unit ball, times the number of particles in a ball of the radius.
    """
    mean = 1.0 - 2.0 * dimension / (dimension + 2.0) + dimension / (dimension + 4.0)
    ball = math.pi ** (dimension / 2.0) / math.gamma(dimension / 2.0 + 1.0) * radius**dimension
    return float(mean * ball / particle_volume)
