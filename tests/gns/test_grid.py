"""The background grid: exact for linear fields, conserving, as large as the flow, and its features of a column."""

import pytest
import torch

from gns.grid import REFERENCE_HEIGHT, Stencil, column_features, stencil_of

BOX = torch.ones(1, 2, dtype=torch.float64)


@pytest.mark.parametrize("size", [(1.0, 0.4), (0.3, 0.2, 0.25)])
def test_gathering_is_exact_for_linear_fields_and_scattering_conserves(size: tuple[float, ...]) -> None:
    torch.manual_seed(0)
    box = torch.tensor([size], dtype=torch.float64)
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
    volume = torch.full((count,), 1e-4, dtype=torch.float64)
    inside = [(axis[0] > -1e-9) & (axis[0] < 1.0 + 1e-9) for axis in points.coordinates(volume)]
    return column_features(points, volume, BOX).view(*points.shape, 4)[inside[0]][:, inside[1]]


def test_a_level_bed_is_fully_packed_and_has_the_overburden_of_what_lies_above() -> None:
    positions = bed(0.4, 0.0)
    packing, overburden, height, slope = features(stencil_of(positions, BOX, 0.04, None), len(positions)).unbind(-1)
    assert len(packing) == 26
    torch.testing.assert_close(packing[:, :9], torch.ones_like(packing[:, :9]), atol=0.02, rtol=0.0)
    expected = (0.4 - 0.04 * torch.arange(9, dtype=torch.float64)) / REFERENCE_HEIGHT
    # The node on the floor stands for the lower half of its cell, so what lies above it is a quarter cell less.
    torch.testing.assert_close(overburden[:, 1:9], expected[1:].expand(26, 8), atol=0.02, rtol=0.0)
    torch.testing.assert_close(height, torch.full_like(height, 4.0), atol=0.08, rtol=0.0)
    torch.testing.assert_close(slope[1:-1], torch.zeros_like(slope[1:-1]), atol=0.03, rtol=0.0)


def test_the_slope_is_that_of_the_surface() -> None:
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
