"""A scene in map coordinates from a raster of elevations and a release polygon."""

import math
from pathlib import Path

import numpy as np
import pyogrio
import pytest
import shapely
import shapely.affinity

from datasets import Scene, read_scene
from datasets.command_line import run
from datasets.exchange import rasters
from datasets.exchange.rasters import read_raster
from datasets.exchange.vectors import Feature, read_polygons
from datasets.maps import KINDS
from datasets.scene.particles import initial_particles, mass_volumes
from datasets.site import command, site
from tests.datasets.exchange.test_scene_files import write_raster
from tests.datasets.exchange.test_vectors import written
from tests.refusals import refused_by

EAST, UP, NORTH = 2_600_000.0, 1_800.0, 1_200_000.0
SLOPE = math.radians(30.0)
PLACE = {"crs": "EPSG:2056", "corner": (EAST, NORTH)}
BED = {"thickness": None, "vertical": False, "bed": {"friction": 0.4}, "slope": 0.3, "cell": 2.0}
FIELD = shapely.box(EAST + 30.0, NORTH + 80.0, EAST + 70.0, NORTH + 120.0)


def dem(folder: Path, *, hole: bool = False, around: bool = False) -> Path:
    """500 x 200 m in cells of 5 m: a plane that falls by 30 degrees to the east over 300 m, then the level.

    around: without data to the north, the south and the west of the FIELD.
    """
    x = 5.0 * (np.arange(100) + 0.5)
    rows = np.tile(UP + math.tan(SLOPE) * np.maximum(300.0 - x, 0.0), (40, 1))
    if hole:
        rows[:4, :8] = -9999.0
    if around:
        rows[:16] = rows[24:] = rows[:, :6] = -9999.0
    write_raster(folder / "dem.tif", rows, cell=5.0, **PLACE)
    return folder / "dem.tif"


def features(folder: Path, shapes: list[shapely.Polygon], **attributes: list[float]) -> list[Feature]:
    """Polygons with attributes, as read from a file."""
    geometry, values = np.array(shapely.to_wkb(shapes)), [np.array(column) for column in attributes.values()]
    options = {"geometry_type": "Polygon", "crs": "EPSG:2056"}
    pyogrio.raw.write(folder / "release.gpkg", geometry, values, [*attributes], **options)
    return read_polygons(folder / "release.gpkg", "EPSG:2056")


def made(folder: Path, *flags: object, shape: shapely.Geometry = FIELD, ground: Path | None = None) -> Scene:
    """The scene that the command writes."""
    release, scene = written(folder / "release.gpkg", shape), folder / "new" / "site.toml"
    arguments = [ground or dem(folder), "--release", release, "--out", scene, *flags]
    assert run(command, "site", list(map(str, arguments))) == 0
    return read_scene(scene)


def test_a_site_is_a_scene_on_the_map(tmp_path: Path) -> None:
    """The attribute's 1.5 m normal to the bed, in a box that the energy line says, in cells of half of that or more."""
    scene = made(tmp_path, "--friction", 0.4, "--internal-friction", 35)
    assert mass_volumes(scene)[0] == pytest.approx(1.5 / math.cos(SLOPE) * 1600.0, rel=1e-3)
    domain = scene.domain
    assert domain.crs == "EPSG:2056"
    start = initial_particles(scene).positions + domain.corner
    assert start[:, 0].min() == pytest.approx(EAST + 30.0, abs=1.0)
    assert start[:, 2].max() == pytest.approx(NORTH + 120.0, abs=1.0)
    # Ground below 0.3 of the distance: 260 m of drop reach the end of the raster.
    assert domain.origin[0] + domain.size[0] > EAST + 480.0
    assert domain.origin[1] < UP
    assert scene.material.friction_deg == 35.0
    assert (scene.solids[0].friction, scene.solids[0].name) == (0.4, "terrain")


def test_what_the_flags_say(tmp_path: Path) -> None:
    scene = made(tmp_path, "--thickness", 2, "--vertical", "--cell", 4, "--friction", 0.7, "--turbulence", 2000)
    assert (scene.solids[0].turbulence, scene.domain.cell) == (2000.0, 4.0)
    assert mass_volumes(scene)[0] == pytest.approx(2.0 * 1600.0, rel=1e-6)
    # A steep energy line ends on the slope: the level is not in the box.
    assert scene.domain.origin[0] + scene.domain.size[0] < EAST + 450.0


def test_turbulence_on_a_slope_steeper_than_the_internal_friction_is_said(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="25 degrees are less than the 30 degrees of the slope under the release"):
        made(tmp_path, "--turbulence", 2000, "--internal-friction", 25)


def test_several_polygons_and_holes_of_the_raster(tmp_path: Path) -> None:
    """A corner without data is filled in a raster of its own, which the scene names."""
    pair = shapely.MultiPolygon([FIELD, shapely.box(EAST + 90.0, NORTH + 90.0, EAST + 110.0, NORTH + 110.0)])
    scene = made(tmp_path, "--cell", 2, ground=dem(tmp_path, hole=True), shape=pair)
    assert mass_volumes(scene) * math.cos(SLOPE) / 1.5 == pytest.approx([1600.0, 400.0], rel=1e-3)
    assert (tmp_path / "new" / "site.dem.tif").is_file()


def test_the_slope_beside_holes_is_that_of_the_ground(tmp_path: Path) -> None:
    """As level, the posts beside them would take 1 - cos(slope) of their part of the release."""
    scene = made(tmp_path, "--cell", 2, ground=dem(tmp_path, around=True))
    assert mass_volumes(scene)[0] == pytest.approx(1.5 / math.cos(SLOPE) * 1600.0, rel=1e-3)


@pytest.mark.parametrize(("edge", "thick"), [(0.3, 1.5), (400.0, 0.01)])
def test_releases_smaller_than_a_cell_and_thinner_than_a_particle(tmp_path: Path, edge: float, thick: float) -> None:
    """The corner of four cells lies in none of half their size; and particles are no more than the page says."""
    rows = np.tile(UP - 0.3 * 25.0 * np.arange(40), (40, 1))
    write_raster(tmp_path / "dem.tif", rows, cell=25.0, **PLACE)
    spot = shapely.box(*(base + 500.0 + side * edge for side in (-0.5, 0.5) for base in (EAST, NORTH)))
    release = read_polygons(written(tmp_path / "release.gpkg", spot), "EPSG:2056")
    table = site(read_raster(tmp_path / "dem.tif"), release, **BED | {"thickness": thick, "cell": None, "slope": 0.35})
    (mass,), cell = table["masses"], table["domain"]["cell"]
    thickness = np.array(mass["thickness"])
    assert np.mean(thickness[thickness > 0.0]) == pytest.approx(thick * math.hypot(1.0, 0.3), rel=1e-4)
    assert edge**2 / (0.5 * cell) ** 2 < 3.0e5


@pytest.mark.parametrize("name", ["site.dem.tif", "site.toml"])
def test_no_input_is_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    release, ground = written(tmp_path / "release.gpkg", FIELD), dem(tmp_path, hole=True).rename(tmp_path / name)
    before = ground.read_bytes()
    said = refused_by(capsys, command, ground, "--release", release, "--out", tmp_path / "site.toml")
    assert f"--out: expected a name beside which {ground} stays as it is" in said
    assert ground.read_bytes() == before


def test_a_thickness_by_raster(tmp_path: Path) -> None:
    """2 m in the west of the polygon and 1 m in the east, on cells of another size; none in holes."""
    rows = np.tile(np.where(np.arange(10) < 5, 2.0, 1.0), (20, 1))
    rows[:10] = -9999.0  # the north
    write_raster(tmp_path / "depth.tif", rows, cell=10.0, **PLACE)
    scene = made(tmp_path, "--cell", 2, "--thickness", tmp_path / "depth.tif")
    assert mass_volumes(scene)[0] * math.cos(SLOPE) == pytest.approx(400.0 * 3.0, rel=1e-3)  # 20 x 20 m of each
    start = initial_particles(scene).positions + scene.domain.corner
    assert start[:, 2].max() < NORTH + 106.0
    upright = made(tmp_path, "--cell", 2, "--vertical", "--thickness", tmp_path / "depth.tif")
    assert mass_volumes(upright)[0] == pytest.approx(mass_volumes(scene)[0] * math.cos(SLOPE), rel=1e-3)


def test_a_thickness_of_our_own_maps_is_vertical(tmp_path: Path) -> None:
    """A deposit that is released again."""
    what, values = KINDS["thickness"][0], np.full((100, 40), 2.0)
    rasters.write_raster(tmp_path / "own.tif", values, 5.0, (EAST, NORTH), "EPSG:2056", what, "m")
    released = made(tmp_path, "--cell", 2, "--thickness", tmp_path / "own.tif")
    assert mass_volumes(released) == pytest.approx([2.0 * 1600.0])


@pytest.mark.parametrize("west", [41, 43])
def test_a_thickness_on_finer_cells_than_the_terrain(tmp_path: Path, west: int) -> None:
    """A spot of 2 x 2 m, 2 m thick, around a post of the terrain or between two: it has its own volume."""
    rows = np.zeros((200, 500))
    rows[101:103, west : west + 2] = 2.0
    write_raster(tmp_path / "depth.tif", rows, None, 1.0, (EAST, NORTH))
    scene = made(tmp_path, "--cell", 1, "--thickness", tmp_path / "depth.tif")
    assert mass_volumes(scene)[0] * math.cos(SLOPE) == pytest.approx(8.0, rel=1e-3)


def test_ground_that_two_polygons_share_counts_once(tmp_path: Path) -> None:
    """By the thickness of the first: the second is cut, here to 20 of 40 m."""
    shapes = [FIELD, shapely.affinity.translate(FIELD, 20.0)]
    with pytest.warns(UserWarning, match=r"polygons of the release share 800 m\^2, which count once"):
        table = site(read_raster(dem(tmp_path)), features(tmp_path, shapes, thickness=[3.0, 1.5]), **BED)
    thick = [np.array(mass["thickness"]) for mass in table["masses"]]
    areas = [shapely.Polygon(mass["outline"]).area for mass in table["masses"]]
    volumes = [values[values > 0.0].mean() * area for values, area in zip(thick, areas, strict=True)]
    assert np.array(volumes) * math.cos(SLOPE) == pytest.approx([3.0 * 1600.0, 1.5 * 800.0], rel=1e-5)


def test_strips_of_overlapping_polygons_are_dropped(tmp_path: Path) -> None:
    """The same polygon drawn twice leaves 1 cm along two sides, in which no particle has a place."""
    shapes = [FIELD, shapely.affinity.translate(FIELD, 0.01, 0.01)]
    with pytest.warns(UserWarning, match="which count once|which are dropped") as said:
        table = site(read_raster(dem(tmp_path)), features(tmp_path, shapes, thickness=[1.5, 1.5]), **BED)
    assert "narrower than 1 m, 0.8 m^2, which are dropped" in str(said[1].message)
    assert len(table["masses"]) == 1


def test_a_thickness_is_the_first_attribute_with_a_value(tmp_path: Path) -> None:
    """Polygon by polygon; NULL is none."""
    shapes = [FIELD, shapely.affinity.translate(FIELD, 50.0)]
    release = features(tmp_path, shapes, thickness=[np.nan, 1.5], d0=[2.0, 3.0])
    table = site(read_raster(dem(tmp_path)), release, **BED | {"vertical": True})
    assert [mass["thickness"] for mass in table["masses"]] == [2.0, 1.5]


def test_vertices_in_one_place_are_one(tmp_path: Path) -> None:
    """10 nm are less than the decimals of a scene."""
    corners = [*FIELD.exterior.coords]
    near = shapely.Polygon([*corners[:2], (corners[1][0] - 1.0e-8, corners[1][1]), *corners[2:]])
    assert mass_volumes(made(tmp_path, "--vertical", shape=near)) == pytest.approx([2400.0])


@pytest.mark.parametrize("high", [(150, 20), (25, 50)], ids=["beyond the release", "one cell of it"])
def test_the_cell_is_half_the_mean_thickness(tmp_path: Path, high: tuple[int, int]) -> None:
    """2 m in cells of 2 m, and 20 m in one of them."""
    rows = np.full((100, 250), 2.0)
    rows[high[::-1]] = 20.0
    write_raster(tmp_path / "depth.tif", rows, cell=2.0, **PLACE)
    options = {"thickness": read_raster(tmp_path / "depth.tif"), "cell": None, "vertical": True}
    table = site(read_raster(dem(tmp_path)), features(tmp_path, [FIELD]), **BED | options)
    assert table["domain"]["cell"] in (1.0, 1.1)
    assert np.max(table["masses"][0]["thickness"]) == (20.0 if high[0] == 25 else 2.0)


def test_the_box_holds_the_ground_between_posts(tmp_path: Path) -> None:
    """On posts 30 m apart the ground at the upper edge of the release is 12 m above the highest post in it."""
    x = 30.0 * (np.arange(60) + 0.5)
    rows = np.tile(UP + 0.84 * np.maximum(1000.0 - x, 0.0), (20, 1))
    write_raster(tmp_path / "dem.tif", rows, cell=30.0, **PLACE)
    field = shapely.box(EAST + 180.0, NORTH + 250.0, EAST + 260.0, NORTH + 330.0)
    scene = made(tmp_path, "--cell", 0.7, shape=field, ground=tmp_path / "dem.tif")
    assert mass_volumes(scene) == pytest.approx([1.5 * math.hypot(1.0, 0.84) * 6400.0])


def test_a_bed_by_rasters(tmp_path: Path) -> None:
    """The least friction bounds the box; paths count from the scene."""
    rows = np.tile(np.linspace(0.7, 0.9, 50), (20, 1))
    write_raster(tmp_path / "mu.tif", rows, cell=10.0, **PLACE)
    write_raster(tmp_path / "xi.asc", np.where(rows < 0.75, 400.0, 1500.0), None, 10.0, (EAST, NORTH))
    scene = made(tmp_path, "--friction", tmp_path / "mu.tif", "--turbulence", tmp_path / "xi.asc", "--cell", 4)
    (bed,), written_as = scene.solids, (tmp_path / "new" / "site.toml").read_text()
    assert 'friction = "../mu.tif"' in written_as
    assert (np.min(bed.friction), np.max(bed.turbulence)) == pytest.approx((0.7, 1500.0), rel=0.02)
    assert scene.domain.origin[0] + scene.domain.size[0] < EAST + 450.0


def test_no_layer_lies_in_the_holes_of_a_release(tmp_path: Path) -> None:
    """Two of them, side by side."""
    holes = [shapely.box(EAST + x, NORTH + 90.0, EAST + x + 10.0, NORTH + 110.0) for x in (35.0, 55.0)]
    ring = shapely.Polygon(FIELD.exterior.coords, [hole.exterior.coords for hole in holes])
    scene = made(tmp_path, "--cell", 2, shape=ring)
    assert mass_volumes(scene).sum() == pytest.approx(1.5 / math.cos(SLOPE) * 1200.0, rel=1e-3)
    plan = shapely.points((initial_particles(scene).positions + scene.domain.corner)[:, ::2])
    assert not any(shapely.contains(hole, plan).any() for hole in holes)


def test_what_makes_no_site_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ground, out = dem(tmp_path), tmp_path / "site.toml"
    for name, least in (("none.asc", 0.0), ("less.asc", -1.0)):
        write_raster(tmp_path / name, np.array([[2.0, least]]), None, 9.0, (EAST, NORTH))
    far = shapely.box(EAST - 30.0, NORTH, EAST + 10.0, NORTH + 20.0)
    for shape, flags, said in (
        (far, [], "polygons that lie on the raster"),
        (FIELD, ["--thickness", "0"], "--thickness: expected a thickness above 0 m"),
        (FIELD, ["--thickness", "none.tif"], "none.tif: --thickness: expected a raster, there is no such file"),
        (FIELD, ["--friction", "-1"], "--friction: expected a coefficient"),
        (FIELD, ["--turbulence", "0"], "--turbulence: expected a coefficient"),
        (FIELD, ["--cell", "0"], "--cell: expected a length above 0 m"),
        (FIELD, ["--cell", "900"], "--cell: expected cells that fit"),
        (FIELD, ["--internal-friction", "95"], "--internal-friction: expected an angle above 0"),
        (FIELD, ["--turbulence", tmp_path / "none.asc"], "none.asc: --turbulence: expected a coefficient above 0"),
        (FIELD, ["--thickness", tmp_path / "less.asc"], "less.asc: --thickness: expected thicknesses of at least 0 m"),
        (shapely.affinity.translate(FIELD, -30.0), [], "--release: expected polygons that lie on the raster, with"),
    ):
        release = written(tmp_path / "release.gpkg", shape)
        assert said in refused_by(capsys, command, ground, "--release", release, "--out", out, *flags)
        release.unlink()
    (tmp_path / "none.geojson").write_text('{"type": "FeatureCollection", "features": []}')
    said = refused_by(capsys, command, ground, "--release", tmp_path / "none.geojson", "--out", out)
    assert "none.geojson: expected polygons, got none" in said
    assert not out.exists()
