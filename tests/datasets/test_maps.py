"""Maps in plan against exact shapes, what moves, what lies beneath; as files on the right side up; the command."""

import dataclasses
import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import rasterio
from shapely.geometry import shape

from datasets import Baffle, Mass, Scene, Solid, Trajectory
from datasets.command_line import run
from datasets.maps import KINDS, command, maps_of, region_above, write
from datasets.scene.grid_field import Grid
from datasets.scene.particles import initial_particles
from tests import scenes
from tests.refusals import refused_by
from tests.scenes import flow_of


def scene_of(size: tuple[float, ...], *masses: Mass | tuple[tuple[float, ...], ...], **changes: Any) -> Scene:
    """Masses, or boxes of sand (lower corner, size), in a box."""
    bodies = (mass if isinstance(mass, Mass) else Mass(lower=mass[0], size=mass[1]) for mass in masses)
    return scenes.scene_of(*bodies, size=size, **{"cell": 0.05, "frame_dt": 0.1, "jitter": 0.0} | changes)


def lying(scene: Scene) -> Trajectory:
    """The particles of a scene where they begin."""
    return flow_of(scene, [initial_particles(scene).positions])


def sliding(scene: Scene) -> Trajectory:
    """All of a scene slides along x, by 0.1 m in each of four frames."""
    start, step = initial_particles(scene).positions, np.eye(scene.dimension)[0] * 0.1
    velocity0 = np.tile(10.0 * step, (len(start), 1)).astype(np.float32)
    return flow_of(scene, [start + number * step for number in range(5)], velocity0=velocity0)


@pytest.mark.parametrize("cell", [0.026, 0.17, 0.5])
def test_volume_is_that_of_the_particles(cell: float) -> None:
    """Wherever they are, in corners and on walls too, in masses of different particles; in the parts of a grid."""
    size = (1.0, 0.5, 0.6)
    scene = scene_of(size, ((0.0, 0.0, 0.0), (0.21, 0.13, 0.3)), ((0.5, 0.0, 0.1), (0.3, 0.1, 0.2)))
    start = initial_particles(scene)
    coordinates = np.random.default_rng(1).random(start.positions.shape) * size
    coordinates[:8] = np.array(np.meshgrid(*[(0.0, length) for length in size])).reshape(3, -1).T
    flow = flow_of(scene, [start.positions, coordinates])
    maps = maps_of(flow, cell)
    parts = maps.grid.weights(flow.positions[-1, :, ::2].astype(np.float64)).T @ start.volume
    np.testing.assert_allclose(maps.thickness.ravel() * cell**2, parts, rtol=1e-12, atol=1e-12)
    assert maps.thickness.sum() * cell**2 == pytest.approx(start.volume.sum(), rel=1e-12)
    assert (maps.volume, maps.left) == (pytest.approx(start.volume.sum(), rel=1e-12), 0.0)
    assert np.all(maps.depth >= np.maximum(maps.start, maps.thickness) * (1.0 - 1e-12))


def test_velocity_is_the_mean_over_the_depth_and_the_largest_over_time() -> None:
    scene = scene_of((1.0, 0.5, 0.4), ((0.2, 0.0, 0.1), (0.2, 0.1, 0.2)))
    start = initial_particles(scene).positions
    lower = start[:, 1] < 0.05
    # The upper half slides at 2 m/s, the lower one at 1 m/s; then all stops.
    speeds = np.where(lower, 1.0, 2.0)[:, None] * [1.0, 0.0, 0.0]
    velocities = np.array([speeds, speeds, np.zeros_like(speeds)], np.float32)
    maps = maps_of(flow_of(scene, [start] * 3, velocities=velocities), 0.05)
    inside = maps.thickness > 0.099
    assert inside.sum() == 4
    np.testing.assert_allclose(maps.velocity[inside], 1.5, rtol=1e-6)
    np.testing.assert_array_equal(maps.velocity[maps.depth <= maps.threshold], 0.0)
    assert maps.threshold == pytest.approx(0.025)


def test_arrival_and_depth_do_not_depend_on_how_often_a_flow_was_kept() -> None:
    """A block of 0.4 m slides at 2 m/s, kept every 0.3 s: one and a half of its lengths apart."""
    scene = scene_of((2.0, 0.5, 0.4), ((0.1, 0.0, 0.0), (0.4, 0.1, 0.4)))
    start, velocity = initial_particles(scene).positions, np.array([2.0, 0.0, 0.0])
    frames = [start + 0.3 * number * velocity for number in range(3)]
    velocities = np.tile(velocity.astype(np.float32), (3, len(start), 1))
    maps = maps_of(flow_of(scene, frames, time=0.3 * np.arange(3.0), velocities=velocities), 0.1)
    x = maps.grid.axes[0]
    middle, passed = maps.grid.nodes[1] // 2, (x > 0.5) & (x < 1.6)
    np.testing.assert_allclose(maps.depth[passed, middle], 0.1, rtol=0.02)
    np.testing.assert_allclose(maps.velocity[passed, middle], 2.0, rtol=1e-5)
    # The front, at 0.5 m, moves at 2 m/s; a moment is 0.3 s / 8, and a cell 0.05 s long.
    np.testing.assert_allclose(maps.arrival[passed, middle], (x[passed] - 0.5) / 2.0, atol=0.06)
    assert np.all(np.diff(maps.arrival[passed, middle]) > 0.0)
    assert np.all(maps.arrival[(x > 0.1) & (x < 0.5), middle] == 0.0)
    assert np.isnan(maps.arrival[x > 1.8]).all()


def test_depth_normal_to_the_bed_is_the_vertical_one_times_the_cosine() -> None:
    """On a slope of 45 degrees along x; a wall that stands on it is no slope."""
    slope = Solid(kind="terrain", origin=(0.0, 0.0), spacing=(1.0, 0.5), heights=((1.0, 1.0), (0.0, 0.0)))
    layer = Mass(kind="layer", thickness=0.1, outline=((0.2, 0.0), (0.6, 0.0), (0.6, 0.5), (0.2, 0.5)))
    wall = Baffle(lower=(0.8, 0.0, 0.0), size=(0.1, 1.2, 0.2))
    maps = maps_of(lying(scene_of((1.0, 1.5, 0.5), layer, solids=(slope,), baffles=(wall,))), 0.05)
    inside = maps.depth > 0.09
    assert inside.sum() >= 50
    np.testing.assert_allclose(maps.normal_depth[inside], maps.depth[inside] / np.sqrt(2.0), rtol=1e-5)


def test_the_ground_of_terrain_and_baffles() -> None:
    terrain = Solid(kind="terrain", origin=(0.0, 0.0), spacing=(1.0, 0.5), heights=((0.3, 0.3), (0.1, 0.1)))
    baffle = Baffle(lower=(0.6, 0.0, 0.0), size=(0.11, 0.4, 0.2))
    box = (0.2, 0.5, 0.1), (0.2, 0.1, 0.2)
    maps = maps_of(lying(scene_of((1.0, 0.8, 0.5), box, solids=(terrain,), baffles=(baffle,))), 0.05)
    x, z = np.meshgrid(*maps.grid.axes, indexing="ij")
    on = (x > 0.59) & (x < 0.71) & (z < 0.2)
    np.testing.assert_allclose(maps.ground, np.where(on, 0.4, 0.3 - 0.2 * x), atol=1e-6)


def test_an_outline_is_a_disc_with_a_hole() -> None:
    """In anticlockwise and clockwise rings, closed, whose area is that of the disc to second order."""
    grid = Grid((0.005, 0.005), (0.01, 0.01), (100, 100))
    x, z = np.meshgrid(*grid.axes, indexing="ij")
    distance = np.hypot(x - 0.5, z - 0.4)
    values = np.maximum(0.0, np.minimum(0.3 - distance, distance - 0.05))
    (polygon,) = region_above(grid, values, 0.05, (1000.0, 2000.0)).geoms
    assert polygon.area == pytest.approx(np.pi * (0.25**2 - 0.1**2), rel=2e-3)
    assert polygon.is_valid
    assert polygon.exterior.is_ccw
    assert [ring.is_ccw for ring in polygon.interiors] == [False]
    assert (polygon.centroid.x, polygon.centroid.y) == pytest.approx((1000.5, 2000.4), abs=1e-3)


def test_the_files_of_a_flow(tmp_path: Path) -> None:
    """A block at small x and large z that slides to x = 0.7."""
    flow = sliding(scene_of((1.0, 0.6, 0.5), ((0.1, 0.3, 0.35), (0.2, 0.1, 0.1))))
    maps = dataclasses.replace(maps_of(flow, 0.05, threshold=0.02), corner=(500_000.0, 5_200_000.0), crs="EPSG:25832")
    write(flow, maps, tmp_path, (0.02, 0.06))
    names = {f"{kind}.{end}" for kind in KINDS for end in ("tif", "qml")} | {"maps.png", "outline.geojson", "maps.json"}
    assert {path.name for path in tmp_path.iterdir()} == names
    colours = ElementTree.parse(tmp_path / "velocity.qml").iter("item")
    assert [float(item.attrib["value"]) for item in colours] == pytest.approx(np.linspace(0.0, 1.0, 9), rel=1e-3)
    said = json.loads((tmp_path / "maps.json").read_text())
    assert said["volume"] == pytest.approx(0.2 * 0.1 * 0.1, rel=1e-9)
    assert (said["east"], said["north"], said["crs"]) == (500_000.0, 5_200_000.0, "EPSG:25832")
    assert (said["time"], said["cell"], said["threshold"], said["left"]) == (pytest.approx(0.4), 0.05, 0.02, 0.0)
    assert said["area_deposit"] == pytest.approx(said["area_release"], rel=0.05)
    assert said["area_covered"] > 2.5 * said["area_deposit"]
    assert said["extent"] == pytest.approx(0.7, abs=0.05)
    assert (said["thickness_max"], said["velocity_max"]) == (pytest.approx(0.1, rel=0.25), pytest.approx(1.0, rel=1e-3))
    with rasterio.open(tmp_path / "thickness.tif") as raster:
        thickness, transform = raster.read(1), raster.transform
        assert (raster.crs.to_epsg(), raster.units[0]) == (25832, "m")
    np.testing.assert_allclose(thickness[::-1].T, maps.thickness, rtol=1e-6, atol=1e-9)
    assert (transform.c, transform.f, transform.a, transform.e) == (500_000.0, 5_200_000.5, 0.05, -0.05)
    # What lies at large z lies in the north, in the first rows.
    rows, columns = np.nonzero(thickness > 0.05)
    assert rows.max() < 4
    assert (columns.min(), columns.max()) == pytest.approx((10, 13), abs=1)
    outlines = json.loads((tmp_path / "outline.geojson").read_text())["features"]
    contours = [tuple(feature["properties"].values())[:2] for feature in outlines]
    assert contours == [(name, level) for name in ("deposit", "covered", "release") for level in (0.02, 0.06)]


def test_maps_lie_where_the_raster_of_the_terrain_lies(tmp_path: Path) -> None:
    """A slope that falls to the east; the box begins 10 m east and 5 m north of the corner of its UTM zone's raster."""
    grid = {"origin": (0.0, 0.0), "spacing": (20.0, 30.0), "heights": ((15.0, 15.0), (5.0, 5.0))}
    slope = Solid(kind="terrain", **grid, corner=(690_010.0, 5_300_005.0), crs="EPSG:25832")
    scene = scene_of((20.0, 30.0, 30.0), ((2.0, 18.0, 22.0), (4.0, 2.0, 6.0)), cell=1.0, solids=(slope,))
    lying(scene).save(tmp_path / "trajectory.npz")
    assert run(command, "maps", [str(tmp_path / "trajectory.npz"), "--out", str(tmp_path)]) == 0
    with rasterio.open(tmp_path / "thickness.tif") as raster:
        assert raster.crs.to_epsg() == 25832
        assert raster.bounds == pytest.approx((690_010.0, 5_300_005.0, 690_030.0, 5_300_035.0))
    deposit, *_ = json.loads((tmp_path / "outline.geojson").read_text())["features"]
    corners = (690_012.0, 5_300_027.0, 690_016.0, 5_300_033.0)
    assert shape(deposit["geometry"]).bounds == pytest.approx(corners, abs=1.0)


@pytest.mark.parametrize(("thickness", "threshold"), [(0.02, 0.01), (((0.1, 0.02), (0.0, 0.1)), 0.01), (0.2, 0.025)])
def test_the_threshold_is_at_most_half_of_the_thinnest_layer(thickness: object, threshold: float) -> None:
    """A layer of less than a spacing of particles has maps; beside it stands a thick mass."""
    extra = {"origin": (0.4, 0.2), "spacing": (0.2, 0.2)} if isinstance(thickness, tuple) else {}
    layer = Mass(kind="layer", thickness=thickness, outline=((0.3, 0.1), (0.7, 0.1), (0.7, 0.5), (0.3, 0.5)), **extra)
    maps = maps_of(lying(scene_of((1.0, 0.5, 0.6), layer, ((0.8, 0.0, 0.1), (0.1, 0.3, 0.1)))), 0.05)
    assert maps.threshold == pytest.approx(threshold, rel=0.02)
    assert region_above(maps.grid, maps.thickness, threshold).bounds[0] == pytest.approx(0.3, abs=0.05)


def test_what_has_no_map_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    box = (1.0, 0.6, 0.4)
    for dimension, flags, words in (
        (2, [], "trajectory.npz: expected a trajectory in 3D, a flow in 2D has no plan"),
        (3, ["--cell", "0"], "--cell: expected a length from 0.025 m, the spacing of the particles, to 0.4 m"),
        (3, ["--threshold", "-1"], "--threshold: expected thicknesses above 0 m"),
    ):
        sand = (0.1, 0.0, 0.0)[:dimension], (0.2, 0.1, 0.2)[:dimension]
        sliding(scene_of(box[:dimension], sand)).save(tmp_path / "trajectory.npz")
        assert words in refused_by(capsys, command, tmp_path / "trajectory.npz", "--out", tmp_path, *flags)
