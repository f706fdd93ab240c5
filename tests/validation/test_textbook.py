"""The textbook's network: what it is, that it can be differentiated, and that points hear only their neighbours."""

import dataclasses

import pytest
import torch

from gns.model.settings import ModelSettings
from gns.model.state import Conditions, State
from validation.bench.speed.columns import ACROSS, FREE, dam
from validation.bench.speed.textbook import Textbook, neighbours

RADIUS = 0.025


def network(dimension: int = 2) -> Textbook:
    torch.manual_seed(0)
    return Textbook(dimension=dimension, radius=RADIUS, history=3, width=8, layers=2, hidden=1)


def test_the_papers_network_has_the_papers_weights() -> None:
    paper = Textbook(dimension=2, radius=0.015, history=5)
    # 10 layers of perceptrons 3 x 128 -> 128 and 2 x 128 -> 128, each with two hidden layers and a norm; two encoders
    # and a decoder.
    square, norm = 128 * 128 + 128, 2 * 128
    hops = 10 * ((3 * 128 * 128 + 128 + 2 * square + norm) + (2 * 128 * 128 + 128 + 2 * square + norm))
    ends = (15 * 128 + 128 + 2 * square + norm) + (3 * 128 + 128 + 2 * square + norm) + (2 * square + 128 * 2 + 2)
    assert sum(each.numel() for each in paper.parameters()) == hops + ends


@pytest.mark.parametrize("samples", [1, 2])
def test_neighbours_are_all_pairs_within_the_radius(samples: int) -> None:
    torch.manual_seed(0)
    positions = 0.1 * torch.rand(60, 2, dtype=torch.float64)
    batch = torch.arange(60) % samples
    senders, receivers = neighbours(positions, RADIUS, batch if samples > 1 else None)
    near = torch.cdist(positions, positions) <= RADIUS
    near &= (batch[:, None] == batch) & ~torch.eye(60, dtype=torch.bool)
    found = torch.zeros_like(near)
    found[receivers, senders] = True
    assert len(senders) == int(near.sum()) > 0
    assert torch.equal(found, near)


def test_a_message_travels_one_radius_per_layer() -> None:
    # A row of points, each with one neighbour on either side.
    positions = torch.stack((0.5 + 0.02 * torch.arange(6.0), torch.full((6,), 0.5)), dim=1)
    state = State(positions=positions, displacements=torch.zeros(3, 6, 2))
    conditions = Conditions(
        friction=torch.full((6,), 0.5), cohesion=torch.zeros(6), volume=torch.full((6,), 1e-4), size=(1.0, 1.0)
    )
    model = network()

    def moved(friction: torch.Tensor) -> torch.Tensor:
        return model(state, dataclasses.replace(conditions, friction=friction)).positions

    changed = conditions.friction.clone()
    changed[0] = 0.7
    difference = (moved(changed) - moved(conditions.friction)).abs().sum(dim=1)
    assert (difference[:3] > 0.0).all()
    assert (difference[3:] == 0.0).all()


@pytest.mark.parametrize("dimension", [2, 3])
def test_friction_and_state_get_a_gradient(dimension: int) -> None:
    settings = ModelSettings(dimension=dimension)
    state, conditions = dam(settings, 60)
    friction = conditions.friction.clone().requires_grad_()
    inside = dataclasses.replace(state, positions=state.positions.clone().requires_grad_())
    after = network(dimension)(inside, dataclasses.replace(conditions, friction=friction))
    after.positions[:, 0].sum().backward()
    for wanted in (friction.grad, inside.positions.grad):
        assert wanted is not None
        assert wanted.isfinite().all()
        assert (wanted != 0.0).any()


@pytest.mark.parametrize(("dimension", "points"), [(2, 130), (3, 700)])
def test_a_dam_has_its_points_at_the_models_density(dimension: int, points: int) -> None:
    settings = ModelSettings(dimension=dimension)
    state, conditions = dam(settings, points)
    assert state.positions.shape == (points, dimension)
    assert state.displacements.shape == (settings.history, points, dimension)
    height = ACROSS[dimension] * settings.cell
    assert float(state.positions[:, 1].max()) == pytest.approx(height, abs=settings.cell)
    length = float(state.positions[:, 0].max())
    assert length * height ** (dimension - 1) == pytest.approx(float(conditions.volume.sum()), rel=0.25)
    assert conditions.size[0] - length == pytest.approx(FREE * height, abs=settings.cell)
    assert (state.positions > 0.0).all()
    assert (state.positions < torch.tensor(conditions.size)).all()


def test_a_longer_dam_has_as_many_neighbours_per_point() -> None:
    settings = ModelSettings()

    def mean(points: int) -> float:
        return len(neighbours(dam(settings, points)[0].positions, settings.radius)[0]) / points

    assert mean(4_000) == pytest.approx(mean(2_000), rel=0.03)


def test_samples_of_a_dam_never_meet() -> None:
    settings = ModelSettings()
    state, conditions = dam(settings, 100, samples=2)
    assert conditions.samples == 2
    assert conditions.batch is not None
    senders, receivers = neighbours(state.positions, settings.radius, conditions.batch)
    assert torch.equal(conditions.batch[senders], conditions.batch[receivers])
    assert torch.bincount(conditions.batch).tolist() == [100, 100]
