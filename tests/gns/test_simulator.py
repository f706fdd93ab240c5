"""One step: its symmetries, free flight, and walls that hold."""

import dataclasses

import pytest
import torch

from gns.model.settings import ModelSettings
from gns.model.simulator import Simulator, settled
from gns.model.state import Conditions, State
from gns.unroll import unroll
from tests.gns.conftest import NORMALISATION, Cloud


def test_the_order_of_the_particles_does_not_matter(lively: Simulator, cloud: Cloud) -> None:
    lively.double()
    state, conditions = cloud(lower=(0.0, 0.0))
    friction = torch.linspace(0.3, 0.9, len(state.positions), dtype=torch.float64)
    conditions = dataclasses.replace(
        conditions, friction=friction, cohesion=conditions.cohesion.double(), volume=conditions.volume.double()
    )
    state = State(positions=state.positions.double(), displacements=state.displacements.double())
    order = torch.randperm(len(friction), generator=torch.Generator().manual_seed(3))
    shuffled = State(positions=state.positions[order], displacements=state.displacements[:, order])
    after = lively(shuffled, dataclasses.replace(conditions, friction=friction[order]))
    torch.testing.assert_close(after.positions, lively(state, conditions).positions[order])


def test_far_from_the_walls_a_shift_by_grid_cells_changes_nothing(cloud: Cloud) -> None:
    # With convolutions the walls matter: they are the padding of the grid.
    torch.manual_seed(1)
    simulator = Simulator(ModelSettings(history=3, width=16, layers=2, grid_channels=8, grid_layers=0), NORMALISATION)
    with torch.no_grad():
        simulator.network.decoder.mlp[-1].weight.normal_(std=0.3)
    state, conditions = cloud()
    shift = 3 * simulator.settings.grid_cell
    moved = State(positions=state.positions + shift, displacements=state.displacements)
    with torch.no_grad():
        after, after_moved = simulator(state, conditions), simulator(moved, conditions)
    assert after.displacements[-1].std() > 1e-5
    torch.testing.assert_close(after_moved.displacements[-1], after.displacements[-1], atol=1e-6, rtol=0.0)


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


def test_nothing_leaves_the_box(lively: Simulator, cloud: Cloud) -> None:
    state, conditions = cloud(lower=(0.05, 0.05), velocity=(-3.0, -5.0))
    with torch.no_grad():
        positions = unroll(lively, state, conditions, 12)
    assert positions[-1, :, 1].min() < 1e-6
    assert positions.min() >= 0.0
    assert positions.max() <= 1.0


def test_the_displacement_of_a_stopped_particle_is_what_remains(simulator: Simulator, cloud: Cloud) -> None:
    state, conditions = cloud(lower=(0.4, 0.0), velocity=(0.0, -5.0))
    with torch.no_grad():
        after = simulator(state, conditions)
    torch.testing.assert_close(after.displacements[-1], after.positions - state.positions)
    torch.testing.assert_close(after.displacements[:-1], state.displacements[1:])


@pytest.mark.parametrize("frames", [1, 2, 4, 6])
def test_a_short_past_is_continued_with_the_initial_velocity(frames: int) -> None:
    velocity = torch.tensor([[1.0, 0.0]])
    track = torch.arange(frames).view(-1, 1, 1).square() * torch.tensor([0.0, 0.01])
    state = State.observed(track, velocity, step=0.1, history=3)
    known = (track[1:] - track[:-1])[-3:]
    made_up = torch.tensor([0.1, 0.0]).expand(3 - len(known), 1, 2)
    torch.testing.assert_close(state.displacements, torch.cat((made_up, known)))
    torch.testing.assert_close(state.positions, track[-1])


SMALL_3D = ModelSettings(
    dimension=3, cell=0.05, radius=0.12, width=8, layers=2, grid_channels=4, grid_cell=0.1, baffles=True
)


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
        size=(1.0, 0.8, 1.0),
    )
    return state, conditions


def test_what_hardly_moves_stands_still_and_the_rest_is_left_alone() -> None:
    limit = 1e-4
    faster = torch.tensor([[0.1, 0.0], [0.0, 1.0], [6.0, 8.0], [0.0, 0.0]]) * limit
    kept = settled(faster, limit) / limit
    torch.testing.assert_close(
        kept, torch.tensor([[0.1 * 0.01 / 1.01, 0.0], [0.0, 0.5], [600 / 101, 800 / 101], [0, 0]])
    )


def test_a_creeping_deposit_comes_to_rest(lively: Simulator, cloud: Cloud) -> None:
    # Errors of the acceleration as an untrained network makes them, in sand that nothing else drives.
    state, conditions = cloud(lower=(0.4, 0.4))
    conditions = dataclasses.replace(conditions, gravity=0.0)
    speeds = []
    for rest_speed in (0.0, 0.05):
        lively.settings = dataclasses.replace(lively.settings, rest_speed=rest_speed)
        with torch.no_grad():
            moved = unroll(lively, state, conditions, 40)[-1] - state.positions
        speeds.append(float(moved.norm(dim=1).mean()) / (40 * lively.settings.step))
    assert speeds[0] > 1e-3
    assert speeds[1] < 0.05 * speeds[0]


def test_three_dimensions_are_a_setting() -> None:
    torch.manual_seed(0)
    simulator = Simulator(SMALL_3D, NORMALISATION)
    state, conditions = cloud_3d()
    with torch.no_grad():
        moved = unroll(simulator, state, conditions, 5)[-1] - state.positions
    fall = torch.tensor([0.0, -9.81 * 15 * SMALL_3D.step**2, 0.0])
    torch.testing.assert_close(moved, fall.expand_as(moved), atol=5e-4, rtol=0.0)


def box(*corners: tuple[float, float, float]) -> torch.Tensor:
    """One baffle of one sample, [1, 1, 2, 3]."""
    return torch.tensor(corners).view(1, 1, 2, 3)


def test_no_particle_enters_a_baffle() -> None:
    torch.manual_seed(0)
    simulator = Simulator(SMALL_3D, NORMALISATION)
    baffles = box((0.65, 0.0, 0.3), (0.8, 0.6, 0.6))
    state, conditions = cloud_3d(velocity=(3.0, 0.0, 0.0))
    conditions = dataclasses.replace(conditions, baffles=baffles)
    with torch.no_grad():
        positions = unroll(simulator, state, conditions, 12)
    inside = ((positions > baffles[0, 0, 0]) & (positions < baffles[0, 0, 1])).all(dim=2)
    assert not inside.any()
    # They touched it: the same flow without it moves on.
    with torch.no_grad():
        free = unroll(simulator, state, dataclasses.replace(conditions, baffles=None), 12)
    assert (free[-1, :, 0] - positions[-1, :, 0]).max() > 0.05


def test_a_model_without_baffles_does_not_look_at_them() -> None:
    torch.manual_seed(0)
    simulator = Simulator(dataclasses.replace(SMALL_3D, baffles=False), NORMALISATION)
    state, conditions = cloud_3d(velocity=(3.0, 0.0, 0.0))
    known = dataclasses.replace(conditions, baffles=box((0.65, 0.0, 0.3), (0.8, 0.6, 0.6)))
    with torch.no_grad():
        torch.testing.assert_close(simulator(state, known).positions, simulator(state, conditions).positions)


def test_the_gradient_in_baffle_and_material_is_that_of_differences() -> None:
    torch.manual_seed(0)
    simulator = Simulator(dataclasses.replace(SMALL_3D, film=True), NORMALISATION).double()
    with torch.no_grad():
        for name, weight in simulator.named_parameters():
            if "film" in name or "decoder.mlp.2" in name:
                weight.normal_(std=0.2)
    state, conditions = cloud_3d(velocity=(2.0, 0.0, 0.0))
    state = State(positions=state.positions.double(), displacements=state.displacements.double())
    baffles = box((0.652, 0.0, 0.303), (0.8, 0.6, 0.6)).double()
    simulator.requires_grad_(False)

    def end(shift: torch.Tensor) -> torch.Tensor:
        """A number that depends on where the baffle stands, on cohesion and on friction."""
        moved = torch.cat((shift[:1], torch.zeros(1, dtype=torch.float64), shift[1:2]))
        given = dataclasses.replace(
            conditions,
            friction=conditions.friction.double() + shift[2],
            cohesion=conditions.cohesion.double() + 100.0 + 1000.0 * shift[3],
            volume=conditions.volume.double(),
            baffles=baffles + moved,
        )
        last = unroll(simulator, state, given, 8)[-1]
        return (last * torch.linspace(0.5, 1.5, last.numel(), dtype=torch.float64).view_as(last)).sum()

    shift = torch.zeros(4, dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(end(shift), shift)
    step = 1.0e-6
    with torch.no_grad():
        differences = torch.stack(
            [(end(step * unit) - end(-step * unit)) / (2.0 * step) for unit in torch.eye(4, dtype=torch.float64)]
        )
    assert differences.abs().min() > 1e-4
    torch.testing.assert_close(slope, differences, rtol=1e-4, atol=0.0)
