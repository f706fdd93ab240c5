"""Scenes in map coordinates: the same scene as in coordinates of its own, and what is written lies on the map."""

import dataclasses
import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import pyvista
import rasterio
import tomli_w

from datasets import Scene, Trajectory, read_scene, write_scene
from datasets.compare import compare
from datasets.exchange.page import write_view
from datasets.exchange.vtk import write_vtk
from datasets.maps import maps_of, write
from datasets.scene.particles import initial_particles, mass_volumes
from tests.datasets.exchange.test_scene_files import scene as read
from tests.datasets.exchange.test_scene_files import write_raster
from tests.refusals import refused
from tests.scenes import flow_of

PLACE = (2_600_000.0, 2_000.0, 1_200_000.0)
"""Easting, elevation and northing of the box, as in the middle of Switzerland."""


def in_space(east: float, up: float, north: float) -> str:
    """A scene whose every place is moved by these."""

    def at(x: float, y: float, z: float) -> list[float]:
        return [east + x, up + y, north + z]

    def on(x: float, z: float) -> list[float]:
        return [east + x, north + z]

    box, plan = [4.0, 3.0, 2.0], [on(1.0, 0.4), on(1.7, 0.4), on(1.7, 0.9)]
    layer = {"kind": "layer", "thickness": [[0.2, 0.3], [0.3, 0.2]], "origin": on(1.1, 0.5), "spacing": [0.3, 0.3]}
    field = {"quantity": "velocity_x", "nodes": [2, 2, 2], "values": [1.0] * 4 + [2.0] * 4}
    heights = [[up + 1.1] * 2, [up + 0.3] * 2]
    corners = [at(2.1, 1.1, 0.3), at(2.5, 1.1, 0.3), at(2.1, 1.5, 0.3), at(2.1, 1.1, 0.7)]
    table = {
        "duration": 0.1,
        "domain": {"size": box, "cell": 0.1} | ({"origin": at(0.0, 0.0, 0.0)} if east else {}),
        "material": {"friction_deg": 30.0},
        "masses": [{"lower": at(0.1, 1.3, 0.4), "size": [0.3, 0.2, 0.7]}, {**layer, "outline": plan}],
        "fields": [{**field, "origin": at(0.0, 0.0, 0.0), "spacing": box}],
        "stages": [{"time": 0.05, "lower": at(0.0, 0.0, 0.7), "size": [4.0, 3.0, 1.0], "friction_deg": 20.0}],
        "baffles": [{"lower": at(3.1, 0.1, 0.2), "size": [0.1, 1.0, 0.5]}],
        "solids": [
            {"kind": "terrain", "origin": on(0.0, 0.0), "spacing": [4.0, 2.0], "heights": heights},
            {"kind": "mesh", "vertices": corners, "triangles": [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]},
        ],
    }
    return tomli_w.dumps(table)


def on_map(scene: Scene, crs: str | None = None) -> Scene:
    """A scene with its box at the place."""
    origin = PLACE[: scene.dimension]
    return dataclasses.replace(scene, domain=dataclasses.replace(scene.domain, origin=origin, crs=crs))


def test_a_scene_in_map_coordinates_is_the_scene(tmp_path: Path) -> None:
    """To the last bit of every length, and so of every particle; on the way back as well."""
    local, placed = read(tmp_path, in_space(0.0, 0.0, 0.0)), read(tmp_path, in_space(*PLACE))
    assert placed == on_map(local)
    np.testing.assert_array_equal(initial_particles(placed).positions, initial_particles(local).positions)
    write_scene(placed, tmp_path / "written.toml")
    assert read_scene(tmp_path / "written.toml") == placed == Scene.from_json(placed.to_json())
    assert "2600003.1" in (tmp_path / "written.toml").read_text()


def test_a_scene_in_2d_and_its_csv(tmp_path: Path) -> None:
    scenes = []
    for east, up in ((0.0, 0.0), PLACE[:2]):
        line = "\n".join(f"{x + east},{y + up}" for x, y in ((0.0, 1.5), (2.0, 0.7), (4.0, 0.7)))
        (tmp_path / "line.csv").write_text(f"x,y\n{line}\n")
        vertices = [[east + x, up + y] for x, y in ((1.2, 1.7), (1.6, 1.7), (1.4, 1.9))]
        layer = {"kind": "layer", "thickness": 0.3, "outline": [[east + 0.3], [east + 1.1]]}
        table = {
            "duration": 0.1,
            "domain": {"size": [4.0, 3.0], "cell": 0.1} | ({"origin": [east, up]} if east else {}),
            "material": {"friction_deg": 30.0},
            "masses": [layer, {"kind": "polygon", "vertices": vertices}],
            "solids": [{"kind": "terrain", "file": "line.csv"}],
        }
        scenes.append(read(tmp_path, tomli_w.dumps(table)))
    assert scenes[1] == on_map(scenes[0])
    write_scene(scenes[1], tmp_path / "written.toml")
    assert read_scene(tmp_path / "written.toml") == scenes[1]


RASTERS = """\
duration = 0.1
[domain]
size = [4.0, 3.0, 2.0]
cell = 0.1
origin = [2600000.0, 2000.0, 1200000.0]
[material]
friction_deg = 30.0
[[masses]]
kind = "layer"
thickness = "release.tif"
[[solids]]
kind = "terrain"
file = "dem.asc"
"""


def test_rasters_lie_where_they_say(tmp_path: Path) -> None:
    """A slope of 0.1 (x - 2,600,000) + 2,000.7; the release, 1 m east and 0.5 m north, stands before it in the file."""
    east, up, north = PLACE
    x = east - 1.0 + 0.5 * (np.arange(12) + 0.5)
    slope = np.tile(up + 0.7 + 0.1 * (x - east), (8, 1))
    write_raster(tmp_path / "dem.asc", slope, "EPSG:2056", 0.5, (east - 1.0, north - 1.0))
    write_raster(tmp_path / "release.tif", np.full((2, 3), 0.2), "EPSG:2056", 0.5, (east + 1.0, north + 0.5))
    scene = read(tmp_path, RASTERS)
    assert (scene.domain.origin, scene.domain.crs, scene.solids[0].corner) == (PLACE, "EPSG:2056", None)
    assert mass_volumes(scene)[0] == pytest.approx(6 * 0.25 * 0.2, rel=1e-9)
    assert scene.masses[0].lower[::2] == pytest.approx((1.0, 0.5), abs=1e-9)
    assert scene.masses[0].lower[1] == pytest.approx(0.8, abs=0.01)
    write_scene(scene, tmp_path / "written.toml")
    assert read_scene(tmp_path / "written.toml") == scene
    placed = read(tmp_path, RASTERS.replace('"release.tif"', f'"release.tif"\nat = [{east + 2.0}, {north}]'))
    assert placed.masses[0].lower[::2] == pytest.approx((2.0, 0.0), abs=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (", 1200000.0]\n", "]\n", "domain.origin: expected 3 lengths"),
        ("origin = [2600000.0, 2000.0, 1200000.0]", "origin = [1e300, 0.0, 0.0]", "domain.origin: expected 3 lengths"),
        ("origin = [2600000.0, 2000.0, 1200000.0]", "origin = [nan, 0.0, 0.0]", "domain.origin[0]: expected"),
        ("origin = [2600000.0, 2000.0, 1200000.0]", 'origin = "here"', "domain.origin: expected"),
        ("1200000.0]\n", '1200000.0]\ncrs = "Bern"\n', "domain.crs: expected a projected coordinate system"),
        ("1200000.0]\n", '1200000.0]\ncrs = "EPSG:25832"\n', "expected the reference system of domain.crs, EPSG:25832"),
        ("origin = [2600000.0, 2000.0, 1200000.0]", 'crs = "EPSG:2056"', "domain.crs: expected an origin beside it"),
        ("[2600000.0, 2000.0", "[2700000.0, 2000.0", "masses[0]: expected a layer that lies in the box"),
        ('"dem.asc"\n', '"dem.asc"\ncorner = [0.0, 0.0]\n', "solids[0].corner: expected none beside domain.origin"),
        (
            "[[solids]]",
            "[[masses]]\nlower = [2599999.0, 2001.0, 1200000.0]\nsize = [0.3, 0.2, 0.2]\n[[solids]]",
            "masses[1]: expected a box inside the domain [4.0, 3.0, 2.0], got [-1.0, 1.0, 0.0] + [0.3, 0.2, 0.2]; "
            "lengths count from domain.origin here",
        ),
    ],
)
def test_what_is_no_place_is_one_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    east, up, north = PLACE
    write_raster(tmp_path / "dem.asc", np.full((8, 12), up + 0.7), None, 0.5, (east - 1.0, north - 1.0))
    write_raster(tmp_path / "release.tif", np.full((2, 3), 0.2), "EPSG:2056", 0.5, (east + 1.0, north + 0.5))
    assert old in RASTERS
    refused(read, tmp_path, RASTERS.replace(old, new), said=said)


def test_what_is_written_lies_on_the_map(tmp_path: Path) -> None:
    """Maps, outlines and VTK of a flow that moves by 0.3 m: as in the box's own coordinates, at the place."""
    boxed = read(tmp_path, in_space(0.0, 0.0, 0.0))
    start = initial_particles(boxed).positions
    flows = {}
    for name, scene in (("own", boxed), ("map", on_map(boxed, "EPSG:2056"))):
        flow = flow_of(scene, [start, start + np.array([0.3, 0.0, 0.0])])
        flow.save(tmp_path / f"{name}.npz")
        flow, folder = Trajectory.load(tmp_path / f"{name}.npz"), tmp_path / name
        folder.mkdir()
        flows[name] = flow
        write(flow, maps_of(flow, 0.1), folder)
        write_vtk(flow, folder)
    np.testing.assert_array_equal(flows["own"].positions, flows["map"].positions)
    (east, _, north), (one, other) = PLACE, (tmp_path / "own", tmp_path / "map")
    for name in ("thickness", "depth", "velocity"):
        with rasterio.open(one / f"{name}.tif") as local, rasterio.open(other / f"{name}.tif") as placed:
            np.testing.assert_array_equal(local.read(), placed.read())
            assert placed.bounds == (east, north, east + 4.0, north + 2.0)
            assert placed.crs.to_epsg() == 2056
    rings = []
    for folder in (one, other):
        outlines = json.loads((folder / "outline.geojson").read_text())
        rings.append(np.array(outlines["features"][0]["geometry"]["coordinates"][0][0]))
    np.testing.assert_allclose(rings[1] - [east, north], rings[0], atol=1e-8)
    assert outlines["crs"]["properties"]["name"].endswith("2056")
    for name in ("particles-0001.vtp", "solids.vtp", "domain.vtp"):
        local, placed = (pyvista.read(folder / name).points for folder in (one, other))
        np.testing.assert_allclose(placed - np.array(PLACE), local, atol=1e-6)
    for refuses in (compare, partial(write_view, "view.html")):
        assert "expected a flow in a box at" in str(refused(refuses, flows["own"], flows["map"]))
