"""Whether the MPM's first frames, with which a rollout of the surrogate may begin, depend on the baffles."""

import math
from collections.abc import Iterable

from datasets.scene import Baffle, Mass, Scene
from gns.initial import MPM_SECONDS

CLEAR_CELLS = 2.0
"""How far ahead of itself a flow is taken to feel a baffle, in cells of the MPM's grid."""


def untouched(scene: Scene, boxes: Iterable[Baffle]) -> bool:
    """Whether the MPM's first frames of `scene` know nothing of baffles that may stand anywhere in `boxes`.

    Until then no point gets further than |v| t + g t^2, twice as far as in a free fall.
    """
    cells = CLEAR_CELLS * scene.domain.cell
    return all(
        gap(mass, box) > math.hypot(*(mass.velocity or (0.0,))) * MPM_SECONDS + scene.gravity * MPM_SECONDS**2 + cells
        for mass in scene.masses
        for box in boxes
    )


def gap(mass: Mass, baffle: Baffle) -> float:
    """How far two boxes are apart along the axis on which they are furthest apart [m]; negative where they overlap."""
    return max(
        max(low_b - (low_m + size_m), low_m - (low_b + size_b))
        for low_m, size_m, low_b, size_b in zip(mass.lower, mass.size, baffle.lower, baffle.size, strict=True)
    )
