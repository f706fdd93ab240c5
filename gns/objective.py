"""What training minimises, and on which stretches of which flows."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from datasets.samples import Flow, Sample, cut, mirrored
from gns.settings import ModelSettings
from gns.simulator import Normalisation

SHARE_FIRST = 0.15
"""Share of samples that start with the flow itself: from positions and velocities alone."""
SHARE_EARLY = 0.10
"""Share that starts just after, with part of the history made up from the initial velocities."""
SHARE_MOVING = 0.60
"""Share that starts while the flow moves; the rest starts anywhere, settled deposits too: they must stay put."""


def rollout_loss(positions: Tensor, targets: Tensor, scale: float) -> Tensor:
    """Mean over the steps k of the smooth L1 distance of positions and of displacements.

        loss = mean_k h(|x_k - X_k| / (k s)) + h(|v_k - V_k| / s),   h(e) = e^2 / 2 below 1, e - 1/2 above

    positions: of the model at the start and after each step [m], shape [K + 1, N, D]; targets: [m], [K, N, D];
    scale: s [m]. An error in the displacement grows k-fold in the position. Impacts that a step cannot resolve are
    far above s and count linearly only: they would drown the flow otherwise.
    """
    steps = torch.arange(1, len(targets) + 1).view(-1, 1, 1)
    error = (positions[1:] - targets) / scale
    before = torch.cat((torch.zeros_like(error[:1]), error[:-1]))
    zero = torch.zeros_like(error)
    return functional.smooth_l1_loss(error / steps, zero) + functional.smooth_l1_loss(error - before, zero)


def unrolled_steps(schedule: Sequence[int], progress: float) -> int:
    """Steps to train through at `progress` in [0, 1]: the entries of `schedule` share the time equally."""
    return schedule[min(int(progress * len(schedule)), len(schedule) - 1)]


class Curriculum:
    """Draws training samples: datasets in equal shares, flows of a dataset alike, mirrored at random."""

    def __init__(self, datasets: Sequence[Sequence[Flow]], settings: ModelSettings) -> None:
        self._datasets = datasets
        self._moving = [[flow.moving() for flow in flows] for flows in datasets]
        self._settings = settings

    def draw(self, steps: int, rng: np.random.Generator) -> Sample:
        """One sample with `steps` targets."""
        settings = self._settings
        group = int(rng.integers(len(self._datasets)))
        index = int(rng.integers(len(self._datasets[group])))
        flow, moving = self._datasets[group][index], self._moving[group][index]
        last = len(flow.positions) - 1 - steps
        sample = cut(
            flow,
            now=min(self._start(last, moving[moving <= last], rng), last),
            steps=steps,
            history=settings.history,
            cell=settings.cell,
            kept=settings.points_per_cell,
            rng=rng,
        )
        return mirrored(sample, flow.size[0]) if rng.random() < 0.5 else sample

    def _start(self, last: int, moving: np.ndarray, rng: np.random.Generator) -> int:
        kind = rng.random()
        if kind < SHARE_FIRST:
            return 0
        if kind < SHARE_FIRST + SHARE_EARLY:
            return int(rng.integers(1, 2 * self._settings.history + 1))
        if kind < SHARE_FIRST + SHARE_EARLY + SHARE_MOVING and len(moving):
            return int(rng.choice(moving))
        return int(rng.integers(0, last + 1))


def statistics(flows: Sequence[Flow]) -> Normalisation:
    """Normalisation constants, over the moving times of all flows."""
    displacement, acceleration, count = 0.0, 0.0, 0
    for flow in flows:
        moved = np.diff(flow.positions, axis=0)
        change = np.diff(moved, axis=0)
        change[..., 1] += flow.gravity * flow.step**2
        times = flow.moving()
        times = times[times < len(change)]
        displacement += float(np.square(moved[times], dtype=np.float64).sum())
        acceleration += float(np.square(change[times], dtype=np.float64).sum())
        count += change[times].size
    friction = np.array([flow.friction.mean(dtype=np.float64) for flow in flows])
    return Normalisation(
        displacement=float(np.sqrt(displacement / max(count, 1))) or 1.0,
        acceleration=float(np.sqrt(acceleration / max(count, 1))) or 1.0,
        friction_mean=float(friction.mean()),
        friction_std=float(friction.std()) or 1.0,
    )
