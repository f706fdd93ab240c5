"""Boxes and ground around a few particles, as conditions of a model, and how their gradients are checked."""

from functools import partial

import torch
from torch import Tensor

from gns.surroundings.state import Conditions, Ground

ROOM = {2: (1.0, 0.5), 3: (1.0, 0.5, 0.8)}
double = partial(torch.tensor, dtype=torch.float64)
gradients_hold = partial(torch.autograd.gradcheck, eps=1e-7, atol=1e-5, fast_mode=True)
PADDING = [[-10.0, -10.0, -10.0], [-10.0, -10.0, -10.0]]


def boxes(*corners: list[list[float]], dimension: int = 2, dtype: torch.dtype = torch.float64) -> Tensor:
    """Baffles of one sample, given in 3D, without their z in 2D."""
    return torch.tensor(corners, dtype=dtype)[None, :, :, :dimension].clone()


def scattered(dimension: int) -> Tensor:
    """Two samples: a free box and three that touch each other, floor and wall; a thin box, the free one and padding."""
    free, upon = [[0.3, 0.1, 0.3], [0.4, 0.3, 0.4]], [[0.6, 0.3, 0.0], [0.7, 0.4, 0.3]]
    pair = [[0.6, 0.0, 0.0], [0.7, 0.3, 0.12]], [[0.7, 0.0, 0.0], [0.8, 0.2, 0.12]]
    thin = [[0.0, 0.0, 0.5], [0.02, 0.35, 0.8]], free, PADDING, PADDING
    return torch.cat((boxes(free, *pair, upon, dimension=dimension), boxes(*thin, dimension=dimension)))


def turned_boxes(dimension: int) -> tuple[Tensor, Tensor]:
    """Two samples of boxes that are turned, clear of each other, the floor in 2D and the walls; and their turns."""
    first = [[0.3, 0.15, 0.3], [0.4, 0.3, 0.36]], [[0.65, 0.12, 0.1], [0.7, 0.37, 0.35]]
    second = [[0.1, 0.15, 0.5], [0.25, 0.2, 0.6]], [[0.6, 0.1, 0.3], [0.7, 0.2, 0.4]]
    both = torch.cat((boxes(*first, dimension=dimension), boxes(*second, dimension=dimension)))
    return both, double([[0.5, -0.3], [-0.7, 0.0]])


def conditions(
    count: int,
    baffles: Tensor | None = None,
    *,
    dimension: int = 2,
    batch: Tensor | None = None,
    turn: Tensor | None = None,
    ground: Ground | None = None,
) -> Conditions:
    """Those of `count` particles in the room of the samples of the baffles, or of the ground, or of one."""
    samples = next((len(tensor) for tensor in (baffles, ground.elevation if ground else None) if tensor is not None), 1)
    dtype, friction = torch.float64, None
    if baffles is not None:
        dtype, dimension = baffles.dtype, baffles.shape[3]
        friction = torch.linspace(0.2, 0.7, baffles.shape[1], dtype=dtype).expand(samples, -1)
    per_particle = dict.fromkeys(("friction", "cohesion", "volume"), torch.ones(count, dtype=dtype))
    per_sample = dict.fromkeys(("floor_friction", "wall_friction", "damping"), torch.ones(samples, dtype=dtype))
    return Conditions(
        **per_particle,
        **per_sample,
        size=torch.tensor(ROOM[dimension], dtype=dtype).expand(samples, -1),
        gravity=torch.zeros(samples, dimension, dtype=dtype),
        batch=batch,
        baffles=baffles,
        baffle_friction=friction,
        baffle_turn=turn,
        ground=ground,
    )


def plane(dimension: int, rise: tuple[float, ...] = (0.3, -0.2)) -> Ground:
    """Ground that rises by so much along x (and z), 0.1 m high in the corner of the room."""
    spacing, plan = 0.05, ROOM[dimension][::2]
    posts = (spacing * torch.arange(round(length / spacing) + 2).double() for length in plan)
    grids = torch.meshgrid(*posts, indexing="ij")
    elevation = 0.1 + sum(slope * grid for slope, grid in zip(rise, grids, strict=False))
    return Ground(elevation=elevation[None], friction=(0.4 + 0.1 * grids[0])[None], spacing=spacing)
