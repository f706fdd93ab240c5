"""One step: its symmetries, free flight, and walls that hold."""

import dataclasses

import pytest
import torch

from gns.settings import ModelSettings
from gns.simulator import Simulator, settled
from gns.state import Conditions, State
from gns.unroll import unroll
from tests.gns.conftest import NORMALISATION, Cloud


def test_the_order_of_the_particles_does_not_matter(lively: Simulator, cloud: Cloud) -> None:
    lively.double()
    state, conditions = (each.to(dtype=torch.float64) for each in cloud(lower=(0.0, 0.0)))
    friction = torch.linspace(0.3, 0.9, len(state.positions), dtype=torch.float64)
    conditions = dataclasses.replace(conditions, friction=friction)
    order = torch.randperm(len(friction), generator=torch.Generator().manual_seed(3))
    shuffled = State(positions=state.positions[order], displacements=state.displacements[:, order])
    after = lively(shuffled, dataclasses.replace(conditions, friction=friction[order]))
    torch.testing.assert_close(after.positions, lively(state, conditions).positions[order])


def test_far_from_the_walls_a_shift_by_grid_cells_changes_nothing(lively: Simulator, cloud: Cloud) -> None:
    lively.double()
    state, conditions = (each.to(dtype=torch.float64) for each in cloud(velocity=(0.5, 0.2)))
    conditions = dataclasses.replace(conditions, size=torch.full((1, 2), 8.0, dtype=torch.float64))
    shift = lively.settings.grid_cell * torch.tensor([200.0, 31.0], dtype=torch.float64)
    moved = State(positions=state.positions + shift, displacements=state.displacements)
    with torch.no_grad():
        here, there = (unroll(lively, each, conditions, 5) for each in (state, moved))
    assert (here[-1] - here[0]).std(dim=0).min() > 1e-5
    torch.testing.assert_close(there - shift, here, atol=1e-9, rtol=0.0)


def test_an_untrained_model_flies_freely(simulator: Simulator, cloud: Cloud) -> None:
    velocity = torch.tensor([1.0, 2.0])
    state, conditions = cloud(lower=(0.1, 0.2), velocity=(1.0, 2.0))
    steps, step = 20, simulator.settings.step
    with torch.no_grad():
        moved = unroll(simulator, state, conditions, steps)[-1] - state.positions
    # Semi-implicit Euler falls through g t (t + dt) / 2.
    time = steps * step
    expected = velocity * time - torch.tensor([0.0, 0.5 * 9.81 * time * (time + step)])
    torch.testing.assert_close(moved, expected.expand_as(moved), atol=1e-3, rtol=0.0)


@pytest.mark.parametrize("frames", [1, 2, 4, 6])
def test_a_short_past_is_continued_with_the_initial_velocity(frames: int) -> None:
    velocity = torch.tensor([[1.0, 0.0]])
    track = torch.arange(frames).view(-1, 1, 1).square() * torch.tensor([0.0, 0.01])
    state = State.observed(track, velocity, step=0.1, history=3)
    known = (track[1:] - track[:-1])[-3:]
    made_up = torch.tensor([0.1, 0.0]).expand(3 - len(known), 1, 2)
    torch.testing.assert_close(state.displacements, torch.cat((made_up, known)))
    torch.testing.assert_close(state.positions, track[-1])


SMALL_3D = ModelSettings(dimension=3, cell=0.05, radius=0.12, width=8, layers=2, grid_channels=4, grid_cell=0.1)


def cloud_3d(velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> tuple[State, Conditions]:
    """80 points at random in a cube."""
    positions = 0.3 + 0.3 * torch.rand(80, 3, generator=torch.Generator().manual_seed(0))
    settings = SMALL_3D
    velocities = torch.tensor(velocity).expand_as(positions)
    state = State.moving(positions, velocities, step=settings.step, history=settings.history)
    conditions = Conditions(
        friction=torch.full((80,), 0.5),
        cohesion=torch.zeros(80),
        volume=torch.full((80,), settings.particle_volume),
        size=torch.tensor([[1.0, 0.8, 1.0]]),
        gravity=torch.tensor([[0.0, -9.81, 0.0]]),
        floor_friction=torch.tensor([0.4]),
        wall_friction=torch.tensor([0.2]),
        damping=torch.tensor([0.1]),
    )
    return state, conditions


def test_what_hardly_moves_stands_still_and_the_rest_is_left_alone() -> None:
    limit = 1e-4
    faster = torch.tensor([[0.1, 0.0], [0.0, 1.0], [6.0, 8.0], [0.0, 0.0]]) * limit
    kept = settled(faster, limit) / limit
    expected = torch.tensor([[0.1 * 1e-4 / 1.0001, 0.0], [0.0, 0.5], [6e4 / 10001, 8e4 / 10001], [0.0, 0.0]])
    torch.testing.assert_close(kept, expected)


def test_a_creeping_deposit_comes_to_rest(lively: Simulator, cloud: Cloud) -> None:
    # Small errors of the acceleration, of a network that is not exact, in sand that nothing else drives.
    with torch.no_grad():
        lively.network.decoder.mlp[-1].weight.mul_(0.1)
    state, conditions = cloud(lower=(0.4, 0.4))
    conditions = dataclasses.replace(conditions, gravity=torch.zeros(1, 2))
    speeds = []
    for rest_speed in (0.0, 0.05):
        lively.settings = dataclasses.replace(lively.settings, rest_speed=rest_speed)
        with torch.no_grad():
            moved = unroll(lively, state, conditions, 40)[-1] - state.positions
        speeds.append(float(moved.norm(dim=1).mean()) / (40 * lively.settings.step))
    assert speeds[0] > 1e-3
    assert speeds[1] < 0.05 * speeds[0]


def box(*corners: tuple[float, float, float]) -> torch.Tensor:
    """One baffle of one sample, [1, 1, 2, 3]."""
    return torch.tensor(corners).view(1, 1, 2, 3)


def test_no_particle_enters_a_baffle() -> None:
    torch.manual_seed(0)
    simulator = Simulator(SMALL_3D, NORMALISATION)
    baffles = box((0.65, 0.0, 0.3), (0.8, 0.6, 0.6))
    state, conditions = cloud_3d(velocity=(3.0, 0.0, 0.0))
    conditions = dataclasses.replace(conditions, baffles=baffles, baffle_friction=torch.tensor([[0.3]]))
    with torch.no_grad():
        positions = unroll(simulator, state, conditions, 12)
    inside = ((positions > baffles[0, 0, 0]) & (positions < baffles[0, 0, 1])).all(dim=2)
    assert not inside.any()
    # They touched it: the same flow without it moves on.
    with torch.no_grad():
        free = unroll(simulator, state, dataclasses.replace(conditions, baffles=None, baffle_friction=None), 12)
    assert (free[-1, :, 0] - positions[-1, :, 0]).max() > 0.05
