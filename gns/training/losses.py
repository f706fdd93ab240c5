"""The losses of a training: the error of unrolled steps, or that of corrected ends.

    loss = mean_k h(|x_k - X_k| / (k s)) + h(|v_k - V_k| / s),   h(e) = e^2 / 2 below 1, e - 1/2 above

over the steps k of a rollout. An error in the displacement grows k-fold in the position. Impacts that a step cannot
resolve are far above s and count only linearly; otherwise they would dominate. With a `density_weight`, the error of
the density is added (`density_loss`): particles that each err little may still lie too loosely or too high.

| symbol | variable           | meaning                                    |
| x, v   | `positions`        | of the model, and their differences        |
| X, V   | `SampleBatch.targets`    | of the MPM                                 |
| s      | `scale`            | a share of the accelerations per step [m]  |
"""

from functools import partial

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from gns.network.correction import length_of
from gns.network.features import NODES
from gns.settings import TrainingSettings
from gns.simulator import Simulator, step_activation_bytes, unroll
from gns.surroundings.grid import stencil_of
from gns.surroundings.state import Conditions, computed
from gns.training.samples import Ends, Rollouts, SampleBatch, measured

MARGIN = 1.5  # some batches have more neighbours per particle than the one whose memory was measured
# Scales of the errors of a corrected end: of a particle over L, of a flow's ends and equal shares over its extent.
PLACE, END, SHARE = 0.1, 0.03, 0.02
NORMALISED = 24  # batches that normalise the features of a new correction
CONSTANT = 1.0e-3  # standard deviation of a feature below which it counts as constant [-]
HALF_PRECISION = bool(torch.cpu.get_capabilities().get("avx512_bf16"))  # whether products in bfloat16 are faster here
OF_ENDS = 0.3  # weight of the terms of ends and of shares


class UnrolledLoss(nn.Module):
    """The loss of samples; the whole unroll is one `forward`, as DistributedDataParallel requires."""

    def __init__(self, simulator: Simulator, training: TrainingSettings) -> None:
        super().__init__()
        self.simulator, self.scale, self.memory = simulator, training.loss_scale, training.memory_gib * 2**30
        self.density = partial(density_loss, cell=simulator.settings.grid_cell, weight=training.density_weight)
        self._particle_bytes = 0.0
        simulator.network.half_precision = HALF_PRECISION

    def forward(self, batch: SampleBatch) -> Tensor:
        """The loss of unrolling `batch` to its last target."""
        state, conditions, particles = batch.state, batch.conditions, len(batch.state.positions)
        if not self._particle_bytes:
            self._particle_bytes = MARGIN * step_activation_bytes(self.simulator, state, conditions) / particles
        kept = int(self.memory / (self._particle_bytes * particles))
        positions = unroll(self.simulator, state, conditions, len(batch.targets), kept_steps=kept)
        loss = rollout_loss(positions, batch.targets, self.scale * self.simulator.acceleration_scale)
        return loss + self.density(positions[-1], batch.targets[-1], conditions)


def rollout_loss(positions: Tensor, targets: Tensor, scale: float | Tensor) -> Tensor:
    """The loss of a rollout; positions: from its start on [m], [K + 1, N, D]; targets: [m], [K, N, D]; scale: s [m]."""
    steps = torch.arange(1, len(targets) + 1, device=targets.device).view(-1, 1, 1)
    error = (positions[1:] - targets) / scale
    before = torch.cat((torch.zeros_like(error[:1]), error[:-1]))
    return huber(error / steps) + huber(error - before)


def huber(error: Tensor) -> Tensor:
    """Mean of h(e)."""
    return functional.smooth_l1_loss(error, torch.zeros_like(error))


def density_loss(points: Tensor, targets: Tensor, conditions: Conditions, cell: float, weight: float = 1.0) -> Tensor:
    """Relative error of the density of flows at grid nodes, averaged over the samples, times its weight,

        mean_b sum_n (r_n - R_n)^2 / sum_n R_n^2,    r_n = sum_i w_n(x_i) V_i / h^D

    with multilinear weights w. points x with density r, targets with density R: [m], [N, D]; cell: h [m].
    """
    if weight == 0.0:
        return points.new_zeros(())
    samples, share = len(conditions.size), conditions.volume.unsqueeze(1) / cell ** points.shape[1]
    batch = None if conditions.batch is None else conditions.batch.repeat(2)
    # A correction may move points out of the box, where there are no nodes.
    box = conditions.size if batch is None else conditions.size.index_select(0, batch)
    places = torch.minimum(torch.cat((points, targets)).clamp(min=0.0), box)
    stencil = stencil_of(places, conditions.size, cell, batch)
    none = torch.zeros_like(share)
    # Both are summed in the same order, so that the same particles have the same density to the bit.
    density, required = (stencil.scatter(torch.cat(both)).view(samples, -1) for both in ((share, none), (none, share)))
    return weight * ((density - required).square().sum(dim=1) / required.square().sum(dim=1)).mean()


class EndLoss(nn.Module):
    """The loss of the correction of rollouts' ends,

        mean h(|x - X| / (c_x L)) + w (mean h((e - E) / (c_e l)) + mean h((q - Q) / (c_q l)))

    over particles, the ends e and the places q of equal shares of the volume; l: extent of the MPM's flow. E and Q come
    from all its particles: among the few that a rollout follows, single ones make up the front.
    """

    def __init__(self, simulator: Simulator, rollouts: Rollouts, training: TrainingSettings) -> None:
        """The features of a new correction are normalised by `NORMALISED` batches of the rollouts."""
        super().__init__()
        assert simulator.correction is not None
        self.simulator, self.correction = simulator, simulator.correction
        self.density = partial(density_loss, cell=simulator.settings.grid_cell, weight=training.density_weight)
        self.correction.network.half_precision = HALF_PRECISION
        if (self.correction.std != 1.0).any():
            return  # already normalised
        features = []
        for ends in (rollouts.batch(0, np.random.default_rng(number)) for number in range(NORMALISED)):
            end = simulator.moment(ends.end, ends.conditions)
            features.append(self.correction.features(ends.state, end, computed(NODES, end)))
        every = torch.cat(features)
        self.correction.mean.copy_(every.mean(dim=0))
        # A feature that hardly varies in training, such as wall friction, is not scaled up.
        deviation = every.std(dim=0)
        self.correction.std.copy_(torch.where(deviation > CONSTANT, deviation, 1.0))

    def forward(self, batch: Ends) -> Tensor:
        conditions = batch.conditions
        positions = batch.end.positions + self.correction(batch.state, self.simulator.moment(batch.end, conditions))
        error = (positions - batch.targets[-1]) / (PLACE * length_of(self.correction.settings))
        extents = []
        for sample in range(len(conditions.size)):
            members = slice(None) if conditions.batch is None else conditions.batch == sample
            extents.append(measured(positions[members], conditions.volume[members]))
        off = (torch.stack(extents) - batch.whole) / batch.whole[..., :2].sum(dim=2, keepdim=True)
        loss = huber(error) + OF_ENDS * huber(off[..., :2] / END) + OF_ENDS * huber(off[..., 2:] / SHARE)
        return loss + self.density(positions, batch.targets[-1], conditions)
