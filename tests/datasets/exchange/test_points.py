"""Points of a survey, however they are written."""

import sys
from pathlib import Path

import numpy as np
import pytest
from rasterio.crs import CRS
from rasterio.warp import transform

from datasets.exchange.points import read_points
from tests.datasets.exchange.test_scene_files import in_feet
from tests.refusals import refused

LOW, HIGH, SWISS = np.array([2_600_000.0, 1_200_000.0]), np.array([2_600_100.0, 1_200_050.0]), "EPSG:2056"
PLACES = np.array([[2_600_010.0, 1_200_020.0, 1_300.5], [2_600_030.25, 1_200_040.0, 1_299.75]])
BESIDE = np.array([[2_600_010.0, 1_199_000.0, 1_300.5]])


def las(path: Path, rows: np.ndarray, kinds: list[int], record: str = "") -> Path:
    """A LAS of points with these classes, perhaps with a reference system."""
    laspy = pytest.importorskip("laspy")
    file = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    file.header.offsets, file.header.scales = rows.min(axis=0), [0.001] * 3
    file.x, file.y, file.z = rows.T
    file.classification = kinds
    if record:
        file.header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(record))
    file.write(path)
    return path


@pytest.mark.filterwarnings("ignore:.*read with semicolons")
@pytest.mark.parametrize(
    ("name", "head", "separator"),
    [
        ("survey.csv", "x,y,z", ","),
        ("survey.csv", "id;easting;northing;elevation [m]", ";"),
        ("survey.csv", "Northing,Easting,Elevation", ","),
        ("SURVEY.XYZ", "", " "),
    ],
)
def test_a_table_of_points(tmp_path: Path, name: str, head: str, separator: str) -> None:
    order = [1, 0, 2] if head.startswith("Northing") else [0, 1, 2]
    places = np.concatenate([PLACES, BESIDE])[:, order].tolist()
    rows = [separator.join([*("7" * ("id" in head)), *map(repr, row)]) for row in places]
    (tmp_path / name).write_text("\n".join([head] * bool(head) + rows) + "\n")
    np.testing.assert_array_equal(read_points(tmp_path / name, SWISS, LOW, HIGH), PLACES)


@pytest.mark.parametrize("ending", ["las", "laz"])
def test_a_cloud_of_points(tmp_path: Path, ending: str) -> None:
    """The ground's where any are classified, else all but noise; those of another projected system are transformed."""
    rows = np.concatenate([PLACES, PLACES + np.array([1.0, 1.0, 5.0]), BESIDE])
    path = las(tmp_path / f"all.{ending}", rows, [1, 1, 5, 7, 1])
    np.testing.assert_allclose(read_points(path, SWISS, LOW, HIGH), rows[:3], atol=1e-3)
    path = las(tmp_path / f"ground.{ending}", rows, [2, 2, 5, 7, 2])
    np.testing.assert_allclose(read_points(path, SWISS, LOW, HIGH), PLACES, atol=1e-3)
    other = np.stack([*transform(SWISS, "EPSG:32632", *PLACES[:, :2].T), PLACES[:, 2]], axis=1)
    path = las(tmp_path / f"utm.{ending}", other, [2, 2], CRS.from_epsg(32632).to_wkt())
    np.testing.assert_allclose(read_points(path, SWISS, LOW, HIGH), PLACES, atol=2e-3)
    for name, system in (("degrees", CRS.from_epsg(4326).to_wkt()), ("feet", in_feet(32632))):
        path = las(tmp_path / f"{name}.{ending}", other, [2, 2], system)
        refused(read_points, path, SWISS, LOW, HIGH, said="expected a projected coordinate system in metres")


def test_what_is_no_survey_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, text, said in (
        ("a.csv", "x,y\n1,2\n", "a.csv: expected a header with the columns `x`, `y`, `z`"),
        ("b.csv", "x,y,z\n1,2,3\n", "points within the box, 2600000 to 2600100, 1200000 to 1200050, got none"),
        ("c.xyz", "1 2\n", "c.xyz: expected rows of easting"),
        ("d.xyz", "2600010 1200020 nan\n", "d.xyz: expected finite elevations"),
    ):
        (tmp_path / name).write_text(text)
        refused(read_points, tmp_path / name, SWISS, LOW, HIGH, said=said)
    monkeypatch.setitem(sys.modules, "laspy", None)
    (tmp_path / "e.laz").write_bytes(b"LASF")
    refused(read_points, tmp_path / "e.laz", SWISS, LOW, HIGH, said="expected laspy, which reads it: pip install")
    monkeypatch.undo()
    pytest.importorskip("laspy")
    refused(read_points, tmp_path / "e.laz", SWISS, LOW, HIGH, said="e.laz: expected a readable LAS or LAZ")
