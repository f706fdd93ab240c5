"""The density in the loss: no error of the exact answer, the gradient of central differences, heights that it sees."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from gns.surroundings.state import Conditions
from gns.training.losses import density_loss
from tests.gns.scenery import conditions

CELL = 0.05


def scattered(dimension: int, count: int = 30) -> tuple[Tensor, Conditions]:
    """Two samples of particles, both in double precision [m], and what surrounds them."""
    generator = torch.Generator().manual_seed(dimension)
    points = 0.1 + 0.25 * torch.rand(2 * count, dimension, generator=generator, dtype=torch.float64)
    batch = torch.arange(2).repeat_interleave(count)
    around = conditions(2 * count, dimension=dimension, batch=batch)
    volume = 1.0e-4 * (1.0 + torch.rand(2 * count, generator=generator, dtype=torch.float64))
    return points, replace(around, volume=volume, size=around.size.expand(2, -1))


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_density_has_no_error_in_the_exact_answer_and_the_gradient_of_differences(dimension: int) -> None:
    points, around = scattered(dimension)
    free = points.clone().requires_grad_()
    loss = density_loss(free, points, around, cell=CELL)
    assert loss.item() == 0.0
    assert not torch.autograd.grad(loss, free)[0].any()
    generator = torch.Generator().manual_seed(9)
    off, way = (0.01 * torch.randn(points.shape, generator=generator, dtype=torch.float64) for _ in range(2))
    free = (points + off).requires_grad_()
    slope = torch.autograd.grad(density_loss(free, points, around, cell=CELL), free)[0]
    derivative = float((slope * way).sum())
    with torch.no_grad():
        # So short a way that no particle comes to another cell, where the weights have a kink.
        high, low = (density_loss(free + sign * 1.0e-5 * way, points, around, cell=CELL) for sign in (1.0, -1.0))
    assert abs(derivative) > 1.0e-3
    assert derivative == pytest.approx(float(high - low) / 2.0e-5, rel=1.0e-6)


def test_a_flow_that_is_puffed_up_or_a_layer_higher_is_seen() -> None:
    points, around = scattered(2)
    puffed = torch.stack((points[:, 0], 1.4 * points[:, 1]), dim=1)
    assert density_loss(puffed, points, around, cell=CELL).item() > 0.1
    # Lifted by a cell all that was there is not there.
    lifted = points + torch.tensor([0.0, 0.5], dtype=torch.float64)
    alone = replace(around, size=around.size + 1.0)
    assert density_loss(lifted, points, alone, cell=CELL).item() == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_particle_that_was_led_out_of_the_box_counts_at_its_edge(dimension: int) -> None:
    points, around = scattered(dimension)
    out, edge = points.clone(), points.clone()
    out[0, 0], edge[0, 0] = -3.0, 0.0
    out[1], edge[1] = 100.0, around.size[0]
    losses = [density_loss(moved, points, around, cell=CELL).item() for moved in (out, edge)]
    assert losses[0] == losses[1] > 0.0
