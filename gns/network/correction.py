"""The correction: a network that learns whole rollouts moves the end of a rollout to that of the MPM's flow.

    x'_K = x_K + L/10 C(start, x_K, conditions)     C: `gns.network.network.Network`, one pass per rollout
    x'_k = x_k + w_k (x'_K - x_K),                  w_k = sum_{j <= k} |v_j|^2 / sum_{j <= K} |v_j|^2

with L = `length_of`, positions x_k and their changes v_k. An error that accumulates in the same way in all flows of a
kind, such as a front that falls short, is hard for the steps to unlearn: a gradient through all of them costs as much
as a hundred passes of C, which sees end, start and surroundings at once. K is any step; the path to it is stretched in
proportion to the motion.
"""

import dataclasses

import torch
from torch import Tensor, nn

from gns.network.features import NODES, Inputs
from gns.network.network import Network
from gns.settings import GRAVITY, ModelSettings
from gns.surroundings.contact import keep_out
from gns.surroundings.forces import Moment
from gns.surroundings.state import Conditions, State, columns

WIDTH = 64  # of its latent vectors; a wider one overfits
NOISE = 0.2  # standard deviation of the noise on the normalised features of a whole flow in training [-]
DISPLACEMENT = 0.1  # displacement over L for an output of one [-]
SMALLEST = 1.0e-3  # standard deviation of a flow over L, below which a division by it fades [-]
LARGEST = 5.0  # largest absolute value of a normalised feature [-]


class Correction(nn.Module):
    """C: its input is the features at the end, and the place of each particle in the whole flow, normalised."""

    mean: Tensor
    std: Tensor

    def __init__(self, settings: ModelSettings) -> None:
        super().__init__()
        self.settings = settings
        count = columns(NODES, settings) + 9 * settings.dimension
        self.register_buffer("mean", torch.zeros(count))
        self.register_buffer("std", torch.ones(count))
        self.network = Network(count, 0, dataclasses.replace(settings, width=WIDTH))

    def forward(self, start: State, end: Moment) -> Tensor:
        """x'_K - x_K [m], shape [N, D], before any contact; in units of the model."""
        inputs, conditions = Inputs.of_moment(end), end.conditions
        features = (self.features(start, end, inputs.features) - self.mean) / self.std
        if self.training:
            # Features that are constant over a flow identify it: without noise the network overfits.
            noise = NOISE * torch.randn(len(conditions.size), features.shape[1]).to(features)
            features = features + conditions.of_particles(noise)
        moved = self.network(dataclasses.replace(inputs, features=features.clamp(-LARGEST, LARGEST)))
        return DISPLACEMENT * length_of(self.settings) * torch.as_tensor(moved)

    def features(self, start: State, end: Moment, nodes: Tensor) -> Tensor:
        """Features [N, F]: those of the nodes at the end, and over L and (g L)^(1/2) per step

            x_K - x_0, x_0 - <x_0>, x_K - <x_K>, v_0, <v_0>, <x_K> - <x_0>, std(x_0), std(x_K), (x_K - <x_K>) / std(x_K)

        with means <> and deviations over the volume of the flow.
        """
        length, conditions = length_of(self.settings), end.conditions
        speed = self.settings.step * (GRAVITY * length) ** 0.5
        first, last, velocity = start.positions / length, end.state.positions / length, start.displacements[-1] / speed
        whole = torch.cat((first, last, velocity), dim=1)
        middle = average(whole, conditions)
        here = whole - middle
        begun, ended, thrown = middle.chunk(3, dim=1)
        own_first, own_last, _ = here.chunk(3, dim=1)
        before, after, _ = (average(here.square(), conditions) + SMALLEST**2).sqrt().chunk(3, dim=1)
        places = (last - first, own_first, own_last, velocity, thrown, ended - begun, before, after, own_last / after)
        return torch.cat((nodes, *(place.expand_as(first) for place in places)), dim=1)


def average(values: Tensor, conditions: Conditions) -> Tensor:
    """Mean of values [N, C] over the volume of each flow, for each of its particles; shape [N or 1, C]."""
    share = conditions.volume.unsqueeze(1)
    return conditions.of_particles(conditions.total(share * values) / conditions.total(share))


def length_of(settings: ModelSettings) -> float:
    """L [m]: the length of the released body; for a model that does not scale its scenes, ten cutoff radii."""
    return settings.body_length or 10.0 * settings.radius


def stretched(positions: Tensor, moved: Tensor, conditions: Conditions) -> Tensor:
    """Positions of a rollout [m], shape [K + 1, N, D], stretched to an end displaced by `moved` [m], shape [N, D]."""
    steps = (positions[1:] - positions[:-1]).square().sum(dim=2)
    passed = conditions.of_particles(conditions.total(steps.T)).T.cumsum(dim=0)
    # Of a flow that does not move the shares are 0, and so is their gradient.
    shares = (passed / passed[-1].clamp(min=1.0e-12)).unsqueeze(2)
    ways = [keep_out(at + share * moved, at, conditions) for at, share in zip(positions[1:], shares, strict=True)]
    return torch.stack((positions[0], *ways))
