"""The unrolled loss, and the curriculum of its samples."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from datasets.training.samples import Flow, Sample, exchanged, mirrored
from gns.model.grid import UP
from gns.model.settings import ModelSettings
from gns.model.simulator import Normalisation, Simulator
from gns.training.batch import Particles, batched
from gns.training.flows import stretch
from gns.unroll import unroll

SHARE_EARLY = 0.12
"""Share of the other samples that starts just after, part of their history made up from the initial velocities."""
SHARE_MOVING = 0.70
"""Share of them that starts while the flow moves; the rest starts anywhere: deposits at rest must stay."""
TRIES = 16
"""Random times among which one is chosen at which the flow moves."""
SAMPLED_TIMES = 2048
"""Times in all over which the statistics run; where there are fewer, all."""


def rollout_loss(positions: Tensor, targets: Tensor, scale: float | Tensor) -> Tensor:
    """Mean over the steps k of the smooth L1 distance of positions and of displacements.

        loss = mean_k h(|x_k - X_k| / (k s)) + h(|v_k - V_k| / s),   h(e) = e^2 / 2 below 1, e - 1/2 above

    positions: of the model at the start and after each step [m], shape [K + 1, N, D]; targets: [m], [K, N, D];
    scale: s [m]. An error in the displacement grows k-fold in the position. Impacts that a step cannot resolve are
    far above s and count linearly only: they would drown the flow otherwise.
    """
    steps = torch.arange(1, len(targets) + 1, device=targets.device).view(-1, 1, 1)
    error = (positions[1:] - targets) / scale
    before = torch.cat((torch.zeros_like(error[:1]), error[:-1]))
    zero = torch.zeros_like(error)
    return functional.smooth_l1_loss(error / steps, zero) + functional.smooth_l1_loss(error - before, zero)


def share_loss(positions: Tensor, shares: Tensor, batch: Tensor, samples: int, scale: float) -> tuple[Tensor, Tensor]:
    """How far the parts of each cloud lie from those of the truth: the n-th particle along an axis from the n-th part.

    positions, shares: [m], shape [K, N, D]; batch: sample of each particle, shape [N]; scale: distance [m] that counts
    as one. Returns the mean smooth L1 distance of all samples, and that of the differences between the errors of one
    sample and of the next, for pairs of equally many particles: what is wrong with the answer to a change.

    A particle's own path is chaotic where grains collide; the distribution of all is not, and is what is observed.
    """
    errors = []
    for sample in range(samples):
        own = batch == sample
        errors.append((positions[:, own].sort(dim=1).values - shares[:, own]) / scale)
    mean = torch.stack([functional.smooth_l1_loss(error, torch.zeros_like(error)) for error in errors]).mean()
    pairs = [(a, b) for a, b in zip(errors[::2], errors[1::2], strict=False) if a.shape == b.shape]
    if not pairs:
        return mean, torch.zeros_like(mean)
    return mean, torch.stack([functional.smooth_l1_loss(a, b) for a, b in pairs]).mean()


def unrolled_steps(schedule: Sequence[int], progress: float) -> int:
    """Steps to train through at `progress` in [0, 1]: the entries of `schedule` share the budget equally."""
    return schedule[min(int(progress * len(schedule)), len(schedule) - 1)]


def remaining_steps(schedule: Sequence[int], progress: float) -> float:
    """Steps to train through per update, integrated from `progress` to 1."""
    ends = [(index + 1) / len(schedule) for index in range(len(schedule))]
    return sum(
        steps * (end - max(end - 1 / len(schedule), progress))
        for steps, end in zip(schedule, ends, strict=True)
        if end > progress
    )


class UnrolledLoss(nn.Module):
    """Batch to loss: the whole unroll is one `forward`, as DistributedDataParallel requires."""

    def __init__(
        self, simulator: Simulator, *, loss_scale: float, shares: float = 0.0, changes: float = 0.0, mixed: bool = False
    ) -> None:
        """loss_scale: `s` of `rollout_loss` as a share of the accelerations; shares, changes: weights of `share_loss`;
        mixed: products in bfloat16."""
        super().__init__()
        self.simulator = simulator
        self.loss_scale, self.shares, self.changes = loss_scale, shares, changes
        self.mixed = mixed

    def forward(self, batch: Particles, kept_steps: int) -> Tensor:
        """The loss of unrolling `batch` to its last target; kept_steps: see `gns.unroll.unroll`."""
        steps = len(batch.targets)
        with torch.autocast(batch.targets.device.type, torch.bfloat16, enabled=self.mixed):
            positions = unroll(
                self.simulator,
                batch.state,
                batch.conditions(self.simulator.settings.cell),
                steps,
                kept_steps=kept_steps,
            )
        scale = self.loss_scale * self.simulator.acceleration_scale
        loss = rollout_loss(positions, batch.targets, scale)
        if self.shares > 0.0 or self.changes > 0.0:
            cell = self.simulator.settings.cell
            apart, changed = share_loss(positions[1:], batch.shares, batch.batch, batch.num_graphs, cell)
            loss = loss + self.shares * apart + self.changes * changed
        return loss


class Curriculum:
    """Draws training samples: datasets in equal shares, their flows alike, each in a random one of its symmetries."""

    def __init__(
        self, datasets: Sequence[Sequence[Flow]], settings: ModelSettings, *, first: float = 0.15, pairs: float = 0.0
    ) -> None:
        """first: share of samples that start with the flow itself, from positions and velocities alone; pairs: share of
        batches of a flow and its variant, which starts from the same particles."""
        self._settings, self._datasets, self._first, self._pairs = settings, datasets, first, pairs
        self._partners = [partners(flows) if pairs > 0.0 else {} for flows in datasets]

    def batch(self, count: int, steps: int, rng: np.random.Generator) -> Particles:
        """`count` samples with `steps` targets, side by side."""
        samples = self.samples(count, steps, rng)
        return batched(samples, step=self._settings.step, history=self._settings.history)

    def samples(self, count: int, steps: int, rng: np.random.Generator) -> list[Sample]:
        """`count` samples with `steps` targets; of pairs the two follow each other."""
        samples: list[Sample] = []
        paired = rng.random() < self._pairs
        while len(samples) < count:
            which = int(rng.integers(len(self._datasets)))
            flows = self._datasets[which]
            number = int(rng.integers(len(flows)))
            seed = int(rng.integers(2**63))
            chosen = [number]
            if paired and len(samples) + 1 < count and number in self._partners[which]:
                chosen.append(self._partners[which][number])
            last = min(len(flows[each].positions) for each in chosen) - 1 - steps
            now = self._start(flows[number], last, rng)
            samples += [self._sample(flows[each], now, steps, np.random.default_rng(seed)) for each in chosen]
        return samples

    def _sample(self, flow: Flow, now: int, steps: int, rng: np.random.Generator) -> Sample:
        """The stretch of `flow` with `steps` targets after index `now`, in a random one of its symmetries."""
        sample = stretch(flow, self._settings, now=now, steps=steps, rng=rng)
        return turned(sample, self._settings.cell, rng)

    def _start(self, flow: Flow, last: int, rng: np.random.Generator) -> int:
        """Index at which a sample starts, at most `last`."""
        if rng.random() < self._first:
            return 0
        kind = rng.random()
        if kind < SHARE_EARLY:
            return min(int(rng.integers(1, 2 * self._settings.history + 1)), last)
        anywhere = rng.integers(0, last + 1, size=TRIES)
        if kind < SHARE_EARLY + SHARE_MOVING:
            # The first that moves is a random one of those that move, and only two frames of each are read.
            return next((int(now) for now in anywhere if flow.moves(int(now))), int(anywhere[0]))
        return int(anywhere[0])


def partners(flows: Sequence[Flow]) -> dict[int, int]:
    """Number of a flow -> number of another one that starts from the same particles."""
    alike: dict[tuple[int, int], list[int]] = {}
    for number, flow in enumerate(flows):
        alike.setdefault((flow.seed, flow.positions.shape[1]), []).append(number)
    return {a: b for group in alike.values() for a, b in zip(group, group[1:] + group[:1], strict=True) if a != b}


def turned(sample: Sample, spacing: float, rng: np.random.Generator) -> Sample:
    """The sample in a random one of the symmetries of its box; spacing: between two elevations of its ground [m]."""
    size = sample.surroundings.size
    for axis in (axis for axis in range(len(size)) if axis != UP):
        if rng.random() < 0.5:
            sample = mirrored(sample, axis, spacing)
    if len(size) == 3 and rng.random() < 0.5:
        sample = exchanged(sample)
    return sample


def statistics(datasets: Sequence[Sequence[Flow]]) -> Normalisation:
    """Normalisation constants, over times at which the flows move.

    Of each flow as many random times are read as make `SAMPLED_TIMES` in all, at least two; always the same ones.
    """
    displacement, acceleration, count = 0.0, 0.0, 0
    friction = []
    share = max(2, -(-SAMPLED_TIMES // sum(map(len, datasets))))
    rng = np.random.default_rng(0)
    for flow in (flow for flows in datasets for flow in flows):
        friction.append(flow.friction.mean(dtype=np.float64))
        times = len(flow.positions) - 2
        for time in rng.choice(times, min(share, times), replace=False):
            if not flow.moves(time):
                continue
            moved = np.diff(flow.positions[time : time + 3], axis=0)
            change = moved[1] - moved[0]
            change -= flow.surroundings.gravity * flow.step**2
            displacement += float(np.square(moved[0], dtype=np.float64).sum())
            acceleration += float(np.square(change, dtype=np.float64).sum())
            count += change.size
    return Normalisation(
        displacement=float(np.sqrt(displacement / max(count, 1))) or 1.0,
        acceleration=float(np.sqrt(acceleration / max(count, 1))) or 1.0,
        friction_mean=float(np.mean(friction)),
        friction_std=float(np.std(friction)) or 1.0,
    )
