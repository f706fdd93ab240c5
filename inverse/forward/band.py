"""The surrogate's error in any observation: its deposit moved within its band, observed, less the deposit observed.

A card says how far fronts and profiles of held-out flows are off, as shares b_f and b_p of a flow's extent L (95 %).
With s = (x - rear) / L, across the flow s = (z - middle) / width, its positions are moved along this axis by

    b_f L / 1.96 s    and    b_p L / 1.96 sin(k pi s) / sqrt(K),  k = 1 .. K

one displacement after the other, in a flow over time in proportion to the time. What each changes of the numbers is a
column e_k of their covariance, sum_k e_k e_k^T: so a band of two numbers is one of a front, a toe, a profile, a gauge
or all together, each in its own unit.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from datasets.scene import Scene
from gns import card

WAVES = 3
"""K."""
NORMAL = 1.96
"""Half of a 95 % interval over the standard deviation."""


@dataclass(frozen=True, kw_only=True)
class Band:
    """How far 95 of 100 deposits of the MPM are at most from those of a surrogate, over their extent [-]."""

    front: float = 0.05
    """b_f."""
    profile: float = 0.03
    """b_p."""

    def moved(self, positions: Tensor) -> Iterator[Tensor]:
        """Positions [m], shape [T, n, D], moved by one displacement after the other."""
        time = torch.linspace(0.0, 1.0, len(positions), dtype=positions.dtype)[:, None]
        for axis in range(0, positions.shape[2], 2):
            along, last = positions[:, :, axis], positions[-1, :, axis]
            origin = positions[0, :, axis].min() if axis == 0 else 0.5 * (last.min() + last.max())
            extent = last.max() - (origin if axis == 0 else last.min())
            share = (along - origin) / extent
            waves = [torch.sin(k * math.pi * share) / math.sqrt(WAVES) for k in range(1, WAVES + 1)]
            for shape in (self.front * share, *(self.profile * wave for wave in waves)):
                other = positions.clone()
                other[:, :, axis] += extent / NORMAL * time * shape
                yield other


def band_of(weights: Path, scene: Scene) -> Band:
    """That of the model in the file `weights` for `scene`, by its card; the usual one where it says nothing."""
    described = card.read(weights)
    known = described.calibration(scene) if described is not None else None
    return Band() if known is None else Band(front=known.front["0.95"], profile=known.profile["0.95"])
