"""The graph: points closer than a radius are neighbours."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from gns.kernels.neighbours import Edges, neighbours

Search = Callable[[Tensor, Tensor | None], Edges]
"""Positions [m], shape [N, D], and the sample of each point [N] to the edges, e.g. `gns.kernels.neighbours.NeighbourList`."""


@dataclass(frozen=True, kw_only=True)
class Graph:
    """Who hears whom, and from where. Edges are sorted by receiver, then by sender."""

    senders: Tensor
    """Sender of each edge, shape [E]."""
    receivers: Tensor
    """Receiver of each edge, shape [E]."""
    starts: Tensor
    """First edge of each receiver, and the number of edges, shape [N + 1]."""
    offsets: Tensor
    """Sender minus receiver over the radius, then its length, shape [E, D + 1]."""
    envelope: Tensor
    """Weight of each edge [-], shape [E, 1]: 1 at distance 0, falls to 0 with zero slope at the radius."""


def radius_graph(positions: Tensor, radius: float, batch: Tensor | None = None, search: Search | None = None) -> Graph:
    """Build the graph of `positions` [m], shape [N, D].

    batch: the sample that each point belongs to, shape [N]; search: finds the edges, anew unless given.

    Offsets and envelope are differentiable in the positions. The envelope (1 - (d/R)^2)^2 makes the model's output
    continuously differentiable although neighbours come and go: at d = R its value and slope are zero.
    """
    edges = neighbours(positions, radius, batch) if search is None else search(positions, batch)
    offset = (positions.index_select(0, edges.senders) - positions.index_select(0, edges.receivers)) / radius
    square = offset.square().sum(dim=1, keepdim=True)
    # Points that the floor or a corner stopped can coincide: keep the slope of the root finite there.
    distance = (square + 1.0e-12).sqrt()
    return Graph(
        senders=edges.senders,
        receivers=edges.receivers,
        starts=edges.starts,
        offsets=torch.cat((offset, distance), dim=1),
        envelope=(1.0 - square).clamp(min=0.0).square(),
    )


def mean_envelope_sum(radius: float, point_volume: float, dimension: int) -> float:
    """Sum of the envelope over the neighbours of a point inside a dense packing [-].

    The mean of (1 - r^2)^2 over the unit ball, times the number of points in a ball of the radius.
    """
    mean = 1.0 - 2.0 * dimension / (dimension + 2.0) + dimension / (dimension + 4.0)
    ball = math.pi ** (dimension / 2.0) / math.gamma(dimension / 2.0 + 1.0) * radius**dimension
    return float(mean * ball / point_volume)
