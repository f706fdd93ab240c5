"""Convolutions on the background grid, channels last, in 2D and 3D.

A convolution in 3D is done as one in 2D, over planes that carry the channels of their neighbours too: on a CPU torch's
own takes five times as long at these sizes.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional


class Convolution(nn.Conv2d):
    """Kernels of 3 nodes along each axis, `dilation` nodes apart; around the grid are zeros."""

    def __init__(self, channels: int, dimension: int, dilation: int) -> None:
        planes = 3 ** (dimension - 2)
        super().__init__(planes * channels, channels, 3, padding=dilation, dilation=dilation)

    def forward(self, field: Tensor) -> Tensor:
        """[B, X, Y, C] to the same shape, in 3D [B, X, Y, Z, C]."""
        if field.dim() == 4:
            return super().forward(field.movedim(-1, 1)).movedim(1, -1)
        width, count = self.dilation[0], field.shape[1]
        padded = functional.pad(field, (0, 0, 0, 0, 0, 0, width, width))
        beside = torch.cat([padded[:, index * width : index * width + count] for index in range(3)], dim=-1)
        return super().forward(beside.flatten(0, 1).movedim(-1, 1)).movedim(1, -1).reshape(field.shape)
