"""Sight beyond its hops: the points see each other through a background grid.

Each layer of messages carries news over one radius, a step of the model spans many. Scattering the latents to a
coarse grid over the whole domain, convolving there and interpolating back lets every point see the whole flow for
little more time (the idea of CoRGI, arXiv 2511.22938). Walls are the zeros around the grid.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from gns.grid import Stencil
from gns.settings import ModelSettings


class Context(nn.Module):
    """Latents of the points [N, C] to what the grid makes of them [N, C]."""

    def __init__(self, settings: ModelSettings) -> None:
        super().__init__()
        convolution: type[nn.Conv2d] | type[nn.Conv3d] = nn.Conv2d if settings.dimension == 2 else nn.Conv3d
        channels = settings.grid_channels
        surroundings = settings.dimension + 2
        self.to_grid = nn.Linear(settings.width, channels)
        self.mix = nn.Linear(channels + surroundings, channels)
        self.layers = nn.ModuleList(
            convolution(channels, channels, 3, padding=2**layer, dilation=2**layer)
            for layer in range(settings.grid_layers)
        )
        self.from_grid = nn.Linear(channels, settings.width)

    def forward(self, x: Tensor, points: Stencil, share: Tensor, around: Tensor) -> Tensor:
        """Look around.

        x: latents [N, C]; share: volume of each point over that of a grid cell [-], shape [N, 1];
        around: `gns.grid.surroundings`, [B * nodes, D + 2].
        """
        seen = torch.cat((points.scatter(self.to_grid(x) * share), around), dim=1)
        field = functional.silu(self.mix(seen)).view(points.samples, *points.shape, -1).movedim(-1, 1)
        for layer in self.layers:
            field = field + functional.silu(layer(field))
        grid = field.movedim(1, -1).reshape(-1, field.shape[1])
        return torch.as_tensor(self.from_grid(points.gather(grid)))
