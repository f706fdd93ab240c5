"""The background grid: exact for linear fields, conserving, and its features of a column."""

import pytest
import torch

from gns.model.grid import REFERENCE_HEIGHT, column_features, stencil_of


@pytest.mark.parametrize("size", [(1.0, 0.4), (0.3, 0.2, 0.25)])
def test_gathering_is_exact_for_linear_fields_and_scattering_conserves(size: tuple[float, ...]) -> None:
    torch.manual_seed(0)
    positions = torch.rand(50, len(size), dtype=torch.float64) * torch.tensor(size, dtype=torch.float64)
    positions[0], positions[1] = 0.0, torch.tensor(size)
    points = stencil_of(positions, size, 0.05, None, 1)
    axes = [torch.arange(count, dtype=torch.float64) * 0.05 for count in points.shape]
    nodes = torch.cartesian_prod(*axes)
    slope = torch.arange(1.0, len(size) + 1.0, dtype=torch.float64)
    torch.testing.assert_close(points.gather((nodes @ slope + 2.0).unsqueeze(1))[:, 0], positions @ slope + 2.0)
    values = torch.rand(50, 3, dtype=torch.float64)
    torch.testing.assert_close(points.scatter(values).sum(0), values.sum(0))


def bed(height: float, slope: float) -> torch.Tensor:
    """Particles 0.01 m apart under the surface height + slope x, between the walls of a box of one metre."""
    lattice = torch.cartesian_prod(torch.arange(100), torch.arange(100)).double() * 0.01 + 0.005
    return lattice[lattice[:, 1] < height + slope * lattice[:, 0]]


def test_a_level_bed_is_fully_packed_and_has_the_overburden_of_what_lies_above() -> None:
    positions = bed(0.4, 0.0)
    points = stencil_of(positions, (1.0, 1.0), 0.04, None, 1)
    around = column_features(points, torch.full((len(positions),), 1e-4, dtype=torch.float64)).view(*points.shape, 4)
    packing, overburden, height, slope = around.unbind(-1)
    torch.testing.assert_close(packing[:, :9], torch.ones_like(packing[:, :9]), atol=0.02, rtol=0.0)
    expected = (0.4 - 0.04 * torch.arange(9, dtype=torch.float64)) / REFERENCE_HEIGHT
    # The node on the floor stands for the lower half of its cell, so what lies above it is a quarter cell less.
    torch.testing.assert_close(overburden[:, 1:9], expected[1:].expand(26, 8), atol=0.02, rtol=0.0)
    torch.testing.assert_close(height, torch.full_like(height, 4.0), atol=0.08, rtol=0.0)
    torch.testing.assert_close(slope, torch.zeros_like(slope), atol=0.03, rtol=0.0)


def test_the_slope_is_that_of_the_surface() -> None:
    positions = bed(0.2, 0.4)
    points = stencil_of(positions, (1.0, 1.0), 0.04, None, 1)
    volume = torch.full((len(positions),), 1e-4, dtype=torch.float64)
    slope = column_features(points, volume).view(*points.shape, 4)[2:-2, :, 3]
    torch.testing.assert_close(slope, torch.full_like(slope, 0.4), atol=0.05, rtol=0.0)


def test_samples_of_a_batch_have_grids_of_their_own() -> None:
    positions = torch.rand(20, 2)
    batch = torch.arange(20) // 10
    both = stencil_of(positions, (1.0, 1.0), 0.1, batch, 2).scatter(torch.ones(20, 1)).view(2, -1)
    for sample in (0, 1):
        alone = stencil_of(positions[batch == sample], (1.0, 1.0), 0.1, None, 1).scatter(torch.ones(10, 1)).view(-1)
        torch.testing.assert_close(both[sample], alone)
