"""The force that keeps cohesive material together: it opposes what is not a rigid motion, and changes no momentum."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from gns.settings import ModelSettings
from gns.surroundings.forces import Moment, Normalisation, from_rigid
from gns.surroundings.state import Conditions, State

SPEED = 0.003  # of particles [m per step]


def moving(dimension: int) -> tuple[State, Conditions]:
    """A cohesive block beside one without cohesion, both in random motion on a level floor."""
    generator, count = torch.Generator().manual_seed(3), 40

    def drawn(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=generator, dtype=torch.float64)

    one, whole = torch.ones(2, dtype=torch.float64), torch.ones(count, dtype=torch.float64)
    batch = torch.arange(count) // (count // 2)
    conditions = Conditions(
        friction=0.6 * whole,
        cohesion=torch.where(batch == 0, 500.0 * whole, 0.0),
        volume=1.0e-5 * (1.0 + drawn(count)),
        size=torch.ones(2, dimension, dtype=torch.float64),
        gravity=torch.tensor([[0.0, -9.81, 0.0][:dimension]] * 2, dtype=torch.float64),
        floor_friction=0.4 * one,
        wall_friction=0.0 * one,
        damping=0.0 * one,
        batch=batch,
    )
    state = State(positions=0.2 * drawn(count, dimension), displacements=SPEED * drawn(3, count, dimension))
    return state, conditions


@pytest.mark.parametrize("dimension", [2, 3])
def test_rigid_motion_remains_and_momentum_is_kept(dimension: int) -> None:
    state, conditions = moving(dimension)
    x, v, weight = state.positions, state.displacements[-1], conditions.volume.unsqueeze(1)
    change = from_rigid(x, v, weight, conditions, 1.0e-9)
    assert change.abs().max() > 0.1 * SPEED
    assert conditions.total(weight * change).abs().max() < 1.0e-12 * conditions.total(weight * v).abs().max()
    torch.testing.assert_close(from_rigid(x, v + change, weight, conditions, 1.0e-9), 0.0 * v, rtol=0.0, atol=1.0e-12)


@pytest.mark.parametrize("dimension", [2, 3])
def test_only_cohesive_material_is_kept_together(dimension: int) -> None:
    settings = ModelSettings(dimension=dimension, cell=0.025, radius=0.06, grid_cell=0.05)
    state, conditions = moving(dimension)
    force = Moment(state, conditions, settings, Normalisation(displacement_scale=SPEED)).together
    cohesive = conditions.cohesion > 0.0
    assert not force[~cohesive].any()
    assert (force[cohesive].abs().amax(dim=0) > 1.0e-3).all()
    dry = replace(conditions, cohesion=0.0 * conditions.cohesion)
    assert not Moment(state, dry, settings, Normalisation()).together.any()
