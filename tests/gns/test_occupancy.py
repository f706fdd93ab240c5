"""Occupancy: the share of a cell that solids take, to the volume of the solids in all."""

import dataclasses
import math

import pytest
import torch
from torch import Tensor

from gns.grid import Stencil, occupancy, stencil_of
from gns.solids import Boxes
from tests.gns.surroundings import ROOM, conditions, plane, scattered, turned_boxes

dimensions = pytest.mark.parametrize("dimension", [2, 3])


def whole_room(dimension: int, cell: float, samples: int = 1) -> Stencil:
    """A stencil whose nodes are all those of the room of each sample."""
    ends = torch.tensor(ROOM[dimension], dtype=torch.float64)
    points = torch.stack((torch.zeros_like(ends), ends - 1e-6)).repeat(samples, 1)
    batch = torch.arange(samples).repeat_interleave(2)
    return stencil_of(points, ends.expand(samples, -1), cell, batch)


@dimensions
@pytest.mark.parametrize("is_turned", [False, True])
def test_it_is_the_share_of_random_points_of_a_cell(dimension: int, is_turned: bool) -> None:
    cell = 0.06
    generator = torch.Generator().manual_seed(0)
    baffles, turn = turned_boxes(dimension) if is_turned else (scattered(dimension), None)
    stencil = whole_room(dimension, cell, samples=2)
    around = conditions(1, baffles, turn=turn)
    share = occupancy(stencil, around)
    assert share.shape == (2 * math.prod(stencil.shape), 1)
    assert share.min() == 0.0
    assert share.max() == pytest.approx(1.0)
    begin, end = (
        torch.stack(torch.meshgrid(*(each[0] for each in part), indexing="ij"), dim=-1).reshape(-1, dimension)
        for part in stencil.cells(around.size)
    )
    within = ((end - begin).prod(1) > 0.0).nonzero().squeeze(1)
    some = within[torch.randperm(len(within), generator=generator)[:400]]
    random = torch.rand(1000, 1, dimension, generator=generator).double()
    positions = (begin[some] + random * (end - begin)[some]).flatten(0, 1)
    room = ((end - begin).prod(1) / cell**dimension)[some]
    for sample in (0, 1):
        solid = Boxes.of_conditions(around).select(torch.full((len(positions),), sample))
        inside = solid.contain(positions, 0.0).any(1).view(1000, -1).double().mean(0)
        torch.testing.assert_close(share.view(2, -1)[sample, some], 1.0 - room * (1.0 - inside), atol=0.07, rtol=0.0)


@dimensions
def test_it_sums_to_the_volume_below_a_plane(dimension: int) -> None:
    cell, around = 0.05, conditions(1, dimension=dimension, ground=plane(dimension, rise=(0.3, -0.1)))
    stencil = whole_room(dimension, cell)
    share = occupancy(stencil, around) - occupancy(stencil, dataclasses.replace(around, ground=None))
    size = ROOM[dimension]
    middle = 0.1 + 0.3 * 0.5 * size[0] - (0.1 * 0.5 * size[2] if dimension == 3 else 0.0)
    area = math.prod(size) / size[1]
    assert float(share.sum()) * cell**dimension == pytest.approx(middle * area, rel=1e-6)


@dimensions
def test_gradients_are_those_of_central_differences(dimension: int) -> None:
    generator = torch.Generator().manual_seed(0)
    baffles, turn = turned_boxes(dimension)
    baffles = baffles + 1e-3 * torch.rand(baffles.shape, generator=generator).double()
    stencil = whole_room(dimension, 0.15, samples=2)

    def share(b: Tensor, t: Tensor | None = None) -> Tensor:
        return occupancy(stencil, conditions(1, b, turn=t))

    assert torch.autograd.gradcheck(share, (baffles.requires_grad_(),), eps=1e-7, atol=1e-5, fast_mode=True)
    assert torch.autograd.gradcheck(share, (baffles, turn.requires_grad_()), eps=1e-7, atol=1e-5, fast_mode=True)
    around = conditions(1, dimension=dimension, ground=plane(dimension))
    assert around.ground is not None

    def buried(elevation: Tensor) -> Tensor:
        ground = dataclasses.replace(plane(dimension), elevation=elevation)
        return occupancy(whole_room(dimension, 0.15), dataclasses.replace(around, ground=ground))

    assert torch.autograd.gradcheck(
        buried, (around.ground.elevation.requires_grad_(),), eps=1e-7, atol=1e-5, fast_mode=True
    )
