"""Maps as files: read back by rasterio and as GeoJSON, on the right side up; the command in 2D and 3D."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from matplotlib.image import imread
from shapely.geometry import shape

from datasets.command_line import run
from datasets.library import read_scene
from datasets.maps.__main__ import command, write
from datasets.maps.files import Georeference, outline
from datasets.maps.plan import maps_of
from datasets.material import Material
from datasets.particles import initial_particles
from datasets.scene import Baffle, Domain, Mass, Scene, Solid
from datasets.trajectory import Trajectory

ALPS = Georeference(east=500_000.0, north=5_200_000.0, crs="EPSG:25832")


@pytest.fixture
def flow() -> Trajectory:
    """A block at small x and large z that slides along x, past a baffle, on a terrain that falls along x."""
    scene = Scene(
        domain=Domain(size=(1.0, 0.6, 0.5), cell=0.05),
        material=Material(friction_deg=30.0),
        masses=(Mass(lower=(0.1, 0.3, 0.35), size=(0.2, 0.1, 0.1)),),
        baffles=(Baffle(lower=(0.7, 0.0, 0.05), size=(0.1, 0.3, 0.1)),),
        solids=(Solid(kind="terrain", origin=(0.0, 0.0), spacing=(1.0, 0.5), heights=((0.25, 0.2), (0.1, 0.05))),),
        duration=0.4,
        frame_dt=0.1,
        jitter=0.0,
    )
    start = initial_particles(scene)
    shift = np.arange(5)[:, None, None] * np.array([0.1, -0.02, 0.0])
    return Trajectory(
        positions=(start.positions + shift).astype(np.float32),
        time=np.arange(5) * 0.1,
        velocity0=np.tile(np.float32([1.0, -0.2, 0.0]), (len(start.positions), 1)),
        friction=start.friction,
        scene=scene,
    )


def band(path: Path) -> tuple[np.ndarray, Any]:
    with rasterio.open(path) as raster:
        return raster.read(1), raster.profile


def test_an_outline_is_a_disc_with_a_hole() -> None:
    """In anticlockwise and clockwise rings, closed, whose area is that of the disc to second order."""
    cell, georeference = 0.01, Georeference(east=1000.0, north=2000.0)
    x, z = np.meshgrid(*[(np.arange(100) + 0.5) * cell] * 2, indexing="ij")
    distance = np.hypot(x - 0.5, z - 0.4)
    values = np.maximum(0.0, np.minimum(0.3 - distance, distance - 0.05))
    (polygon,) = outline(values, cell, georeference, 0.05).geoms
    assert polygon.area == pytest.approx(np.pi * (0.25**2 - 0.1**2), rel=2e-3)
    assert polygon.is_valid
    assert polygon.exterior.is_ccw
    assert [ring.is_ccw for ring in polygon.interiors] == [False]
    assert (polygon.centroid.x, polygon.centroid.y) == pytest.approx((1000.5, 2000.4), abs=1e-3)


def test_the_files_of_a_flow(tmp_path: Path, flow: Trajectory) -> None:
    maps = maps_of(flow, 0.05, threshold=0.02)
    write(flow, maps, tmp_path, ALPS)
    names = {f"{name}.{kind}" for name in ("thickness", "depth", "velocity") for kind in ("tif", "png")}
    assert {path.name for path in tmp_path.iterdir()} == names | {"outline.geojson", "maps.json"}
    said = json.loads((tmp_path / "maps.json").read_text())
    assert said["volume"] == pytest.approx(0.2 * 0.1 * 0.1, rel=1e-9)
    assert (said["east"], said["north"], said["crs"]) == (500_000.0, 5_200_000.0, "EPSG:25832")
    assert (said["time"], said["cell"], said["threshold"], said["left"]) == (0.4, 0.05, 0.02, 0.0)
    # The block of 0.2 by 0.1 m, its edge spread over two spacings; it slid by 0.4 m to 0.7 m.
    assert said["area_release"] == pytest.approx(0.2 * 0.1, rel=0.7)
    assert said["area_deposit"] == pytest.approx(said["area_release"], rel=0.05)
    assert said["area_covered"] > 2.5 * said["area_deposit"]
    assert said["extent"] == pytest.approx(0.7, abs=0.05)
    assert said["thickness_max"] == pytest.approx(0.1, rel=0.25)
    assert said["velocity_max"] == pytest.approx(np.hypot(1.0, 0.2), rel=1e-3)
    velocity, _ = band(tmp_path / "velocity.tif")
    depth, _ = band(tmp_path / "depth.tif")
    np.testing.assert_allclose(velocity[depth > 0.03], np.hypot(1.0, 0.2), rtol=1e-3)
    thickness, profile = band(tmp_path / "thickness.tif")
    np.testing.assert_allclose(thickness[::-1].T, maps.thickness, rtol=1e-6, atol=1e-9)
    assert (profile["transform"].c, profile["transform"].f) == (500_000.0, 5_200_000.5)
    assert (profile["transform"].a, profile["transform"].e) == (0.05, -0.05)
    assert profile["crs"].to_epsg() == 25832
    # What lies at large z lies in the north, in the first rows; at the end the block is between x = 0.5 and 0.7.
    rows, columns = np.nonzero(thickness > 0.05)
    assert rows.max() < 4
    assert (columns.min(), columns.max()) == pytest.approx((10, 13), abs=1)
    outlines = json.loads((tmp_path / "outline.geojson").read_text())["features"]
    assert [feature["properties"]["name"] for feature in outlines] == ["deposit", "covered", "release"]


def test_maps_lie_where_the_raster_of_the_terrain_lies(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A slope that falls to the east, surveyed in UTM; the box begins 10 m east and 5 m north of its corner."""
    elevation = np.tile(20.0 - 0.5 * (np.arange(60) + 0.5), (40, 1))
    profile = {
        "driver": "GTiff",
        "width": 60,
        "height": 40,
        "count": 1,
        "dtype": "float64",
        "crs": "EPSG:25832",
        "transform": rasterio.Affine(1.0, 0.0, 690_000.0, 0.0, -1.0, 5_300_040.0),
    }
    with rasterio.open(tmp_path / "dem.tif", "w", **profile) as raster:
        raster.write(elevation, 1)
    (tmp_path / "slope.toml").write_text(
        "duration = 0.1\nframe_dt = 0.1\n[domain]\nsize = [20.0, 30.0, 30.0]\ncell = 1.0\n"
        "[material]\nfriction_deg = 30.0\n"
        '[[solids]]\nkind = "terrain"\nfile = "dem.tif"\nat = [-10.0, -5.0]\n'
        "[[masses]]\nlower = [2.0, 18.0, 22.0]\nsize = [4.0, 2.0, 6.0]\n"
    )
    scene = read_scene(str(tmp_path / "slope.toml"))
    start = initial_particles(scene)
    flow = Trajectory(
        positions=start.positions[None].astype(np.float32),
        time=np.zeros(1),
        velocity0=start.velocities.astype(np.float32),
        friction=start.friction,
        scene=scene,
    )
    flow.save(tmp_path / "trajectory.npz")
    assert run(command, "maps", [str(tmp_path / "trajectory.npz"), "--out", str(tmp_path)]) == 0
    with rasterio.open(tmp_path / "thickness.tif") as raster:
        assert raster.crs.to_epsg() == 25832
        assert raster.bounds == pytest.approx((690_010.0, 5_300_005.0, 690_030.0, 5_300_035.0))
        ((west, south, east, north),) = [shape(each["geometry"]).bounds for each in deposits(tmp_path)]
    assert (west, east) == pytest.approx((690_012.0, 690_016.0), abs=1.0)
    assert (south, north) == pytest.approx((5_300_027.0, 5_300_033.0), abs=1.0)
    maps = maps_of(flow, 1.0)
    # Half a metre of fall for every metre; the raster's own values at the middles of its cells.
    np.testing.assert_allclose(maps.ground, np.tile(elevation[0, 10:30], (30, 1)).T, atol=1e-9)


def deposits(folder: Path) -> list[Any]:
    features = json.loads((folder / "outline.geojson").read_text())["features"]
    return [feature for feature in features if feature["properties"]["name"] == "deposit"]


def test_a_profile(tmp_path: Path, flow: Trajectory) -> None:
    scene = dataclasses.replace(
        flow.scene,
        domain=Domain(size=(1.0, 0.6), cell=0.05),
        masses=(Mass(lower=(0.1, 0.0), size=(0.2, 0.1), velocity=(1.0, 0.0)),),
        baffles=(),
        solids=(),
    )
    start = initial_particles(scene)
    flow = dataclasses.replace(
        flow,
        positions=(start.positions + np.arange(5)[:, None, None] * [0.1, 0.0]).astype(np.float32),
        velocity0=start.velocities.astype(np.float32),
        friction=start.friction,
        scene=scene,
    )
    flow.save(tmp_path / "trajectory.npz")
    assert run(command, "maps", [str(tmp_path / "trajectory.npz"), "--out", str(tmp_path)]) == 0
    rows = np.genfromtxt(tmp_path / "profile.csv", delimiter=",", names=True)
    assert rows.dtype.names == ("x", "height", "surface", "ground", "largest_depth", "largest_velocity")
    np.testing.assert_allclose(rows["x"], np.arange(21) * 0.05, atol=1e-9)
    assert np.trapezoid(rows["height"], rows["x"]) == pytest.approx(0.2 * 0.1, rel=1e-6)
    np.testing.assert_array_equal(rows["surface"], rows["height"])
    assert rows["largest_depth"].max() == pytest.approx(0.1, rel=1e-4)
    np.testing.assert_allclose(rows["largest_velocity"][rows["largest_depth"] > 0.09], 1.0, rtol=1e-3)
    said = json.loads((tmp_path / "maps.json").read_text())
    assert said["volume"] == pytest.approx(0.02)
    assert said["extent"] == pytest.approx(0.7, abs=0.05)
    assert imread(tmp_path / "profile.png").shape[0] > 300


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--cell", "0"], "--cell: expected a length from 0.025 m, the spacing of the particles, to 0.5 m"),
        (["--threshold", "-1"], "--threshold: expected a thickness above 0 m"),
    ],
)
def test_mistakes_are_one_line(
    tmp_path: Path, flow: Trajectory, capsys: pytest.CaptureFixture[str], flags: list[str], said: str
) -> None:
    flow.save(tmp_path / "trajectory.npz")
    assert run(command, "maps", [str(tmp_path / "trajectory.npz"), "--out", str(tmp_path / "out"), *flags]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
