"""Terrain, thickness and meshes from files; one line for what cannot be read."""

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
import rasterio
import rasterio.shutil
from hypothesis import assume, example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rasterio.crs import CRS
from rasterio.transform import Affine

from datasets import Scene, read_scene
from datasets.exchange.meshes import read_mesh, write_surface
from datasets.exchange.rasters import read_raster
from datasets.geometry.nearest import nearest
from datasets.geometry.shells import manifold, outward
from datasets.scene.checks import warn_if_unlikely
from datasets.scene.particles import initial_particles, mass_volumes
from tests.datasets.geometry.solids import CUBE, QUADS, sphere, surface
from tests.refusals import refused

PLANE = """\
duration = 0.1
domain = { size = [2.0, 1.0], cell = 0.05 }
material = { friction_deg = 30.0 }
"""
SPACE = PLANE.replace("[2.0, 1.0]", "[2.0, 1.0, 1.0]")
BODY = "[[masses]]\nlower = [1.7, 0.8]\nsize = [0.2, 0.1]\n"
BODY_3D = "[[masses]]\nlower = [1.7, 0.8, 0.4]\nsize = [0.2, 0.1, 0.2]\n"
TERRAIN = '[[solids]]\nkind = "terrain"\n'
LAYER = '[[masses]]\nkind = "layer"\nthickness = "release.tif"\n'
NONE, UTM, Place = -9999.0, "EPSG:32632", tuple[float, float]
DRIVERS = {".tif": "GTiff", ".asc": "AAIGrid", ".img": "HFA", ".bil": "EHdr", ".grd": "GS7BG"}
HEIGHTS = st.sampled_from((NONE, 0.0)) | st.floats(0.05, 0.3)
RINGED = np.pad(np.full((3, 3), 0.2), 2, constant_values=NONE)


def scene(folder: Path, text: str) -> Scene:
    (folder / "scene.toml").write_text(text)
    return read_scene(str(folder / "scene.toml"))


def tilted() -> np.ndarray:
    """Rows of a raster, from north to south, of y = 0.1 + 0.1 x + 0.2 z at the centres of cells of 0.1 m."""
    x, z = 0.05 + 0.1 * np.arange(20), 0.05 + 0.1 * np.arange(10)[::-1]
    return 0.1 + 0.1 * x[None] + 0.2 * z[:, None]


def write_raster(
    path: Path, rows: np.ndarray, crs: str | None = UTM, cell: float = 0.1, corner: Place = (5e5, 5e6), **more: Any
) -> None:
    """A GeoTIFF or another raster with rows from north to south on square cells, from its lower left corner on [m]."""
    (height, width), (east, north) = rows.shape, corner
    driver, place = DRIVERS[path.suffix], Affine(cell, 0.0, east, 0.0, -cell, north + cell * height)
    profile = {"count": 1, "dtype": "float64", "nodata": NONE, "transform": place} | more
    if path.suffix in (".bil", ".grd"):
        profile |= {"dtype": "float32" if path.suffix == ".bil" else "float64", "nodata": None}
    with rasterio.open(path, "w", driver=driver, height=height, width=width, crs=crs, **profile) as file:
        file.write(rows, 1)


def ground(loaded: Scene, positions: list[tuple[float, float, float]]) -> np.ndarray:
    """Signed distances from the surface of a scene."""
    return nearest(surface(loaded), np.array(positions)).distance


def test_a_ground_line(tmp_path: Path) -> None:
    (tmp_path / "line.csv").write_text("# surveyed\nx,y,friction\n0,0.5,0.2\n1,0.1,0.4\n2,0.1,0.4\n")
    loaded = scene(tmp_path, PLANE + BODY + TERRAIN + 'file = "line.csv"\nat = [0.0, 0.5]\n')
    (solid,) = loaded.solids
    assert solid.points == ((0.0, 1.0), (1.0, 0.6), (2.0, 0.6))
    assert solid.friction == (0.2, 0.4, 0.4)
    assert Scene.from_json(loaded.to_json()) == loaded


@pytest.mark.parametrize(
    ("name", "encoding"),
    [(f"dem{ending}", "") for ending in (".tif", ".img", ".bil", ".grd", ".vrt")]
    + [("dem.asc", encoding) for encoding in ("utf-8", "utf-8-sig", "utf-16")],
)
def test_a_height_field(tmp_path: Path, name: str, encoding: str) -> None:
    if name.endswith(".vrt"):
        write_raster(tmp_path / "part.tif", tilted())
        rasterio.shutil.copy(tmp_path / "part.tif", tmp_path / name, driver="VRT")
    else:
        write_raster(tmp_path / name, tilted())
    if encoding:
        (tmp_path / name).write_bytes((tmp_path / name).read_text().encode(encoding))
    loaded = scene(tmp_path, SPACE + BODY_3D + TERRAIN + f'file = "{name}"\n')
    slope = np.sqrt(1.0 + 0.1**2 + 0.2**2)
    distance = ground(loaded, [(0.5, 0.3, 0.5), (1.5, 0.2, 0.2), (0.3, 0.4, 0.9)])
    np.testing.assert_allclose(distance, np.array([0.05, -0.09, 0.09]) / slope, atol=1e-6)
    assert loaded.solids[0].corner == (500_000.0, 5_000_000.0)
    assert Scene.from_json(loaded.to_json()) == loaded


@given(
    values=arrays(np.float64, st.tuples(*[st.integers(1, 4)] * 2), elements=HEIGHTS, fill=st.nothing()),
    cell=st.sampled_from((0.05, 0.1, 0.2)),
    edge=st.sampled_from(((0.1, 0.1), (0.2, 0.05))),
    south=st.sampled_from((1.0, -1.0)),
    ascii_grid=st.booleans(),
)
@example(values=np.array([[0.3]]), cell=0.2, edge=(0.2, 0.05), south=-1.0, ascii_grid=False)
@example(values=RINGED, cell=0.05, edge=(0.1, 0.1), south=1.0, ascii_grid=True)
def test_a_release_has_the_volume_of_its_cells(
    tmp_path: Path, values: np.ndarray, cell: float, edge: tuple[float, float], south: float, ascii_grid: bool
) -> None:
    """sum h A on any cells of the MPM, with the rows from north to south or the other way; no data is no layer."""
    assume((values > 0.0).any())
    # An ASCII grid has square cells, its first row in the north, and seven digits.
    name, edge, south = ("release.asc", (0.1, 0.1), 1.0) if ascii_grid else ("release.tif", edge, south)
    top = 5000000.0 + south * edge[1] * len(values)
    write_raster(tmp_path / name, values, transform=Affine(edge[0], 0.0, 500000.0, 0.0, -south * edge[1], top))
    layer = f'[[masses]]\nkind = "layer"\nthickness = "{name}"\nat = [0.4, 0.2]\n'
    loaded = scene(tmp_path, SPACE.replace("cell = 0.05", f"cell = {cell}") + layer)
    expected = pytest.approx(np.maximum(values, 0.0).sum() * edge[0] * edge[1], rel=1e-6 if ascii_grid else 1e-9)
    assert mass_volumes(loaded)[0] == expected
    assert initial_particles(loaded).volume.sum() == expected


def test_a_layer_that_the_box_cuts_is_said(tmp_path: Path) -> None:
    write_raster(tmp_path / "release.tif", np.full((2, 4), 0.2))
    loaded = scene(tmp_path, SPACE + LAYER + "at = [1.9, 0.2]\n")
    assert mass_volumes(loaded)[0] == pytest.approx(0.1 * 0.2 * 0.2, rel=1e-9)
    with pytest.warns(UserWarning, match=r"masses\[0\]: 0.75 of the layer lies beyond the sides"):
        warn_if_unlikely(loaded)


@pytest.mark.parametrize(
    ("dtype", "hole"),
    [
        *(("float64", hole) for hole in (-9999.0, -99999.0, -999.0, -9999.9, 9999.0, 1e20)),
        ("int16", -32768),
        ("float32", -3.4028235e38),
    ],
)
def test_undeclared_holes_are_no_ground(tmp_path: Path, dtype: str, hole: float) -> None:
    values = np.ones((10, 20), dtype)
    values[4, 5] = hole
    write_raster(tmp_path / "dem.tif", values, nodata=None, dtype=dtype)
    text = SPACE.replace("[2.0, 1.0, 1.0]", "[2.0, 3.0, 1.0]") + BODY_3D.replace("0.8,", "2.0,") + TERRAIN
    with pytest.warns(UserWarning, match="dem.tif: 1 values such as .* taken as no data"):
        refused(scene, tmp_path, text + 'file = "dem.tif"\n', said="without holes in the box, got 1 cells without data")


def test_a_high_valley_beside_zeros_and_a_high_cliff(tmp_path: Path) -> None:
    """Zeros around ground at 1500 m are no ground; what lies up to 500 m below all else is."""
    values = np.full((14, 26), 1500.0)
    for low, holes in ((0.0, 52), (1001.0, 0)):
        values[[0, -1]] = low
        write_raster(tmp_path / "dem.tif", values, nodata=None)
        with pytest.warns(UserWarning, match=f"{holes} values such as 0") if holes else nullcontext():
            assert int(np.isnan(read_raster(tmp_path / "dem.tif").values).sum()) == holes


def test_only_holes_that_the_box_needs_are_holes(tmp_path: Path) -> None:
    """A ring of no data around the box, and a hole some cells of the box beyond it."""
    values = np.full((14, 26), 0.2)
    values[[0, 1, -2, -1]] = values[:, [0, 1, 2, -1]] = NONE
    values[5, 24] = NONE
    write_raster(tmp_path / "dem.tif", values)
    loaded = scene(tmp_path, SPACE + BODY_3D + TERRAIN + 'file = "dem.tif"\nat = [-0.3, -0.2]\n')
    np.testing.assert_allclose(ground(loaded, [(0.01, 0.3, 0.5), (1.0, 0.3, 0.01), (1.99, 0.3, 0.99)]), 0.1, atol=1e-6)


def test_friction_and_turbulence_of_the_ground_by_raster(tmp_path: Path) -> None:
    """Bilinear between the centres of cells of 0.2 m, level beyond them; one value is a number."""
    x, z = 0.1 + 0.2 * np.arange(10), 0.1 + 0.2 * np.arange(5)[::-1]
    write_raster(tmp_path / "dem.tif", tilted())
    write_raster(tmp_path / "mu.asc", 0.1 + 0.2 * x[None] + 0.1 * z[:, None], None, cell=0.2)
    write_raster(tmp_path / "xi.tif", 500.0 + 2000.0 * (x[None] > 1.0) + 0.0 * z[:, None], cell=0.2)
    named = SPACE + BODY_3D + TERRAIN + 'file = "dem.tif"\nfriction = "mu.asc"\nturbulence = "xi.tif"\n'
    (bed,) = scene(tmp_path, named).solids
    posts = [0.05 + 0.1 * np.arange(count) for count in (20, 10)]
    clamped = [np.clip(axis, 0.1, length - 0.1) for axis, length in zip(posts, (2.0, 1.0), strict=True)]
    np.testing.assert_allclose(bed.friction, 0.1 + 0.2 * clamped[0][:, None] + 0.1 * clamped[1], rtol=1e-9)
    np.testing.assert_allclose(bed.turbulence, np.tile(np.interp(posts[0], (0.9, 1.1), (500.0, 2500.0)), (10, 1)).T)
    rows = np.full((5, 10), 0.3)
    write_raster(tmp_path / "mu.asc", rows, None, cell=0.2)
    assert scene(tmp_path, named).solids[0].friction == 0.3
    rows[2, 3] = NONE
    for values, cells in ((rows, 4), (rows[:, 4:], 80)):
        write_raster(tmp_path / "mu.asc", values, None, cell=0.2)
        said = f"expected a raster without holes in the box, got {cells} cells without data, the first at x = "
        error = refused(scene, tmp_path, named, said=said)
        assert (error.key, Path(error.where).name) == ("solids[0].friction", "mu.asc")
    line = PLANE + BODY + TERRAIN + 'points = [[0.0, 0.1], [2.0, 0.1]]\nfriction = "mu.asc"\n'
    assert refused(scene, tmp_path, line, said="").key.startswith("solids[0].friction")


@pytest.mark.parametrize("crs", ["EPSG:32632", "EPSG:25832", None, 'LOCAL_CS["site",UNIT["metre",1]]'])
def test_a_raster_of_thickness_lies_beside_the_terrains(tmp_path: Path, crs: str | None) -> None:
    """0.4 x 0.3 m, 1.0 and 0.5 m from its corner, by the same map: UTM of ETRS89 and of WGS 84 lie on each other."""
    write_raster(tmp_path / "dem.tif", np.full((10, 20), 0.2))
    write_raster(tmp_path / "release.tif", np.full((3, 4), 0.1), crs, corner=(500_001.0, 5_000_000.5))
    loaded = scene(tmp_path, SPACE + TERRAIN + 'file = "dem.tif"\n' + LAYER)
    assert mass_volumes(loaded)[0] == pytest.approx(0.4 * 0.3 * 0.1, rel=1e-9)  # the raster's cells whole
    particles = initial_particles(loaded).positions
    np.testing.assert_allclose(particles.min(axis=0), (1.0, 0.2, 0.5), atol=0.025)
    np.testing.assert_allclose(particles.max(axis=0), (1.4, 0.3, 0.8), atol=0.025)


def test_a_mesh(tmp_path: Path) -> None:
    vertices, triangles = sphere((0.0, 0.0, 0.0), 200.0, 32)
    meshio.Mesh(vertices, [("triangle", triangles)]).write(tmp_path / "ball.stl")
    text = 'kind = "mesh"\nfile = "ball.stl"\nscale = 0.001\nat = [1.0, 0.4, 0.5]\n'
    loaded = scene(tmp_path, SPACE + BODY_3D + "[[solids]]\n" + text)
    np.testing.assert_allclose(ground(loaded, [(1.0, 0.7, 0.5), (1.0, 0.4, 0.4)]), [0.1, -0.1], atol=0.004)
    body = scene(tmp_path, SPACE + "[[masses]]\n" + text)
    assert mass_volumes(body)[0] == pytest.approx(4.0 / 3.0 * np.pi * 0.2**3, rel=0.03)


def test_a_mesh_in_millimetres_is_not_filled(tmp_path: Path) -> None:
    """Its lattice would have 10^12 places: what is wrong is not the memory."""
    lines = [f"v {x} {y} {z}" for x, y, z in 500.0 * CUBE] + ["f " + " ".join(map(str, quad)) for quad in QUADS]
    (tmp_path / "cube.obj").write_text("\n".join(lines) + "\n")
    text = SPACE + '[[masses]]\nkind = "mesh"\nfile = "cube.obj"\n'
    refused(scene, tmp_path, text, said="masses[0]: expected a mesh inside the domain [2.0, 1.0, 1.0], got one from")
    assert mass_volumes(scene(tmp_path, text + "scale = 0.001\n"))[0] == pytest.approx(0.125, rel=1e-6)


def test_a_map_with_scale_offset_holes_and_rows_from_the_south(tmp_path: Path) -> None:
    """An int16 raster in millimetres of 9.8 + 0.1 + 0.2 z, and one of a release with a hole it does not declare."""
    heights = np.round(1000.0 * (9.9 + 0.2 * (0.05 + 0.1 * np.arange(10)))).astype(np.int16)
    thickness = np.array([[200, 200, 200], [200, -32768, 200]], np.int16)
    for name, values in (("dem.tif", np.repeat(heights[:, None], 20, axis=1)), ("release.tif", thickness)):
        upwards = Affine(0.1, 0.0, 500000.0, 0.0, 0.1, 5000000.0)
        write_raster(tmp_path / name, values, "EPSG:25832+5783", dtype="int16", nodata=None, transform=upwards)
        with rasterio.open(tmp_path / name, "r+") as file:
            file.scales, file.offsets = (0.001,), (-9.8 if name == "dem.tif" else 0.0,)
    with pytest.warns(UserWarning, match="release.tif: 1 values such as -32768 are taken as no data"):
        loaded = scene(tmp_path, SPACE + TERRAIN + 'file = "dem.tif"\n' + LAYER + "at = [0.4, 0.2]\n")
    np.testing.assert_allclose(ground(loaded, [(1.0, 0.4, 0.5), (1.0, 0.4, 0.9)]), [0.19612, 0.11767], atol=1e-4)
    assert mass_volumes(loaded)[0] == pytest.approx(5 * 0.1**2 * 0.2, rel=1e-9)


@pytest.mark.parametrize(
    ("release", "words"),
    [("EPSG:25832", "31287"), ("EPSG:4647", "31287"), ("EPSG:3857", "metres are metres on the ground")],
)
def test_a_release_of_another_map_is_refused(tmp_path: Path, release: str, words: str) -> None:
    """Beside a DEM of Austria's Lambert: UTM at its place, where UTM with a zone has none, and Web Mercator."""
    write_raster(tmp_path / "dem.tif", np.full((10, 20), 0.2), "EPSG:31287", corner=(4e5, 4e5))
    write_raster(tmp_path / "release.tif", np.full((3, 4), 0.1), release)
    text = SPACE + TERRAIN + 'file = "dem.tif"\n' + LAYER
    assert refused(scene, tmp_path, text, said=words).key == "masses[0].thickness"


def misspelt(old: bytes, new: bytes) -> Callable[[Path], object]:
    """An ASCII raster of 20 x 10 values of 0.25 in which one word is another."""

    def write(path: Path) -> None:
        write_raster(path, np.full((10, 20), 0.25))
        path.write_bytes(path.read_bytes().replace(old, new, 1))

    return write


def mosaic(source: str) -> Callable[[Path], object]:
    return lambda path: path.write_text(f"<VRTDataset><SourceFilename>{source}</SourceFilename></VRTDataset>")


def in_feet(plane: int) -> str:
    """A reference system, in WKT, whose plan is in metres and whose heights are in feet."""
    datum = 'VERT_DATUM["North American Vertical Datum 1988",2005]'
    heights = f'VERT_CS["NAVD88 height (ftUS)",{datum},UNIT["US survey foot",0.304800609601219],AXIS["Up",UP]]'
    return f'COMPD_CS["site",{CRS.from_epsg(plane).to_wkt()},{heights}]'


def heights_in_feet(path: Path) -> None:
    """By the reference system that stands beside an ASCII raster."""
    write_raster(path, tilted(), None)
    path.with_suffix(".prj").write_text(in_feet(25832))


CASES: list[tuple[str, Callable[[Path], object], str]] = [
    ("dem.asc", misspelt(b" 0.1000", b" 0.0000"), "expected cells larger than 0 m, got 0 x 0 m"),
    ("dem.asc", misspelt(b" 0.25", b" abc"), "expected numbers, got 'abc' in line 7"),
    ("dem.asc", misspelt(b" 0.25", b" 1.000,25"), "expected numbers, got '1.000,25' in line 7"),
    ("dem.asc", misspelt(b" 0.25", b" 0.2 5"), "expected 200 values, as the header says, got 201"),
    ("dem.asc", heights_in_feet, "expected elevations in metres, got 'US survey foot'"),
    ("dem.tif", lambda path: write_raster(path, tilted(), "EPSG:4326"), "in metres, got one in degrees"),
    ("dem.tif", lambda path: write_raster(path, np.full((10, 5), 1.0)), "ground over the whole box, x from 0"),
    # All values are no elevation: the raster is wrong, not the ground beneath something.
    ("dem.tif", lambda path: write_raster(path, np.full((10, 20), 130_000.0)), "below 20000, got 130000 and the like"),
    ("dem.vrt", mosaic("http://127.0.0.1/a.tif"), "expected a mosaic of files of this machine"),
    ("dem.vrt", mosaic("/vsicurl/http://127.0.0.1/a.tif"), "expected a mosaic of files of this machine"),
    ("dem.asc", lambda path: None, "there is no such file"),
    ("dem.asc", lambda path: path.write_text("a,b\n1,2\n"), "expected a readable raster"),
]


@pytest.mark.parametrize(("name", "write", "words"), CASES)
def test_files_that_are_refused(tmp_path: Path, name: str, write: Callable[[Path], object], words: str) -> None:
    write(tmp_path / name)
    error = refused(scene, tmp_path, SPACE + BODY_3D + TERRAIN + f'file = "{name}"\n', said=words)
    assert error.where.endswith((name, "scene.toml"))
    assert "solids[0]" in error.key


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (TERRAIN + "points = [[0.0, 0.1], [1.5, 0.1]]\n", "solids[0].points: expected ground over the whole box"),
        ('[[solids]]\nkind = "terain"\nfile = "x.csv"\n', "solids[0].kind: expected box, polygon, terrain in 2D"),
        (TERRAIN, "solids[0].points: expected `points` or a file of a terrain"),
        (TERRAIN + "file = 'x.csv'\nscale = 2.0\n", "solids[0].scale: expected no such key but of a mesh"),
        ("open_sides = ['z-']\n", "open_sides[0]: expected one of x-, x+, y-, y+"),
    ],
)
def test_solids_that_are_refused(tmp_path: Path, text: str, words: str) -> None:
    whole = text + PLANE + BODY if text.startswith("open") else PLANE + BODY + text
    refused(scene, tmp_path, whole, said=words)


@pytest.mark.parametrize(
    ("table", "key"), [(TERRAIN + "file", "solids[0].points[1]"), ("[water]\ntable", "water.table")]
)
@pytest.mark.parametrize("origin", ["", ", origin = [0.0, 0.0]"])
def test_what_is_wrong_with_a_line_names_its_file(tmp_path: Path, table: str, key: str, origin: str) -> None:
    (tmp_path / "line.csv").write_text("x,y\n2,0.1\n1,0.1\n0,0.1\n")
    plane = PLANE.replace("30.0", "30.0, saturated = true").replace("cell = 0.05", f"cell = 0.05{origin}")
    error = refused(scene, tmp_path, plane + BODY + f'{table} = "line.csv"\n')
    assert (error.where, error.key) == (str(tmp_path / "line.csv"), key)


@pytest.mark.parametrize("name", ["solids.stl", "solids.ply", "solids.vtu"])
def test_the_surface_of_solids_is_written_as_a_mesh(tmp_path: Path, name: str) -> None:
    loaded = scene(tmp_path, SPACE + BODY_3D + "[[solids]]\nlower = [0.5, 0.0, 0.2]\nsize = [0.4, 0.3, 0.2]\n")
    write_surface(loaded, str(tmp_path / name))
    assert manifold(*outward(*read_mesh(tmp_path / name), "")).volume() == pytest.approx(0.4 * 0.3 * 0.2, rel=1e-5)
    assert "ends in .stl" in str(refused(write_surface, loaded, tmp_path / "solids.txt"))
    assert "in 3D with" in str(refused(write_surface, scene(tmp_path, SPACE + BODY_3D), tmp_path / name))
