"""The surroundings of flows as the conditions of a model; those of several flows are padded to one shape."""

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from datasets.training.samples import Surroundings
from datasets.trajectory import Floats
from gns.model.state import Conditions, Ground
from gns.units import Units

ABSENT = -10.0
"""Coordinates [m] of a box of zero size that stands for a baffle which a sample does not have, and of ground."""
NO_GROUND = (0,)
"""Shape of the raster where there is no terrain."""


def tensors_of(
    around: Surroundings,
    *,
    boxes: int | None = None,
    turned: bool | None = None,
    raster: tuple[int, ...] | None = None,
) -> dict[str, Tensor]:
    """What is around a flow, as tensors whose first axis is that of the samples, here of length 1.

    | name                                   | unit   | shape                               |
    | box, gravity                           | m, m/s^2 | [1, D]; extent of the box         |
    | floor_friction, wall_friction, damping | -      | [1]                                 |
    | baffles, baffle_friction               | m, -   | [1, K, 2, D], [1, K]; K may be 0    |
    | baffle_turn                            | rad    | [1, K]; [1, 0] where none is turned |
    | elevation, ground_friction             | m, -   | [1, X(, Z)]; X is 0 without terrain |

    boxes, raster: pad to so many baffles and to ground of this shape, which lies far below where there is none; as many
    as there are unless given. turned: whether turns are among them; where any is not zero unless given.
    """
    count = len(around.baffles) if boxes is None else boxes
    baffles, friction = padded_baffles(around, count)
    turn = np.pad(around.baffle_turn, (0, count - len(around.baffle_turn)))
    turned = bool(turn.any()) if turned is None else turned
    own = NO_GROUND if around.ground is None else around.ground[0].shape
    elevation, roughness = padded_ground(around, own if raster is None else raster)
    values: dict[str, Floats | float] = {
        "box": around.size,
        "gravity": around.gravity,
        "floor_friction": around.floor_friction,
        "wall_friction": around.wall_friction,
        "damping": around.damping,
        "baffles": baffles,
        "baffle_friction": friction,
        "baffle_turn": turn if turned else turn[:0],
        "elevation": elevation,
        "ground_friction": roughness,
    }
    return {name: torch.from_numpy(np.asarray(value, np.float32)).unsqueeze(0) for name, value in values.items()}


def conditions_of(
    around: Mapping[str, Tensor],
    *,
    friction: Tensor,
    cohesion: Tensor,
    volume: Tensor,
    spacing: float,
    batch: Tensor | None = None,
    units: Units | None = None,
) -> Conditions:
    """The conditions of one flow, or of several side by side.

    around: `tensors_of` them, joined along the first axis; spacing: between two elevations of their ground [m]; the
    others: see `Conditions`.
    """
    baffles, turn, elevation = around["baffles"], around["baffle_turn"], around["elevation"]
    return Conditions(
        friction=friction,
        cohesion=cohesion,
        volume=volume,
        size=around["box"],
        gravity=around["gravity"],
        floor_friction=around["floor_friction"],
        wall_friction=around["wall_friction"],
        damping=around["damping"],
        batch=batch,
        baffles=baffles if baffles.shape[1] else None,
        baffle_friction=around["baffle_friction"] if baffles.shape[1] else None,
        baffle_turn=turn if turn.shape[1] else None,
        ground=Ground(elevation=elevation, friction=around["ground_friction"], spacing=spacing)
        if elevation.shape[1]
        else None,
        units=units or Units(),
    )


def padded_baffles(around: Surroundings, boxes: int) -> tuple[Floats, Floats]:
    """Corners [boxes, 2, D] and friction [boxes] of baffles, and of absent ones."""
    baffles = np.full((boxes, 2, len(around.size)), ABSENT, np.float32)
    friction = np.zeros(boxes, np.float32)
    baffles[: len(around.baffles)] = around.baffles
    friction[: len(around.baffles)] = around.baffle_friction
    return baffles, friction


def padded_ground(around: Surroundings, raster: tuple[int, ...]) -> tuple[Floats, Floats]:
    """Elevation and friction of the ground over a raster; where a sample has none it lies far below."""
    if around.ground is None:
        return np.full(raster, ABSENT, np.float32), np.zeros(raster, np.float32)
    ends = [(0, count - own) for count, own in zip(raster, around.ground[0].shape, strict=True)]
    elevation, friction = (np.pad(field, ends, mode="edge") for field in around.ground)
    return elevation, friction
