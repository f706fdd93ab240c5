"""Sight beyond its hops: the points see each other through a background grid.

Each layer of messages carries news over one radius, a step of the model spans many. Scattering the latents to a
coarse grid over the whole domain, convolving there and interpolating back lets every point see the whole flow for
little more time (the idea of CoRGI, arXiv 2511.22938). Walls are the zeros around the grid.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from gns.kernels.linear import Linear
from gns.model.convolution import Convolution
from gns.model.grid import Stencil
from gns.model.settings import ModelSettings


def channels(settings: ModelSettings) -> int:
    """Channels that every node of the grid starts with: `gns.model.grid.surroundings`, and what baffles cover of its cell."""
    return settings.dimension + 2 + (1 if settings.baffles else 0)


class Context(nn.Module):
    """Latents of the points [N, C] to what the grid makes of them [N, C]."""

    def __init__(self, settings: ModelSettings) -> None:
        super().__init__()
        count = settings.grid_channels
        self.to_grid = Linear(settings.width, count)
        self.mix = Linear(count + channels(settings), count)
        self.layers = nn.ModuleList(
            Convolution(count, settings.dimension, 2**layer) for layer in range(settings.grid_layers)
        )
        self.from_grid = Linear(count, settings.width)

    def forward(self, x: Tensor, points: Stencil, share: Tensor, around: Tensor) -> Tensor:
        """Look around.

        x: latents [N, C]; share: volume of each point over that of a grid cell [-], shape [N, 1];
        around: what is known of the nodes, [B * nodes, `channels`].
        """
        seen = torch.cat((points.scatter(self.to_grid(x) * share), around), dim=1)
        field = functional.silu(self.mix(seen)).view(points.samples, *points.shape, -1)
        for layer in self.layers:
            field = field + functional.silu(layer(field))
        return torch.as_tensor(self.from_grid(points.gather(field.reshape(-1, field.shape[-1]))))
