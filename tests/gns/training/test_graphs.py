"""Samples as graphs of PyTorch Geometric: what Talus's own network is given, and the acceleration that is right."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch_geometric.loader import DataLoader

from gns.network.features import Inputs
from gns.settings import ModelSettings
from gns.simulator import Simulator, advanced
from gns.surroundings.forces import Moment
from gns.training import dataset as graphs_of
from gns.training.samples import flows_of, stretch
from tests.refusals import refused


def test_graphs_hold_the_steps_of_all_flows(dataset: Path, settings: ModelSettings, lively: Simulator) -> None:
    settings = replace(settings, rest_speed=0.0)
    graphs, flows = graphs_of(dataset, settings), flows_of(dataset, "train", settings)
    assert len(graphs) == sum(len(flow.positions) - 1 for flow in flows) == 100
    for number, (flow, now) in {0: (0, 0), 24: (0, 24), 25: (1, 0), 61: (2, 11), 99: (3, 24)}.items():
        graph = graphs[number]
        sample = stretch(flows[flow], settings, now=now, steps=1, rng=np.random.default_rng(number))
        inputs = Inputs.of_moment(Moment(sample.state, sample.conditions, settings, graphs.normalisation))
        assert torch.equal(graph.x, inputs.features)
        assert torch.equal(graph.edge_index, inputs.graph.edge_index)
        senders, receivers = graph.edge_index
        offset = (graph.pos[senders] - graph.pos[receivers]) / settings.radius
        torch.testing.assert_close(graph.edge_attr[:, :2], offset, atol=1e-5, rtol=0.0)
        torch.testing.assert_close(graph.edge_attr[:, 2], offset.norm(dim=1), atol=1e-5, rtol=0.0)
        # With its acceleration a step leads to the target.
        scale = graphs.normalisation.acceleration_scale
        after = advanced(sample.state, sample.conditions, scale * graph.y, settings)
        torch.testing.assert_close(after.positions, sample.targets[0], atol=1e-6, rtol=0.0)
    assert torch.equal(graphs[-1].y, graphs[99].y)
    with pytest.raises(IndexError):
        graphs[100]


def test_a_loader_puts_graphs_side_by_side(dataset: Path, settings: ModelSettings) -> None:
    graphs = graphs_of(str(dataset), settings, split="valid")
    # The scales are those of the training.
    assert graphs.normalisation == graphs_of(dataset, settings).normalisation
    (batch,) = DataLoader([graphs[0], graphs[30]], batch_size=2)
    first, second = graphs[0], graphs[30]
    assert len(batch.x) == len(batch.y) == len(first.x) + len(second.x)
    assert torch.equal(batch.edge_index, torch.cat((first.edge_index, second.edge_index + len(first.x)), dim=1))
    assert batch.batch.bincount().tolist() == [len(first.x), len(second.x)]


def test_from_a_disturbed_state_the_acceleration_leads_to_the_target(dataset: Path, settings: ModelSettings) -> None:
    settings = replace(settings, rest_speed=0.0)
    torch.manual_seed(0)
    clean, noisy = graphs_of(dataset, settings), graphs_of(dataset, settings, noise=0.5)
    scale, moved, past = clean.normalisation.displacement_scale, [], []
    for number in range(5, 20):
        pure, graph = clean[number], noisy[number]
        walk = scale * (graph.x - pure.x)[:, 4:6]
        # x + v + a is the same place, for the noise in all of them.
        change = clean.normalisation.acceleration_scale * (graph.y - pure.y) + walk + graph.pos - pure.pos
        torch.testing.assert_close(change, torch.zeros_like(change), atol=1e-6, rtol=0.0)
        moved.append(graph.pos - pure.pos)
        past.append(walk)
    # The last displacement has the standard deviation asked for, the position that of the sum of three.
    assert torch.cat(past).std().item() == pytest.approx(0.5 * scale, rel=0.05)
    assert torch.cat(moved).std().item() == pytest.approx(0.5 * scale * (14.0 / 3.0) ** 0.5, rel=0.05)


def test_mistakes_name_the_folder_or_the_file(dataset: Path, tmp_path: Path) -> None:
    refused(graphs_of, tmp_path, said="expected trajectories in train")
    refused(graphs_of, dataset, ModelSettings(dimension=3), said="expected a 3D scene")
