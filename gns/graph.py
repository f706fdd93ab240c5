"""The graph: points closer than a radius are neighbours."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor
from torch_geometric import EdgeIndex


@dataclass(frozen=True, kw_only=True)
class Graph:
    """Who hears whom, and from where. Edges are sorted by receiver."""

    edge_index: EdgeIndex
    """Sender (first row) and receiver (second row) of each edge, shape [2, E]."""
    offsets: Tensor
    """Sender minus receiver over the radius, then its length, shape [E, D + 1]."""
    envelope: Tensor
    """Weight of each edge [-], shape [E, 1]: 1 at distance 0, falls to 0 with zero slope at the radius."""


def neighbours(
    positions: np.ndarray, radius: float, *, batch: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Senders and receivers of all pairs closer than `radius`, both ways, no point with itself, sorted by receiver.

    positions: [m], shape [N, D]; batch: the sample that each point belongs to, shape [N]; samples never meet.
    """
    apart = positions.astype(np.float64)
    if batch is not None:
        apart[:, 0] += batch * (2.0 * radius + np.ptp(apart[:, 0]))
    pairs = cKDTree(apart).query_pairs(radius, output_type="ndarray")
    senders, receivers = np.concatenate((pairs, pairs[:, ::-1])).T
    order = np.argsort(receivers, kind="stable")
    return senders[order], receivers[order]


def radius_graph(positions: Tensor, radius: float, batch: Tensor | None = None) -> Graph:
    """Build the graph of `positions` [m], shape [N, D].

    Offsets and envelope are differentiable in the positions. The envelope (1 - (d/R)^2)^2 makes the model's output
    continuously differentiable although neighbours come and go: at d = R its value and slope are zero.
    """
    senders, receivers = map(
        torch.from_numpy,
        neighbours(positions.detach().numpy(), radius, batch=None if batch is None else batch.numpy()),
    )
    offset = (positions.index_select(0, senders) - positions.index_select(0, receivers)) / radius
    square = offset.square().sum(dim=1, keepdim=True)
    # Points that the floor or a corner stopped can coincide: keep the slope of the root finite there.
    distance = (square + 1.0e-12).sqrt()
    edges = EdgeIndex(torch.stack((senders, receivers)), sparse_size=(len(positions), len(positions)), sort_order="col")
    return Graph(
        edge_index=edges,
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
