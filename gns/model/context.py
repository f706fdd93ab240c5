"""The grid context: information across the whole domain in one step, through a background grid.

A message-passing step carries information over one cutoff radius, while a step of the model spans many. Latents are
scattered to a coarse grid around the material, convolved there, and interpolated back to the nodes of the graph: a
receptive field as wide as the flow for little more time (the idea of CoRGI, arXiv 2511.22938).
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from gns.model.convolution import Convolution
from gns.model.grid import Stencil
from gns.model.settings import ModelSettings


def channels(settings: ModelSettings) -> int:
    """Input channels of every grid node: `gns.model.grid.column_features`, and the share of its cell without room."""
    return settings.dimension + 3


class GridContext(nn.Module):
    """Latents of the graph's nodes [N, C] to an increment of them [N, C] by convolutions on the grid."""

    def __init__(self, settings: ModelSettings) -> None:
        super().__init__()
        count = settings.grid_channels
        self.to_grid = nn.Linear(settings.width, count)
        self.mix = nn.Linear(count + channels(settings), count)
        self.layers = nn.ModuleList(
            Convolution(count, settings.dimension, 2**layer) for layer in range(settings.grid_layers)
        )
        self.from_grid = nn.Linear(count, settings.width)

    def forward(self, x: Tensor, stencil: Stencil, fraction: Tensor, nodes: Tensor) -> Tensor:
        """Scatter, convolve, interpolate.

        x: latents [N, C]; fraction: volume of each particle over that of a grid cell [-], shape [N, 1];
        nodes: input channels of the grid's nodes, [B * nodes, `channels`].
        """
        inputs = torch.cat((stencil.scatter(self.to_grid(x) * fraction), nodes), dim=1)
        field = masked(functional.silu(self.mix(inputs)).view(stencil.samples, *stencil.shape, -1), stencil)
        for layer in self.layers:
            field = masked(field + functional.silu(layer(field)), stencil)
        return torch.as_tensor(self.from_grid(stencil.gather(field.reshape(-1, field.shape[-1]))))


def masked(field: Tensor, stencil: Stencil) -> Tensor:
    """The field, zero where a sample alone would have no nodes: what is beside it makes no difference."""
    return field if stencil.own is None else field * stencil.own
