"""A box of whole cells on the map, around the shapes of a file."""

from pathlib import Path

import numpy as np
import pytest
import shapely
import shapely.affinity
from rasterio.warp import transform

from datasets import Scene, read_scene
from tests.datasets.exchange.test_scene_files import write_raster
from tests.datasets.exchange.test_vectors import written
from tests.refusals import refused

EAST, UP, NORTH, SWISS = 2_600_000.0, 1_300.0, 1_200_000.0, "EPSG:2056"
FIELD = shapely.box(EAST + 100.0, NORTH + 80.0, EAST + 140.0, NORTH + 120.0)
SCENE = """
duration = 1.0
open_sides = ["x-", "x+", "z-", "z+"]
domain = { around = "release.gpkg", margin = 30.0, cell = 4.0 }
material = { friction_deg = 30.0 }
solids = [{ kind = "terrain", file = "dem.tif", friction = 0.4 }]

[[masses]]
kind = "layer"
thickness = 8.0
"""
OUTLINE = f"outline = {[list(place) for place in FIELD.exterior.coords[:-1]]}\n"


def made(folder: Path, shape: shapely.Geometry = FIELD, text: str = SCENE + OUTLINE, crs: str = SWISS) -> Scene:
    """The scene on 400 x 200 m that fall by one half to the east, from 1,500 m."""
    folder.mkdir(exist_ok=True)
    rows = np.tile(UP + 200.0 - 0.5 * 5.0 * (np.arange(80) + 0.5), (40, 1))
    write_raster(folder / "dem.tif", rows, SWISS, 5.0, (EAST, NORTH))
    (folder / "release.gpkg").unlink(missing_ok=True)
    written(folder / "release.gpkg", shape, crs)
    (folder / "scene.toml").write_text(text)
    return read_scene(folder / "scene.toml")


def test_a_box_around_a_polygon_is_as_high_as_its_ground(tmp_path: Path) -> None:
    """Plan 70 to 174 and 50 to 154 m; the ground falls from 1,466 to 1,411 m there, the layer is 8 m thick."""
    scene = made(tmp_path)
    domain = scene.domain
    assert domain.crs == SWISS
    assert domain.origin[::2] == (EAST + 70.0, NORTH + 50.0)
    assert domain.size[::2] == (104.0, 104.0)  # of 25 cells 26: on twice as large ones the box is the same
    assert scene.with_cell(8.0).domain.size == domain.size
    ground = np.array(scene.solids[0].heights) + domain.origin[1]
    bottom, top = domain.origin[1], domain.origin[1] + domain.size[1]
    lowest, highest = UP + 200.0 - 0.5 * 177.5, UP + 200.0 - 0.5 * 67.5
    assert ground.min() < lowest  # the raster goes on beside the box
    assert lowest - 4 * 4.0 - 1.0 <= bottom <= lowest - 4 * 4.0
    assert highest + 8.0 + 10 * 4.0 <= top <= highest + 8.0 + 10 * 4.0 + 12.0


@pytest.mark.parametrize("margin", [0.0, 0.3, 5.0])
def test_a_box_holds_its_shapes_and_the_margin(tmp_path: Path, margin: float) -> None:
    """Which were cut by up to two cells and a metre where these do not fit."""
    corners = np.array([[100.4, 80.3], [130.7, 118.6]]) + np.array([EAST, NORTH])
    text = SCENE.replace("margin = 30.0", f"margin = {margin}") + OUTLINE
    domain = made(tmp_path, shapely.box(*corners.ravel()), text).domain
    assert domain.origin is not None
    low, size = np.array(domain.origin)[::2], np.array(domain.size)[::2]
    np.testing.assert_array_less(low - 1.0e-6, corners[0] - margin)
    np.testing.assert_array_less(corners[1] + margin, low + size + 1.0e-6)
    assert (low + size - corners[1] - margin < 8.0 + 1.0).all()


def test_points_and_degrees_make_the_same_box(tmp_path: Path) -> None:
    corners = shapely.MultiPoint(FIELD.exterior.coords)
    whole = made(tmp_path / "one")
    assert made(tmp_path / "two", corners).domain == whole.domain
    degrees = shapely.transform(FIELD, lambda rows: np.stack(transform(SWISS, "EPSG:4326", *rows.T), axis=1))
    third = made(tmp_path / "three", degrees, crs="EPSG:4326").domain
    np.testing.assert_allclose(third.origin, whole.domain.origin, atol=1.1)


def test_a_box_ends_with_the_terrain(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="the box ends where the terrain does"):
        domain = made(tmp_path, text=SCENE.replace("30.0, cell", "90.0, cell") + OUTLINE).domain
    assert domain.origin[2] == NORTH + 3.0  # posts stand 2.5 m inside the raster
    assert domain.size[2] == 192.0


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("margin = 30.0, ", "", "domain.margin: expected a length of at least 0 m"),
        ("margin = 30.0", "margin = -1", "domain.margin: expected a length of at least 0 m"),
        ("margin = 30.0", 'margin = "30 m"', "domain.margin: expected a length of at least 0 m"),
        ("margin = 30.0", "margin = 30.0, size = [1.0, 1.0, 1.0]", "domain.size: expected no such key beside around"),
        ("margin = 30.0", "margin = 30.0, cells = 3", "domain.cells: expected a known key"),
        ("cell = 4.0", "cell = 0", "domain.cell: expected a positive length"),
        ("cell = 4.0", "cell = 900", "domain.cell: expected cells that fit"),
        ("cell = 4.0", 'cell = 4.0, crs = "EPSG:4326"', "domain.crs: expected a projected coordinate system"),
        ("release.gpkg", "no.gpkg", "no.gpkg: expected polygons, lines or points, there is no such file"),
        ('"release.gpkg"', "3", "domain.around: expected the name of a file"),
        ('kind = "terrain", file = "dem.tif"', "lower = [0, 0, 0], size = [1, 1, 1]", "around: expected a terrain"),
    ],
)
def test_what_makes_no_box_is_one_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    refused(made, tmp_path, text=(SCENE + OUTLINE).replace(old, new, 1), said=said)


def test_shapes_beside_the_terrain_are_refused(tmp_path: Path) -> None:
    refused(made, tmp_path, shapely.affinity.translate(FIELD, 5_000.0), said="around: expected shapes that lie on")
    point = shapely.Point(EAST + 100.0, NORTH + 100.0)
    refused(made, tmp_path, point, SCENE.replace("30.0, cell", "0, cell"), said="above 0 m around a single place")
