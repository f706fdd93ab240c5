"""Polygons from the files of a GIS, in the reference system of the map."""

from pathlib import Path

import numpy as np
import pyogrio
import pytest
import shapely
from rasterio.warp import transform

from datasets.exchange.vectors import read_polygons
from tests.refusals import refused

SWISS = "EPSG:2056"
FIELD = shapely.box(2_600_000.0, 1_200_000.0, 2_600_040.0, 1_200_030.0)
PAIR = shapely.MultiPolygon([FIELD, shapely.box(2_600_100.0, 1_200_000.0, 2_600_110.0, 1_200_010.0)])


def written(path: Path, shape: shapely.Geometry, crs: str | None = SWISS, thickness: float = 1.5) -> Path:
    """A file of one feature."""
    geometry, values = np.array([shapely.to_wkb(shape)]), [np.array([thickness])]
    driver = {"driver": "KML"} if path.suffix == ".kml" else {}
    pyogrio.raw.write(path, geometry, values, ["Thickness"], geometry_type=shape.geom_type, crs=crs, **driver)
    return path


@pytest.mark.parametrize("name", ["field.shp", "field.gpkg", "field.geojson"])
def test_each_format_has_the_polygons_and_their_attributes(tmp_path: Path, name: str) -> None:
    path = written(tmp_path / name, PAIR)
    for map_system in (SWISS, None):
        features = read_polygons(path, map_system)
        assert [feature.polygon.area for feature in features] == pytest.approx([1200.0, 100.0])
        assert features[0].polygon.bounds == pytest.approx(FIELD.bounds)
        assert [feature.attributes["thickness"] for feature in features] == [1.5, 1.5]


def test_a_collection_has_the_polygons_of_its_collections(tmp_path: Path) -> None:
    point = shapely.Point(2_600_000.0, 1_200_000.0)
    nested = shapely.GeometryCollection([shapely.GeometryCollection([PAIR, point]), FIELD])
    features = read_polygons(written(tmp_path / "field.geojson", nested), SWISS)
    assert [feature.polygon.area for feature in features] == pytest.approx([1200.0, 100.0, 1200.0])


def test_the_polygons_of_one_layer(tmp_path: Path) -> None:
    """Whatever else the file holds; of several with polygons the one that is named as in QGIS."""
    path, point = tmp_path / "project.gpkg", shapely.Point(2_600_000.0, 1_200_000.0)
    for layer, shape in (("gauges", point), ("release", FIELD), ("deposit", PAIR)):
        options = {"geometry_type": shape.geom_type, "crs": SWISS, "layer": layer}
        pyogrio.raw.write(path, np.array([shapely.to_wkb(shape)]), [], [], **options)
        if layer == "release":
            assert len(read_polygons(path, SWISS)) == 1
    refused(read_polygons, path, SWISS, said="expected polygons in one layer, or FILE|layername=NAME, got them in")
    assert len(read_polygons(Path(f"{path}|layername=deposit"), SWISS)) == 2
    refused(read_polygons, Path(f"{path}|layername=no"), SWISS, said="one of the layers gauges, release, deposit")


@pytest.mark.parametrize("name", ["field.geojson", "field.kml"])
def test_degrees_come_into_the_system_of_the_map(tmp_path: Path, name: str) -> None:
    degrees = shapely.transform(FIELD, lambda rows: np.stack(transform(SWISS, "EPSG:4326", *rows.T), axis=1))
    (feature,) = read_polygons(written(tmp_path / name, degrees, "EPSG:4326"), SWISS)
    assert feature.polygon.symmetric_difference(FIELD).area < 2.0  # GDAL writes degrees to 1 cm
    if name.endswith("kml"):
        refused(read_polygons, tmp_path / name, None, said="metres, such as 'EPSG:2056', got 'EPSG:4326'")


@pytest.mark.parametrize(("crs", "said"), [("EPSG:2263", "got 'EPSG:2263'"), ("EPSG:3857", "where one is 0.681 m")])
def test_a_file_beside_a_map_without_a_system_is_in_metres_on_the_ground(tmp_path: Path, crs: str, said: str) -> None:
    """Feet of New York; Web Mercator at 47 degrees, where a release would have 2.16 times its area."""
    shape = shapely.box(1_000_000.0, 5_942_074.0, 1_000_030.0, 5_942_104.0)
    refused(read_polygons, written(tmp_path / "field.gpkg", shape, crs), None, said=said)


def test_coordinates_without_a_system_are_those_of_the_map(tmp_path: Path) -> None:
    """GDAL takes such a GeoJSON for degrees."""
    text = shapely.to_geojson(FIELD)
    (tmp_path / "field.geojson").write_text(f'{{"type": "Feature", "properties": {{}}, "geometry": {text}}}')
    for crs in (SWISS, None):
        (feature,) = read_polygons(tmp_path / "field.geojson", crs)
        assert feature.polygon.bounds == FIELD.bounds


def test_what_holds_no_polygons_is_one_line(tmp_path: Path) -> None:
    refused(read_polygons, tmp_path / "field.shp", SWISS, said="field.shp")
    for name, text, said in (
        ("field.dxf", "0", "a file whose name ends in .shp .gpkg"),
        ("field.kml", "<OGRVRTDataSource/>", "a file as its ending .kml says"),
        ("field.json", '{"type": "Feature"', "expected polygons"),
        ("cross.geojson", shapely.to_geojson(shapely.Polygon([(0, 0), (1, 1), (1, 0), (0, 1)])), "do not cross"),
        ("point.geojson", shapely.to_geojson(shapely.Point(2_600_000, 1_200_000)), "expected polygons, got none"),
    ):
        (tmp_path / name).write_text(text)
        refused(read_polygons, tmp_path / name, None if name == "cross.geojson" else SWISS, said=said)
