"""Samples as graphs of PyTorch Geometric, to train a user's own network: `gns.training.dataset`."""

from pathlib import Path

import numpy as np
import torch
from torch_geometric.data import Data

from gns.network.features import EDGES, Inputs
from gns.settings import ModelSettings
from gns.surroundings.forces import Moment, Normalisation
from gns.surroundings.state import Conditions, State, computed
from gns.training.samples import Flows, flows_of, statistics, stretch


def graph_of(state: State, conditions: Conditions, settings: ModelSettings, normalisation: Normalisation) -> Data:
    """The input of Talus's own network for a state in the units of the model, without its background grid. `x`:
    `gns.network.features.NODES`, shape [N, F]; `edge_index`: sender and receiver of each edge, shape [2, E];
    `edge_attr`: `gns.network.features.EDGES`, shape [E, D + 1]; `pos`: positions [m], shape [N, D]."""
    inputs = Inputs.of_moment(Moment(state, conditions, settings, normalisation))
    graph, (senders, receivers) = inputs.graph, inputs.graph.edge_index
    edges = computed(EDGES, graph.positions[senders] - graph.positions[receivers])
    return Data(x=inputs.features, edge_index=graph.edge_index, edge_attr=edges, pos=state.positions)


class Graphs(torch.utils.data.Dataset[Data]):
    """The steps of all flows of a split; graph i always has the same particles, and without noise the same numbers."""

    def __init__(self, flows: Flows, settings: ModelSettings, normalisation: Normalisation, noise: float) -> None:
        self.flows, self.settings, self.normalisation = flows, settings, normalisation
        self.noise = noise * float(normalisation.displacement_scale) / settings.history**0.5
        self._ends = np.cumsum([len(flow.positions) - 1 for flow in flows])

    def __len__(self) -> int:
        return int(self._ends[-1])

    def __getitem__(self, index: int) -> Data:
        """`graph_of` the state before a step; `y`: the acceleration from there to the state after it, shape [N, D].
        That is the change of the displacements without gravity's part, over `normalisation.acceleration_scale`."""
        index = range(len(self))[index]
        number = int(np.searchsorted(self._ends, index, side="right"))
        flow, settings = self.flows[number], self.settings
        now = index - int(self._ends[number]) + len(flow.positions) - 1
        sample = stretch(flow, settings, now=now, steps=1, rng=np.random.default_rng(index))
        state, conditions = sample.state, sample.conditions
        if self.noise > 0.0:
            walk = self.noise * torch.randn_like(state.displacements).cumsum(dim=0)
            state = State(positions=state.positions + walk.sum(dim=0), displacements=state.displacements + walk)
        graph = graph_of(state, conditions, settings, self.normalisation)
        change = sample.targets[0] - state.positions - state.displacements[-1]
        graph.y = (change - conditions.gravity * settings.step**2) / self.normalisation.acceleration_scale
        return graph


def dataset(
    folder: str | Path, settings: ModelSettings | None = None, *, split: str = "train", noise: float = 0.0
) -> Graphs:
    """The steps of a dataset as `torch_geometric.data.Data`, for a `torch_geometric.loader.DataLoader`.

        graphs = dataset("data/piles", ModelSettings(frame_dt=0.02, frames_per_step=1))
        for batch in DataLoader(graphs, batch_size=8, shuffle=True):
            loss = (network(batch.x, batch.edge_index) - batch.y).square().mean()

    folder: from `python -m mpm.generate`; settings: the model's dimension, step, cell, radius and history, or the
    defaults; split: train, valid or test, all in the scales of train; noise: final standard deviation, over
    `displacement_scale`, of a random walk added to the past displacements, so that a network learns to correct its own
    errors (Sanchez-Gonzalez et al. 2020, section 4.2). Raises InputError.
    """
    settings, folder = settings or ModelSettings(), Path(folder)
    flows = flows_of(folder, split, settings)
    training = flows if split == "train" else flows_of(folder, "train", settings)
    return Graphs(flows, settings, statistics([training])[0], noise)
