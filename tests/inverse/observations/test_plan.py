"""Thickness in plan: layers of known thickness on planes, whatever the raster and its place on the map."""

import dataclasses
import warnings
from pathlib import Path

import numpy as np
import pyogrio
import pytest
import shapely
import torch

from datasets import Domain, Mass, Scene, Solid, Trajectory
from datasets.exchange.rasters import write_raster
from datasets.maps import KINDS, maps_of, region_above, write_outlines
from inverse.observations import OutlineSettings, ThicknessSettings, plan
from inverse.observations.outline import Boundary
from inverse.problem import read_problem
from tests.refusals import refused
from tests.scenes import flow_of, scene_of

PLANE = Solid(kind="terrain", origin=(-1.0, -1.0), spacing=(6.0, 6.0), heights=((3.0, 3.0), (0.0, 0.0)), friction=0.4)
"""Falls by half along x: from 2.5 m over the corner of the box."""
NORMAL = 1.0 / np.sqrt(1.25)
CORNER = (2_600_000.0, 1_200_000.0)
ANY, KNOWN = (0.0, float("inf")), (0.04, 0.04)  # released volume over the width, unknown or of the layer [m^2]


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
    weighted = thickness.smooth(points, torch.from_numpy(run.volumes)) @ weights
    (slope,) = torch.autograd.grad(weighted, points)
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


@pytest.mark.parametrize("most", [1500, 60])
def test_a_flow_fits_the_map_of_its_own_peaks(most: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also in blocks of cells, over three of which it moves from one frame to the next."""
    monkeypatch.setattr(plan, "MOST", most)
    made = scene(origin=True)
    positions = np.repeat(layer(made).positions, 3, axis=0)
    positions[..., 0] += 0.6 * np.arange(3)[:, None]
    run = dataclasses.replace(layer(made), positions=positions, time=np.arange(3.0))
    write_raster(tmp_path / "peak.tif", maps_of(run, 0.2).depth, 0.2, CORNER, "EPSG:2056", "depth", "m")
    settings = ThicknessSettings(file="peak.tif", noise=0.01, peak=True, direction="vertical")
    target = settings.read(made, tmp_path, ANY)
    assert target.observation.grid.count <= most
    np.testing.assert_allclose(target.observation.observe(run), target.values, atol=2.0e-3)


@pytest.mark.parametrize("cell", [0.05, 0.2, 0.4])
def test_a_raster_on_the_map_is_the_target_that_its_flow_makes(cell: float, tmp_path: Path) -> None:
    """Of 0.1 m on the same square, cells from a quarter of the grid's to twice: all numbers of the layer are it."""
    made = scene(origin=True)
    count = round(4.0 / cell)
    middles = cell * (np.arange(count) + 0.5)
    inside = (middles > 0.8) & (middles < 2.4)
    write_raster(tmp_path / "h.tif", 0.1 * np.outer(inside, inside), cell, CORNER, "EPSG:2056", "thickness", "m")
    target = ThicknessSettings(file="h.tif", noise="10%", length=0.5).read(made, tmp_path, KNOWN)
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
    bare = target.values == 0.0
    assert bare.any()
    assert target.deviation[bare] == pytest.approx(0.1 * target.values[~bare].mean())
    assert places.max() < 2.4 + 0.25 * 1.6 + 2.0 * grid.spacing[0]


@pytest.mark.parametrize(("name", "direction"), [("depth", "vertical"), ("normal_depth", "normal")])
def test_our_own_maps_say_how_they_are_measured(name: str, direction: str, tmp_path: Path) -> None:
    made = scene(PLANE, origin=True)
    values = getattr(maps_of(layer(made), 0.2), name)
    write_raster(tmp_path / "own.tif", values, 0.2, CORNER, "EPSG:2056", KINDS[name][0], "m")
    settings = ThicknessSettings(file="own.tif", noise=0.01, peak=True)
    target = settings.read(made, tmp_path, ANY)
    np.testing.assert_allclose(target.observation.observe(layer(made)), target.values, atol=1e-6)
    other = {"vertical": "normal", "normal": "vertical"}[direction]
    wrong = dataclasses.replace(settings, direction=other)
    refused(wrong.read, made, tmp_path, ANY, said=f"direction: expected {direction}, as this map of Talus is measured")


def test_what_is_no_raster_of_this_flow_is_refused(tmp_path: Path) -> None:
    made, heap = scene(origin=True), np.full((20, 20), 10.0)
    write_raster(tmp_path / "cm.tif", heap, 0.2, CORNER, "EPSG:2056", "thickness", "m")
    write_raster(tmp_path / "far.tif", heap, 0.2, (0.0, 0.0), "EPSG:2056", "thickness", "m")
    refused(ThicknessSettings(file="cm.tif").read, made, tmp_path, KNOWN, said="cm.tif: expected a volume of at most")
    refused(ThicknessSettings(file="far.tif").read, made, tmp_path, KNOWN, said="far.tif: expected cells between 0 and")
    refused(lambda: ThicknessSettings(cell=-1.0), said="cell: expected a positive length")
    middles = 0.2 * (np.arange(20) + 0.5)
    inside = np.outer(abs(middles - 1.6) < 0.8, abs(middles - 1.6) < 0.8)
    write_raster(tmp_path / "cut.tif", np.where(inside, 0.1, np.nan), 0.2, CORNER, "EPSG:2056", "thickness", "m")
    with pytest.warns(UserWarning, match="100% of the cells around the deposit have no data"):
        ThicknessSettings(file="cut.tif").read(made, tmp_path, KNOWN)


@pytest.mark.parametrize("direction", ["normal", "vertical"])
def test_points_of_a_survey_are_the_thickness_above_the_terrain(direction: str, tmp_path: Path) -> None:
    """Of 0.1 m along y over a plane, with 5 mm of noise; bare ground is bare, a cell without points does not count."""
    made, rng = scene(PLANE, origin=True), np.random.default_rng(0)
    plan = rng.uniform(0.0, 4.0, (20_000, 2))
    plan = plan[(plan < 2.4).any(axis=1) | (plan > 2.6).any(axis=1)]
    inside = ((plan > 0.8) & (plan < 2.4)).all(axis=1)
    height = 2.5 - 0.5 * plan[:, 0] + 0.1 * inside + rng.normal(0.0, 0.005, len(plan))
    rows = np.column_stack([plan + CORNER, height + 1300.0])
    np.savetxt(tmp_path / "survey.csv", rows, "%.6f", ",", header="x,y,z", comments="")
    settings = ThicknessSettings(file="survey.csv", noise=0.01, direction=direction, cell=0.4)
    target = settings.read(made, tmp_path, KNOWN)
    places = target.observation.grid.positions[target.observation.cells]
    core = ((places > 0.8 + 0.01) & (places < 2.4 - 0.01)).all(axis=1)
    factor = NORMAL if direction == "normal" else 1.0
    np.testing.assert_allclose(target.values[core], 0.1 * factor, atol=0.003)
    assert not target.values[~core].any()
    np.savetxt(tmp_path / "survey.csv", rows - [0.0, 0.0, 1.0], "%.6f", ",", header="x,y,z", comments="")
    with pytest.warns(UserWarning, match=r"half of the survey lies 1 m or more beneath the terrain"):
        refused(settings.read, made, tmp_path, KNOWN, said="survey.csv: expected a thickness above 0 m in the box")


def disc(scene: Scene, radius: float, middle: tuple[float, float] = (2.0, 2.0)) -> Trajectory:
    """A layer 0.1 m thick within a circle."""
    x, z = np.meshgrid(*(np.arange(0.0125, 4.0, 0.025),) * 2, indexing="ij")
    inside = np.hypot(x - middle[0], z - middle[1]) < radius
    points = np.stack([x[inside], np.zeros(inside.sum()), z[inside]], axis=1)
    return dataclasses.replace(flow_of(scene, points[None]), volume=np.full(len(points), 0.025**2 * 0.1, np.float32))


def ring(radius: float) -> list[list[float]]:
    angle = np.linspace(0.0, 2.0 * np.pi, 200)[:-1]
    return (2.0 + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)).tolist()


@pytest.mark.parametrize("suffix", ["csv", "geojson", "gpkg"])
def test_an_outline_is_signed_distances_along_the_boundary(suffix: str, tmp_path: Path) -> None:
    """Circles of 1.3 and 1.0 m about an observed one of 1.15 m, on the map: 0.15 m beyond and short all around."""
    made = scene(origin=True)
    vertices = np.array(ring(1.15)) + CORNER
    path = tmp_path / f"seen.{suffix}"
    if suffix == "csv":
        path.write_text("x,z\n" + "".join(f"{x:.6f},{z:.6f}\n" for x, z in vertices))
    else:
        polygon = shapely.to_wkb(np.array([shapely.Polygon(vertices)]))
        pyogrio.raw.write(path, polygon, [], [], geometry_type="Polygon", crs="EPSG:2056")
    key = "csv" if suffix == "csv" else "file"
    settings = OutlineSettings(**{key: path.name}, noise=0.05, length=1.0, thickness=0.05)
    made = dataclasses.replace(made, domain=dataclasses.replace(made.domain, crs="EPSG:2056"))
    target = settings.read(made, tmp_path, ANY)
    assert not target.values.any()
    for radius in (1.3, 1.0):
        run = disc(made, radius)
        np.testing.assert_allclose(target.observation.observe(run), radius - 1.15, atol=0.03)
        scores = target.observation.scores(run.positions[-1], run.volumes)
        assert scores["intersection_over_union"] == pytest.approx(min(1.15 / radius, radius / 1.15) ** 2, abs=0.02)
        both, beyond, missed = min(radius, 1.15) ** 2, max(0.0, radius**2 - 1.15**2), max(0.0, 1.15**2 - radius**2)
        assert scores["tversky"] == pytest.approx(both / (both + 0.3 * beyond + 0.7 * missed), abs=0.02)
    # Neighbours share their error: 36 points, 0.2 m apart.
    matrix = target.errors.matrix / 0.05**2
    step = 2.0 * 1.15 * np.sin(np.pi / len(matrix))
    assert matrix[0, 1] == pytest.approx(np.exp(-step), rel=1e-3)


def test_our_own_outline_is_compared_at_its_own_threshold(tmp_path: Path) -> None:
    """Of several the lowest, or the one that is named; of a file without any a large default is said."""
    made, corner = scene(origin=True), np.array(CORNER)
    circles = [shapely.transform(shapely.Polygon(ring(radius)), corner.__add__) for radius in (1.2, 1.0)]
    written = np.array([shapely.to_wkb(circle) for circle in circles])
    columns = [np.array(["deposit"] * 2, object), np.array([0.05, 0.08])]
    for name, fields in (("own.gpkg", ["name", "threshold_m"]), ("other.gpkg", ["name", "depth"])):
        pyogrio.raw.write(tmp_path / name, written, columns, fields, geometry_type="Polygon", crs="EPSG:2056")
    for thickness, level, area in ((None, 0.05, 1.2), (0.08, 0.08, 1.0)):
        settings = OutlineSettings(file="own.gpkg", noise=0.05, thickness=thickness)
        operator = settings.read(made, tmp_path, ANY).observation
        assert operator.thickness == level
        assert operator.region.area == pytest.approx(np.pi * area**2, rel=1e-2)
    wrong = OutlineSettings(file="own.gpkg", noise=0.05, thickness=0.07)
    refused(wrong.read, made, tmp_path, ANY, said="thickness: expected one of the file's, 0.05, 0.08, got 0.07")
    with pytest.warns(UserWarning, match="the model's outline is where it is 0.1 m thick"):
        OutlineSettings(file="other.gpkg", noise=0.05).read(made, tmp_path, ANY)


@pytest.mark.parametrize("suffix", ["geojson", "shp"])
@pytest.mark.parametrize(
    ("levels", "said"),
    [
        ((None, None), ""),
        (("", "0.08"), "a threshold_m above 0 m of each deposit, or of none, got one without"),
        ((np.nan, 0.08), "a threshold_m above 0 m of each deposit, or of none, got one without"),
        (("0.08", "0.08"), 0.08),
        ((0.08, 0.08), 0.08),
        (("0.5 m", "0.08"), "a number [m] in the attribute threshold_m or threshold_, got 0.5 m"),
        ((-1.0, 0.08), "a number [m] in the attribute threshold_m or threshold_, got -1.0"),
    ],
)
def test_thresholds_of_an_edited_file(tmp_path: Path, suffix: str, levels: tuple[object, ...], said: object) -> None:
    """A shapefile cuts the name of the attribute; NULL is no threshold."""
    made, corner = scene(origin=True), np.array(CORNER)
    boxes = [shapely.transform(shapely.box(x, 1.0, x + 1.0, 3.0), corner.__add__) for x in (0.5, 2.0, 3.0)]
    levels = (*levels, levels[1])
    column = np.array(levels, object if isinstance(levels[1], str | None) else float)
    columns = [np.array(["Deposit", "deposit", "release"], object), column]
    path = tmp_path / f"own.{suffix}"
    names = ["name", "threshold_m"[: 10 if suffix == "shp" else None]]
    pyogrio.raw.write(path, shapely.to_wkb(boxes), columns, names, geometry_type="Polygon", crs="EPSG:2056")
    settings = OutlineSettings(file=path.name, noise=0.05)
    if isinstance(said, str) and said:
        refused(settings.read, made, tmp_path, ANY, said=said)
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore" if said == "" else "error")
        operator = settings.read(made, tmp_path, ANY).observation
    assert operator.thickness == (said or 0.1)
    assert operator.region.area == pytest.approx(4.0)


def test_the_outline_of_a_run_fits_this_run(tmp_path: Path) -> None:
    """Stray particles, whose island is below a twentieth of the deposit, count neither in it nor in its outline."""
    made, rows = scene(), [disc(scene(), 1.0), disc(scene(), 0.15, (3.5, 3.5))]
    run = flow_of(made, np.concatenate([row.positions for row in rows], axis=1))
    run = dataclasses.replace(run, volume=np.concatenate([row.volumes for row in rows]))
    maps = maps_of(run, 0.2, threshold=0.05)
    region = region_above(maps.grid, maps.thickness, 0.05)
    assert len(region.geoms) == 2
    write_outlines(tmp_path / "outline.geojson", maps, {("deposit", 0.05): region})
    with pytest.warns(UserWarning, match="parts smaller than 5% of the largest do not count, as those of the model: 1"):
        target = OutlineSettings(file="outline.geojson", noise=0.05).read(made, tmp_path, ANY)
    np.testing.assert_allclose(target.observation.observe(run), 0.0, atol=1e-6)


def test_points_lie_along_the_boundary_by_its_length() -> None:
    hole = [(1.0, 1.0), (1.01, 1.0), (1.01, 1.01), (1.0, 1.01)]
    boundary = Boundary(scene(), shapely.Polygon([(0.5, 0.5), (2.5, 0.5), (2.5, 2.5), (0.5, 2.5)], [hole]))
    assert boundary.count == len(boundary.points) == 20
    np.testing.assert_allclose(shapely.distance(boundary.points, shapely.box(0.5, 0.5, 2.5, 2.5).boundary), 0.0)


def test_the_slope_of_a_distance_is_that_of_the_boundary() -> None:
    """As a disc is scaled about its middle, the boundary moves with its radius."""
    made = scene()
    run, factor = disc(made, 1.0), torch.tensor(1.0, dtype=torch.float64, requires_grad=True)
    boundary = Boundary(made, shapely.Polygon(ring(1.15)), thickness=0.05)
    points, middle = torch.from_numpy(run.positions[0]).double(), torch.tensor([2.0, 0.0, 2.0])
    numbers = boundary.smooth(middle + factor * (points - middle), torch.from_numpy(run.volumes) * factor**2)
    (slope,) = torch.autograd.grad(numbers.mean(), factor)
    assert float(slope) == pytest.approx(1.0, rel=0.1)


def test_a_twins_outline_is_its_own_and_a_wrong_one_is_refused(tmp_path: Path) -> None:
    made = scene()
    target = OutlineSettings(noise=0.05).of_run(made, disc(made, 1.0))
    np.testing.assert_allclose(target.observation.observe(disc(made, 1.0)), 0.0, atol=1e-9)
    assert target.observation.scores(disc(made, 1.0).positions[-1], disc(made, 1.0).volumes)["tversky"] > 0.999
    (tmp_path / "far.csv").write_text("x,z\n10,0\n12,0\n12,2\n")
    (tmp_path / "bow.csv").write_text("x,z\n1,1\n2,2\n2,1\n1,2\n")
    (tmp_path / "two.csv").write_text("x,z\n1,1\n2,2\n")
    for name, said in (("far", "within the box"), ("bow", "in order along the outline"), ("two", "three vertices")):
        refused(OutlineSettings(csv=f"{name}.csv", noise=0.1).read, made, tmp_path, ANY, said=said)
    refused(lambda: OutlineSettings(noise="5%"), said="a distance in m")


def test_places_of_a_problem_are_on_the_map_of_its_scene(tmp_path: Path) -> None:
    """The same problem in a box at (500, 1300) as in one without a place: TOML and CSV alike."""
    targets = []
    for x, text in ((0.0, ""), (500.0, "origin = [500.0, 1300.0]\n")):
        lower = 1300.0 if text else 0.0
        (tmp_path / "scene.toml").write_text(
            f"[domain]\nsize = [1.0, 0.5]\ncell = 0.02\n{text}[material]\nfriction_deg = 30.0\n"
            f"[[masses]]\nlower = [{x}, {lower}]\nsize = [0.2, 0.4]\n"
        )
        (tmp_path / "gauges.csv").write_text(f"x,height\n{x + 0.1},0.2\n{x + 0.3},0.1\n")
        rows = "".join(f"{x + a},{0.2 - 0.25 * a}\n" for a in np.linspace(0.0, 0.8, 9))
        (tmp_path / "profile.csv").write_text("x,height\n" + rows)
        (tmp_path / "problem.toml").write_text(
            'scene = "scene.toml"\n[[unknowns]]\nname = "friction_deg"\ninitial = 30.0\nlower = 20.0\nupper = 40.0\n'
            f'[[observations]]\nkind = "front"\nvalue = {x + 0.6}\nnoise = 0.01\n'
            f'[[observations]]\nkind = "toe"\nvalues = [{x + 0.5}, {lower + 0.02}]\nnoise = 0.01\n'
            f'[[observations]]\nkind = "passed"\nline = {x + 0.4}\nvalue = 0.3\nnoise = 0.01\n'
            f'[[observations]]\nkind = "arrival"\nx = [{x + 0.4}]\nvalues = [0.3]\nnoise = 0.01\n'
            f'[[observations]]\nkind = "speed"\nx = [{x + 0.3}, {x + 0.4}]\nvalue = 1.0\nnoise = 0.1\n'
            '[[observations]]\nkind = "height"\ncsv = "gauges.csv"\nnoise = 0.01\n'
            '[[observations]]\nkind = "profile"\ncsv = "profile.csv"\nnoise = 0.01\n'
        )
        targets.append(read_problem(str(tmp_path / "problem.toml")).measured)
    for here, there in zip(*targets, strict=True):
        np.testing.assert_allclose(there.values, here.values, atol=1e-9)
        assert getattr(there.observation, "line", 0.0) == pytest.approx(getattr(here.observation, "line", 0.0))
        np.testing.assert_allclose(getattr(there.observation, "x", 0.0), getattr(here.observation, "x", 0.0))
    problem = (tmp_path / "problem.toml").read_text()
    (tmp_path / "problem.toml").write_text(problem.replace("value = 500.6", "value = 0.6"))
    said = "lengths count from the corner of the box here, 500, 1300 on the map"
    refused(read_problem, str(tmp_path / "problem.toml"), said=said)
    (tmp_path / "problem.toml").write_text(problem.replace("noise = 0.1", "noise = 0.1\nwindow = -1.0"))
    assert "corner" not in str(refused(read_problem, str(tmp_path / "problem.toml"), said="observations[4].window"))
    (tmp_path / "problem.toml").write_text(problem.replace("upper = 40.0", "upper = 10.0"))
    refused(read_problem, str(tmp_path / "problem.toml"), said="unknowns[0].upper: expected a value above 20")
