"""Thickness in plan: layers of known thickness on planes, whatever the raster and its place on the map."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from datasets import Domain, Mass, Scene, Solid, Trajectory
from datasets.exchange.rasters import write_raster
from inverse.observations import ThicknessSettings
from tests.refusals import refused
from tests.scenes import flow_of, scene_of

PLANE = Solid(kind="terrain", origin=(-1.0, -1.0), spacing=(6.0, 6.0), heights=((3.0, 3.0), (0.0, 0.0)), friction=0.4)
"""Falls by half along x: from 2.5 m over the corner of the box."""
NORMAL = 1.0 / np.sqrt(1.25)
CORNER = (2_600_000.0, 1_200_000.0)


def scene(*solids: Solid, origin: bool = False, **changes: object) -> Scene:
    made = scene_of(Mass(lower=(1.0, 2.6, 1.0), size=(1.0, 0.2, 1.0)), size=(4.0, 4.0, 4.0), cell=0.2, solids=solids)
    place = (CORNER[0], 1300.0, CORNER[1]) if origin else None
    return dataclasses.replace(made, domain=Domain(size=(4.0, 4.0, 4.0), cell=0.2, origin=place), **changes)


def layer(scene: Scene) -> Trajectory:
    """0.1 m thick along y at x and z from 0.8 to 2.4 m."""
    x, z = np.meshgrid(*(np.arange(0.825, 2.4, 0.05),) * 2, indexing="ij")
    points = np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1)
    return dataclasses.replace(flow_of(scene, points[None]), volume=np.full(len(points), 0.05**2 * 0.1, np.float32))


@pytest.mark.parametrize(
    ("made", "factors"),
    [(scene(), (1.0, 1.0)), (scene(PLANE), (NORMAL, 1.0)), (scene(slope_deg=30.0), (1.0, 1.0 / np.cos(np.pi / 6.0)))],
    ids=["level", "plane", "tilted"],
)
def test_a_layer_is_as_thick_as_it_is_normal_to_the_ground_or_along_gravity(
    made: Scene, factors: tuple[float, float]
) -> None:
    for direction, factor in zip(("normal", "vertical"), factors, strict=True):
        thickness = ThicknessSettings(direction=direction, cell=0.2).operator(made)
        shown = thickness.observe(layer(made)).reshape(thickness.grid.nodes)
        # Inside the layer, a cell from its edge: exact, as all around it.
        np.testing.assert_allclose(shown[5:11, 5:11], 0.1 * factor, rtol=1e-6)
        assert not shown[14:].any()


def test_the_volume_is_the_particles_and_its_slope_is_exact() -> None:
    made = scene()
    thickness, run = ThicknessSettings(cell=0.4).operator(made), layer(made)
    shown = thickness.observe(run)
    assert shown.sum() * 0.4**2 == pytest.approx(run.volumes.sum(), rel=1e-12)
    points = torch.from_numpy(run.positions[0]).double().requires_grad_(True)
    weights = torch.linspace(0.0, 1.0, len(shown), dtype=torch.float64)
    found = thickness.smooth(points, torch.from_numpy(run.volumes)) @ weights
    (slope,) = torch.autograd.grad(found, points)
    step = torch.zeros_like(points)
    step[100, 0] = 1e-6
    ahead, behind = (thickness.smooth(points + s * step, torch.from_numpy(run.volumes)) @ weights for s in (1.0, -1.0))
    assert float(slope[100, 0]) == pytest.approx(float((ahead - behind).detach()) / 2e-6, rel=1e-5)


def test_the_peak_is_the_largest_of_all_frames() -> None:
    made = scene()
    run = dataclasses.replace(layer(made), positions=layer(made).positions[[0, 0, 0]], time=np.arange(3.0))
    run.positions[0, :, 0] += 1.6
    run.positions[2, :, 1] = 0.5
    peak = ThicknessSettings(cell=0.2, peak=True).operator(made)
    assert peak.over_time
    shown = peak.observe(run).reshape(peak.grid.nodes)
    np.testing.assert_allclose(shown[5:11, 5:11], 0.1, rtol=1e-6)
    np.testing.assert_allclose(shown[13:19, 5:11], 0.1, rtol=1e-6)


@pytest.mark.parametrize("cell", [0.05, 0.2, 0.4])
def test_a_raster_on_the_map_is_the_target_that_its_flow_makes(cell: float, tmp_path: Path) -> None:
    """Of 0.1 m on the same square, cells from a quarter of the grid's to twice: all numbers of the layer are it."""
    made = scene(origin=True)
    count = round(4.0 / cell)
    middles = cell * (np.arange(count) + 0.5)
    inside = (middles > 0.8) & (middles < 2.4)
    write_raster(tmp_path / "h.tif", 0.1 * np.outer(inside, inside), cell, CORNER, "EPSG:2056", "thickness", "m")
    target = ThicknessSettings(file="h.tif", noise="10%", length=0.5).read(made, tmp_path, 0.04)
    shown = target.observation.observe(layer(made))
    grid = target.observation.grid
    assert min(grid.spacing) == pytest.approx(max(cell, 0.2))
    places = grid.positions[target.observation.cells]
    core = ((places > 0.8 + 0.21) & (places < 2.4 - 0.21)).all(axis=1)
    np.testing.assert_allclose(target.values[core], 0.1, rtol=1e-6)
    np.testing.assert_allclose(shown[core], 0.1, rtol=1e-6)
    assert abs(shown - target.values).max() < 0.06  # half a cell on either side of the edge is shared
    # Correlated in space, by the distance between two cells; far bare ground does not count.
    one, other = np.flatnonzero(core)[[0, 1]]
    apart = np.linalg.norm(places[one] - places[other])
    correlation = target.errors.matrix[one, other] / (target.deviation[one] * target.deviation[other])
    assert correlation == pytest.approx(np.exp(-apart / 0.5))
    assert target.deviation[core] == pytest.approx(0.01)
    assert places.max() < 2.4 + 0.25 * 1.6 + 2.0 * grid.spacing[0]


def test_what_is_no_raster_of_this_flow_is_refused(tmp_path: Path) -> None:
    made, heap = scene(origin=True), np.full((20, 20), 10.0)
    write_raster(tmp_path / "cm.tif", heap, 0.2, CORNER, "EPSG:2056", "thickness", "m")
    write_raster(tmp_path / "far.tif", heap, 0.2, (0.0, 0.0), "EPSG:2056", "thickness", "m")
    refused(ThicknessSettings(file="cm.tif").read, made, tmp_path, 0.04, said="cm.tif: expected a volume of at most")
    refused(ThicknessSettings(file="far.tif").read, made, tmp_path, 0.04, said="far.tif: expected cells between 0 and")
    refused(lambda: ThicknessSettings(cell=-1.0), said="a length above 0")
