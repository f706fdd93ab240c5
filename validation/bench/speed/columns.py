"""Columns of sand of any number of nodes, on which networks are timed: a fixed height, as long as it takes."""

import math

import torch

from gns.model.settings import GRAVITY, ModelSettings
from gns.model.state import Conditions, State

ACROSS = {2: 40, 3: 16}
"""Nodes along the height, in 3D along the width too; 40 of them 10 mm apart are the paper's tall column."""
FREE = 2.0
"""Length of the box in front of the column, in heights."""
ABOVE = 2.5
"""Height of the box, in heights."""
JITTER = 0.6
"""Random displacement of the nodes, as a fraction of their spacing."""
FRICTION = math.tan(math.radians(30.0))
COHESION = 100.0
"""[Pa]."""
WALL_FRICTION = 0.385


def column(settings: ModelSettings, nodes: int, *, samples: int = 1, seed: int = 0) -> tuple[State, Conditions]:
    """A column at rest at the left wall, of `nodes` nodes at the model's density; `samples` times.

    The number of neighbours per node does not depend on `nodes`: only the length grows with it.
    """
    dimension, across = settings.dimension, ACROSS[settings.dimension]
    spacing = settings.particle_volume ** (1.0 / dimension)
    slices = math.ceil(nodes / across ** (dimension - 1))
    axes = [torch.arange(float(slices)), *[torch.arange(float(across))] * (dimension - 1)]
    lattice = torch.cartesian_prod(*axes)[:nodes].repeat(samples, 1)
    generator = torch.Generator().manual_seed(seed)
    jitter = JITTER * (torch.rand(lattice.shape, generator=generator) - 0.5)
    positions = spacing * (lattice + 0.5 + jitter)
    height, count = across * spacing, nodes * samples
    state = State.moving(positions, torch.zeros_like(positions), step=settings.step, history=settings.history)
    size = slices * spacing + FREE * height, ABOVE * height, *[height] * (dimension - 2)
    friction = torch.full((samples,), WALL_FRICTION)
    conditions = Conditions(
        friction=torch.full((count,), FRICTION),
        cohesion=torch.full((count,), COHESION),
        volume=torch.full((count,), settings.particle_volume),
        size=torch.tensor([size] * samples),
        gravity=torch.tensor([(0.0, -GRAVITY, 0.0)[:dimension]] * samples),
        floor_friction=friction,
        wall_friction=friction,
        damping=torch.zeros(samples),
        batch=None if samples == 1 else torch.arange(samples).repeat_interleave(nodes),
    )
    return state, conditions
