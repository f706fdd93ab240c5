"""A network of one's own, with layers of PyTorch Geometric: data, training, rollout, scores, comparison, page."""

import tempfile
from pathlib import Path

import numpy as np
import torch
from torch import nn
from torch_geometric.data import Data
from torch_geometric.loader import DataLoader
from torch_geometric.nn import GINEConv

import gns
from datasets import read_trajectory
from datasets.compare import compare
from datasets.definitions import read_definition
from gns.score import calibrated, evaluate
from gns.settings import ModelSettings
from gns.simulator import advanced
from gns.surroundings.state import Conditions, State
from gns.training import dataset
from gns.training.graphs import Graphs, graph_of
from gns.training.samples import flows_of
from mpm.generate import generate

WIDTH, EPOCHS = 64, 10
settings = ModelSettings(frame_dt=0.02, frames_per_step=2, cell=0.014, radius=0.035, grid_cell=0.028)


def perceptron() -> nn.Module:
    return nn.Sequential(nn.Linear(WIDTH, WIDTH), nn.SiLU(), nn.Linear(WIDTH, WIDTH), nn.LayerNorm(WIDTH))


class Mine(nn.Module):
    """Three graph isomorphism layers with features of edges (Hu et al. 2020)."""

    def __init__(self, graphs: Graphs) -> None:
        super().__init__()
        self.settings, self.normalisation = graphs.settings, graphs.normalisation
        self.encoder = nn.Linear(graphs[0].num_node_features, WIDTH)
        self.layers = nn.ModuleList(GINEConv(perceptron(), edge_dim=graphs[0].num_edge_features) for _ in range(3))
        self.decoder = nn.Linear(WIDTH, settings.dimension)

    def acceleration(self, graph: Data) -> torch.Tensor:
        """Without gravity's, over that of the data [-], shape [N, D]."""
        x = self.encoder(graph.x)
        for layer in self.layers:
            x = x + layer(x, graph.edge_index, graph.edge_attr)
        return self.decoder(x)

    def forward(self, state: State, conditions: Conditions) -> State:
        """One step: all that Talus asks for."""
        graph = graph_of(state, conditions, self.settings, self.normalisation)
        acceleration = self.normalisation.acceleration_scale * self.acceleration(graph)
        return advanced(state, conditions, acceleration, self.settings)


torch.manual_seed(0)
torch.set_num_threads(1)
with tempfile.TemporaryDirectory() as folder:
    data = Path(folder, "piles")
    generate(read_definition(str(Path(__file__).with_name("piles.toml"))), data, seed=0, count=24, jobs=2)
    graphs = dataset(data, settings, noise=0.05)
    network = Mine(graphs)
    optimiser = torch.optim.Adam(network.parameters(), lr=1.0e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, EPOCHS)
    for _ in range(EPOCHS):
        losses = []
        for batch in DataLoader(graphs, batch_size=8, shuffle=True):
            loss = nn.functional.smooth_l1_loss(network.acceleration(batch), batch.y)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            losses.append(loss.item())
        schedule.step()
    print(f"{len(graphs)} graphs, loss {np.mean(losses):.4f}")

    scores = evaluate(network, flows_of(data, "test", settings))
    front, profile = (np.mean([abs(getattr(each, name)) for each in scores]) for name in ("front", "profile"))
    print(f"held-out flows: front off by {100 * front:.1f} % of the extent, profile by {100 * profile:.1f} %")
    truth = read_trajectory(sorted((data / "test").glob("*.npz"))[0])
    flow = gns.simulate(truth.scene, model=network)
    print(compare(truth, flow, labels=("MPM", "mine")).table())
    truth.view(Path(folder, "flow.html"), other=flow)
    unseen = evaluate(network, flows_of(data, "valid", settings))
    found = gns.predict(truth.scene, model=network, calibration=calibrated(unseen))
    print(f"front {found.front:.3f} m, with 95 % within {found.half_width:.3f} m")
assert profile < 0.12
