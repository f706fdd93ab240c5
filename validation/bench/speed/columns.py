"""Dams of sand of any number of points, on which models are timed: the tall column's height, as long as it takes."""

import math

import torch
from torch import Tensor

from gns.model.settings import ModelSettings
from gns.model.state import Conditions, State

ACROSS = {2: 40, 3: 16}
"""Points along the height, in 3D along the width too; 40 of them 10 mm apart are the paper's tall column."""
FREE = 2.0
"""Length of the box in front of the dam, in heights."""
ABOVE = 2.5
"""Height of the box, in heights."""
JITTER = 0.6
"""Random displacement of the points, as a share of their spacing."""
FRICTION = math.tan(math.radians(30.0))
COHESION = 100.0
"""[Pa]."""


def dam(settings: ModelSettings, points: int, *, samples: int = 1, seed: int = 0) -> tuple[State, Conditions]:
    """A dam at rest at the left wall, of `points` points as close as the model knows them; `samples` times.

    Points of another model of the same spacing and radius have as many neighbours, however many there are: only the
    length grows with their number.
    """
    dimension, across = settings.dimension, ACROSS[settings.dimension]
    spacing = settings.particle_volume ** (1.0 / dimension)
    slices = math.ceil(points / across ** (dimension - 1))
    axes = [torch.arange(float(slices)), *[torch.arange(float(across))] * (dimension - 1)]
    lattice = torch.cartesian_prod(*axes)[:points].repeat(samples, 1)
    generator = torch.Generator().manual_seed(seed)
    jitter = JITTER * (torch.rand(lattice.shape, generator=generator) - 0.5)
    positions = spacing * (lattice + 0.5 + jitter)
    height = across * spacing
    size = (slices * spacing + FREE * height, ABOVE * height, *[height] * (dimension - 2))
    state = State.moving(positions, torch.zeros_like(positions), step=settings.step, history=settings.history)
    return state, conditions(positions, settings, size=size, samples=samples)


def conditions(positions: Tensor, settings: ModelSettings, *, size: tuple[float, ...], samples: int) -> Conditions:
    """One material everywhere, no baffles."""
    count = len(positions)
    return Conditions(
        friction=torch.full((count,), FRICTION),
        cohesion=torch.full((count,), COHESION),
        volume=torch.full((count,), settings.particle_volume),
        size=size,
        batch=None if samples == 1 else torch.arange(samples).repeat_interleave(count // samples),
        samples=samples,
    )
