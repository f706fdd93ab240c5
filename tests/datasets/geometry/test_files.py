"""Terrain, thickness and meshes from files; one line for what cannot be read."""

from collections.abc import Callable
from pathlib import Path

import meshio
import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine

from datasets.geometry.nearest import nearest
from datasets.library import read_scene
from datasets.particles import initial_particles, mass_volumes
from datasets.scene import Scene
from tests.datasets.geometry.solids import sphere, surface
from tests.refusals import refused

PLANE = """\
duration = 0.1
[domain]
size = [2.0, 1.0]
cell = 0.05
[material]
friction_deg = 30.0
"""
SPACE = PLANE.replace("[2.0, 1.0]", "[2.0, 1.0, 1.0]")
BODY = "[[masses]]\nlower = [1.7, 0.8]\nsize = [0.2, 0.1]\n"
BODY_3D = "[[masses]]\nlower = [1.7, 0.8, 0.4]\nsize = [0.2, 0.1, 0.2]\n"
TERRAIN = '[[solids]]\nkind = "terrain"\n'


def scene(folder: Path, text: str) -> Scene:
    """The scene of `text`, read from a file in `folder`."""
    (folder / "scene.toml").write_text(text)
    return read_scene(str(folder / "scene.toml"))


def tilted() -> np.ndarray:
    """Rows of a raster, from north to south, of y = 0.1 + 0.1 x + 0.2 z at the centres of cells of 0.1 m."""
    x, z = 0.05 + 0.1 * np.arange(20), 0.05 + 0.1 * np.arange(10)[::-1]
    return 0.1 + 0.1 * x[None] + 0.2 * z[:, None]


def write_raster(path: Path, values: np.ndarray, crs: str | None = "EPSG:32632", **changes: object) -> None:
    """A GeoTIFF or an ESRI ASCII raster whose lower left corner is at 500000, 5000000."""
    profile = {
        "driver": "GTiff" if path.suffix == ".tif" else "AAIGrid",
        "count": 1,
        "height": values.shape[0],
        "width": values.shape[1],
        "dtype": "float64",
        "crs": crs,
        "nodata": -9999.0,
        "transform": Affine(0.1, 0.0, 500000.0, 0.0, -0.1, 5000000.0 + 0.1 * values.shape[0]),
    } | changes
    with rasterio.open(path, "w", **profile) as file:
        file.write(values, 1)


def ground(found: Scene, positions: list[tuple[float, float, float]]) -> np.ndarray:
    """Signed distances from the surface of a scene."""
    return nearest(surface(found), np.array(positions)).distance


def test_a_ground_line(tmp_path: Path) -> None:
    (tmp_path / "line.csv").write_text("# surveyed\nx,y,friction\n0,0.5,0.2\n1,0.1,0.4\n2,0.1,0.4\n")
    found = scene(tmp_path, PLANE + BODY + TERRAIN + 'file = "line.csv"\nat = [0.0, 0.5]\n')
    (solid,) = found.solids
    assert solid.points == ((0.0, 1.0), (1.0, 0.6), (2.0, 0.6))
    assert solid.friction == (0.2, 0.4, 0.4)
    assert Scene.from_json(found.to_json()) == found


@pytest.mark.parametrize("name", ["dem.asc", "dem.tif"])
def test_a_height_field(tmp_path: Path, name: str) -> None:
    write_raster(tmp_path / name, tilted())
    found = scene(tmp_path, SPACE + BODY_3D + TERRAIN + f'file = "{name}"\n')
    slope = np.sqrt(1.0 + 0.1**2 + 0.2**2)
    distance = ground(found, [(0.5, 0.3, 0.5), (1.5, 0.2, 0.2), (0.3, 0.4, 0.9)])
    np.testing.assert_allclose(distance, np.array([0.05, -0.09, 0.09]) / slope, atol=1e-6)
    assert found.solids[0].corner == (500_000.0, 5_000_000.0)
    assert Scene.from_json(found.to_json()) == found


def test_a_raster_of_thickness_lies_beside_the_terrains(tmp_path: Path) -> None:
    write_raster(tmp_path / "dem.tif", np.full((10, 20), 0.2))
    # 0.4 x 0.3 m of release, 1.0 and 0.5 m from the corner.
    transform = Affine(0.1, 0.0, 500001.0, 0.0, -0.1, 5000000.0 + 0.5 + 0.3)
    write_raster(tmp_path / "release.tif", np.full((3, 4), 0.1), transform=transform)
    layer = '[[masses]]\nkind = "layer"\nthickness = "release.tif"\n'
    found = scene(tmp_path, SPACE + TERRAIN + 'file = "dem.tif"\n' + layer)
    # Between the centres of the raster's cells.
    assert mass_volumes(found)[0] == pytest.approx(0.3 * 0.2 * 0.1, rel=1e-6)
    particles = initial_particles(found).positions
    np.testing.assert_allclose(particles.min(axis=0), (1.05, 0.2, 0.55), atol=0.025)
    np.testing.assert_allclose(particles.max(axis=0), (1.35, 0.3, 0.75), atol=0.025)


@pytest.mark.parametrize("name", ["ball.stl", "ball.obj", "ball.msh"])
def test_a_mesh(tmp_path: Path, name: str) -> None:
    vertices, triangles = sphere((0.0, 0.0, 0.0), 200.0, 32)
    meshio.Mesh(vertices, [("triangle", triangles)]).write(
        tmp_path / name, **({"file_format": "gmsh22"} if name.endswith("msh") else {})
    )
    text = f'kind = "mesh"\nfile = "{name}"\nscale = 0.001\nat = [1.0, 0.4, 0.5]\n'
    found = scene(tmp_path, SPACE + BODY_3D + "[[solids]]\n" + text)
    distance = ground(found, [(1.0, 0.7, 0.5), (1.0, 0.4, 0.4)])
    np.testing.assert_allclose(distance, [0.1, -0.1], atol=0.004)
    body = scene(tmp_path, SPACE + "[[masses]]\n" + text)
    assert mass_volumes(body)[0] == pytest.approx(4.0 / 3.0 * np.pi * 0.2**3, rel=0.03)


def holes(path: Path) -> None:
    values = tilted()
    values[2, 3] = values[4, 5] = -9999.0
    write_raster(path, values)


CASES: list[tuple[str, Callable[[Path], object], str]] = [
    ("dem.asc", holes, "expected a raster without holes in the box, got 2 cells without data"),
    ("dem.tif", lambda path: write_raster(path, tilted(), "EPSG:4326"), "in metres, got one in degrees"),
    ("dem.tif", lambda path: write_raster(path, np.full((10, 5), 1.0)), "ground over the whole box, x from 0"),
    ("dem.asc", lambda path: None, "there is none"),
    ("dem.asc", lambda path: path.write_text("a,b\n1,2\n"), "expected a readable raster"),
]


@pytest.mark.parametrize(("name", "write", "words"), CASES)
def test_files_that_are_refused(tmp_path: Path, name: str, write: Callable[[Path], object], words: str) -> None:
    write(tmp_path / name)
    found = refused(scene, tmp_path, SPACE + BODY_3D + TERRAIN + f'file = "{name}"\n', said=words)
    assert found.where.endswith((name, "scene.toml"))
    assert "solids[0]" in found.key


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (TERRAIN + "points = [[0.0, 0.1], [1.5, 0.1]]\n", "solids[0].points: expected ground over the whole box"),
        (TERRAIN, "solids[0].points: expected `points` or a file of a terrain"),
        (TERRAIN + "file = 'x.csv'\nscale = 2.0\n", "solids[0].scale: expected no such key but of a mesh"),
        ("open_sides = ['z-']\n", "open_sides[0]: expected one of x-, x+, y-, y+"),
    ],
)
def test_solids_that_are_refused(tmp_path: Path, text: str, words: str) -> None:
    whole = text + PLANE + BODY if text.startswith("open") else PLANE + BODY + text
    refused(scene, tmp_path, whole, said=words)
