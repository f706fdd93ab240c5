"""The background grid: linear fields, conservation, features of a column; the share of its cells that solids take."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from gns.surroundings.grid import REFERENCE_HEIGHT, Stencil, column_features, occupancy, stencil_of
from gns.surroundings.solids import Boxes
from tests.gns.scenery import ROOM, conditions, double, gradients_hold, plane, scattered, turned_boxes

BOX = torch.ones(1, 2, dtype=torch.float64)


@pytest.mark.parametrize("size", [(1.0, 0.4), (0.3, 0.2, 0.25)])
def test_gathering_is_exact_for_linear_fields_and_scattering_conserves(size: tuple[float, ...]) -> None:
    torch.manual_seed(0)
    box = double([size])
    positions = torch.rand(50, len(size), dtype=torch.float64) * box
    positions[0], positions[1] = 0.0, box[0]
    points = stencil_of(positions, box, 0.05, None)
    nodes = torch.cartesian_prod(*(axis[0] for axis in points.coordinates(positions)))
    slope = torch.arange(1.0, len(size) + 1.0, dtype=torch.float64)
    torch.testing.assert_close(points.gather((nodes @ slope + 2.0).unsqueeze(1))[:, 0], positions @ slope + 2.0)
    values = torch.rand(50, 3, dtype=torch.float64)
    torch.testing.assert_close(points.scatter(values).sum(0), values.sum(0))


def bed(height: float, slope: float) -> torch.Tensor:
    """Particles 0.01 m apart under the surface height + slope x, between the walls of a box of one metre."""
    lattice = torch.cartesian_prod(torch.arange(100), torch.arange(100)).double() * 0.01 + 0.005
    return lattice[lattice[:, 1] < height + slope * lattice[:, 0]]


def features(points: Stencil, count: int) -> torch.Tensor:
    """The column's features at the nodes that lie in the box, [x, y, 4], of particles of 1e-4 m^2."""
    around = replace(conditions(count), volume=torch.full((count,), 1e-4, dtype=torch.float64), size=BOX)
    inside = [(axis[0] > -1e-9) & (axis[0] < 1.0 + 1e-9) for axis in points.coordinates(BOX)]
    return column_features(points, around).view(*points.shape, 4)[inside[0]][:, inside[1]]


def test_a_bed_is_fully_packed_and_has_its_slope_and_the_overburden_of_what_lies_above() -> None:
    positions = bed(0.4, 0.0)
    packing, overburden, height, slope = features(stencil_of(positions, BOX, 0.04, None), len(positions)).unbind(-1)
    assert len(packing) == 26
    torch.testing.assert_close(packing[:, :9], torch.ones_like(packing[:, :9]), atol=0.02, rtol=0.0)
    expected = (0.4 - 0.04 * torch.arange(9, dtype=torch.float64)) / REFERENCE_HEIGHT
    # The node on the floor stands for the lower half of its cell, so what lies above it is a quarter cell less.
    torch.testing.assert_close(overburden[:, 1:9], expected[1:].expand(26, 8), atol=0.02, rtol=0.0)
    torch.testing.assert_close(height, torch.full_like(height, 4.0), atol=0.08, rtol=0.0)
    torch.testing.assert_close(slope[1:-1], torch.zeros_like(slope[1:-1]), atol=0.03, rtol=0.0)
    positions = bed(0.2, 0.4)
    slope = features(stencil_of(positions, BOX, 0.04, None), len(positions))[2:-2, :, 3]
    torch.testing.assert_close(slope, torch.full_like(slope, 0.4), atol=0.05, rtol=0.0)


def test_samples_of_a_batch_have_grids_of_their_own() -> None:
    torch.manual_seed(0)
    batch = torch.arange(20) // 10
    # The second sample is smaller, elsewhere, and in another box.
    positions = torch.where(batch.unsqueeze(1) == 0, torch.rand(20, 2), 1.2 + 0.4 * torch.rand(20, 2))
    size = torch.tensor([[1.0, 1.0], [2.0, 2.0]])
    both = stencil_of(positions, size, 0.1, batch)
    sums = both.scatter(torch.ones(20, 1)).view(2, *both.shape)
    for sample in (0, 1):
        alone = stencil_of(positions[batch == sample], size[sample : sample + 1], 0.1, None)
        assert torch.equal(alone.origin[0], both.origin[sample])
        rows, columns = alone.shape
        torch.testing.assert_close(sums[sample, :rows, :columns], alone.scatter(torch.ones(10, 1)).view(alone.shape))
        assert sums[sample].sum() == pytest.approx(10.0)


dimensions = pytest.mark.parametrize("dimension", [2, 3])


def whole_room(dimension: int, cell: float, samples: int = 1) -> Stencil:
    """A stencil whose nodes are all those of the room of each sample."""
    ends = double(ROOM[dimension])
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
        torch.stack(torch.meshgrid(*(axis[0] for axis in part), indexing="ij"), dim=-1).reshape(-1, dimension)
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
    cell, around = 0.05, conditions(1, dimension=dimension, ground=plane(dimension, (0.3, -0.1)))
    stencil = whole_room(dimension, cell)
    share = occupancy(stencil, around) - occupancy(stencil, replace(around, ground=None))
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

    assert gradients_hold(share, (baffles.requires_grad_(),))
    assert gradients_hold(share, (baffles, turn.requires_grad_()))
    around = conditions(1, dimension=dimension, ground=plane(dimension))

    def buried(elevation: Tensor) -> Tensor:
        ground = replace(plane(dimension), elevation=elevation)
        return occupancy(whole_room(dimension, 0.15), replace(around, ground=ground))

    assert gradients_hold(buried, (around.ground.elevation.requires_grad_(),))
