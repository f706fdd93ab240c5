"""The fast product is torch's, and so is its gradient."""

import pytest
import torch

from gns.kernels import linear
from gns.kernels.linear import Linear


@pytest.mark.parametrize("points", [0, 1, 700])
@pytest.mark.parametrize("bias", [True, False])
def test_the_fast_product_and_its_gradients_are_torchs(
    points: int, bias: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    torch.manual_seed(0)
    layer = Linear(48, 33, bias=bias)
    x, wanted = torch.randn(points, 48, requires_grad=True), torch.randn(points, 33)
    leaves = [x, *layer.parameters()]
    results = []
    for product in (linear._product, None):
        monkeypatch.setattr(linear, "_product", product)
        y = layer(x)
        results.append((y, *torch.autograd.grad(y, leaves, wanted)))
    for fast, plain in zip(*results, strict=True):
        torch.testing.assert_close(fast, plain, atol=1e-4, rtol=1e-5)


def test_this_build_of_torch_has_the_fast_product() -> None:
    # Elsewhere it is only slower; here its loss should not go unnoticed.
    assert linear._product is not None


def test_double_precision_stays_double() -> None:
    torch.manual_seed(0)
    layer = Linear(5, 4).double()
    x = torch.randn(6, 5, dtype=torch.float64)
    torch.testing.assert_close(layer(x), x @ layer.weight.T + layer.bias, atol=1e-14, rtol=1e-14)
