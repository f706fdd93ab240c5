"""Convolutions by planes are convolutions."""

import pytest
import torch
from torch.nn import functional

from gns.model.convolution import Convolution


@pytest.mark.parametrize("dilation", [1, 2, 4])
def test_in_3d_it_is_the_convolution_in_3d(dilation: int) -> None:
    torch.manual_seed(0)
    layer = Convolution(5, 3, dilation).double()
    field = torch.randn(2, 7, 6, 8, 5, dtype=torch.float64)
    # Planes along the first axis carry the channels of their neighbours one after the other.
    kernel = layer.weight.view(5, 3, 5, 3, 3).transpose(1, 2)
    expected = functional.conv3d(field.movedim(-1, 1), kernel, layer.bias, padding=dilation, dilation=dilation)
    torch.testing.assert_close(layer(field), expected.movedim(1, -1))


def test_in_2d_it_is_torchs() -> None:
    torch.manual_seed(0)
    layer = Convolution(4, 2, 2)
    field = torch.randn(3, 9, 5, 4)
    expected = functional.conv2d(field.movedim(-1, 1), layer.weight, layer.bias, padding=2, dilation=2)
    torch.testing.assert_close(layer(field), expected.movedim(1, -1))
