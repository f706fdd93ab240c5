"""Tables as spreadsheets write them are read alike; what is no table ends in a line."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from datasets.exchange.spreadsheet import SEPARATORS, read_columns
from tests.refusals import refused

X, HEIGHT = [0.105, -0.25, 1200.0], [0.021, 0.0, 1.5e-3]


@pytest.mark.parametrize("separator", SEPARATORS)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_any_separator_and_end_of_line(tmp_path: Path, separator: str, end: str, mark: str) -> None:
    comma = separator != ","
    rows = [f"{x!r}{separator}{h!r}".replace(".", "," if comma else ".") for x, h in zip(X, HEIGHT, strict=True)]
    text = mark + end.join([f"x{separator}height", *rows[:1], separator, "", *rows[1:], "# end"])
    path = tmp_path / "table.csv"
    path.write_bytes(text.encode())
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        table = read_columns(path, ("x", "height"))
    np.testing.assert_array_equal(table["x"], X)
    np.testing.assert_array_equal(table["height"], HEIGHT)
    assert len(said) == int(comma)
    if comma:
        assert "decimal commas" in str(said[0].message)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "cp1252"])
def test_any_encoding_and_case(tmp_path: Path, encoding: str) -> None:
    """Spreadsheets write UTF-16 as their text with tabs, and Windows-1252 where nothing else is chosen."""
    path = tmp_path / "table.csv"
    path.write_bytes("X (m),Height,Prüfung\n0.105,0.021,größer\n-0.25,0.0,\n".encode(encoding))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        table = read_columns(path, ("x", "height"), others=True)
    np.testing.assert_array_equal([table["x"], table["height"]], [X[:2], HEIGHT[:2]])


@pytest.mark.filterwarnings("ignore:.*read with")
def test_units_in_the_header(tmp_path: Path) -> None:
    """What has its own unit is returned in that of the problem, whose factor makes metres of it."""
    path = tmp_path / "table.csv"
    path.write_text("sep=;\nTime;x [cm];height (mm);time [ms];;\n-;10,5;21;200;;\n-;1E1;0;400;;\n")
    table = read_columns(path, ("x", "height", "time"), others=True)
    np.testing.assert_allclose(table["x"], [0.105, 0.1])
    np.testing.assert_allclose(table["height"], [0.021, 0.0])
    np.testing.assert_allclose(table["time"], [0.2, 0.4])
    path.write_text("x [m],height\n1.0,20\n2.0,30\n")
    table = read_columns(path, ("x", "height"), metres=0.01)
    np.testing.assert_allclose(table["x"] * 0.01, [1.0, 2.0])
    np.testing.assert_allclose(table["height"] * 0.01, [0.2, 0.3])


@pytest.mark.filterwarnings("ignore:.*read with")
@pytest.mark.parametrize(
    ("unit", "pascal"), [("Pa", 1.0), ("hPa", 100.0), ("KPA", 1e3), ("kN/m2", 1e3), ("kN/m²", 1e3), ("bar", 1e5)]
)
def test_units_of_pressure(tmp_path: Path, unit: str, pascal: float) -> None:
    path = tmp_path / "gauge.csv"
    path.write_text(f"time,Pressure [{unit}]\n0.1,2.9\n", encoding="utf-8")
    assert read_columns(path, ("time", "pressure"))["pressure"] == pytest.approx([2.9 * pascal])


def test_what_is_no_unit_of_a_pressure_is_refused_with_those_that_are(tmp_path: Path) -> None:
    path = tmp_path / "gauge.csv"
    for unit in ("m", "mPa"):
        path.write_text(f"time,pressure [{unit}]\n0.1,2.9\n")
        said = f"a unit of `pressure`, one of Pa, hPa, kPa, MPa, bar, kN/m2, kN/m^2, kN/m², got pressure [{unit}]"
        refused(read_columns, path, ("time", "pressure"), said=said)


@pytest.mark.filterwarnings("ignore:.*read with")
@pytest.mark.parametrize(
    ("name", "units"),
    [
        ("discharge", {"m2/s": (2, 1.0), "m²/s": (2, 1.0), "m3/s": (3, 1.0), "m³/s": (3, 1.0), "l/s": (3, 0.001)}),
        ("impulse", {"N s/m": (2, 1.0), "kN s/m": (2, 1e3), "N s": (3, 1.0), "kNs": (3, 1e3)}),
    ],
)
def test_units_in_2d_are_per_metre_of_width(tmp_path: Path, name: str, units: dict[str, tuple[int, float]]) -> None:
    path = tmp_path / "table.csv"
    for unit, (dimension, factor) in units.items():
        path.write_text(f"time,{name} [{unit}]\n0,2\n", encoding="utf-8")
        assert read_columns(path, ("time", name), dimension=dimension)[name] == pytest.approx([2.0 * factor])
        said = f"per metre of width in 2D, got {name} [{unit}]"
        said = said if dimension == 3 else f"of the whole width in 3D, got {name} [{unit}]"
        refused(read_columns, path, ("time", name), dimension=5 - dimension, said=said)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "an empty file"),
        ("x,height\n", "none"),
        ("x\0,height\n1,2\n", "got x?, height"),
        ("x;height\n1,5;2\n1,5;2;3\n", "line 3"),
        ("x;height\n1.000,5;2\n", "line 2"),
        ("x,height\n1,5,2\n", "line 2"),
        ("x,height\n1,nan\n", "finite"),
        ("x [s],height\n1,2\n", "x [s]"),
        ("x [furlong],height\n1,2\n", "a unit of `x`, one of m, cm, mm, km, ft, in, got x [furlong]"),
        ("time [cm],x,height\n1,2,3\n", "time"),
        ("x,x,height\n1,2,3\n", "once"),
        ('x,"height\n1,2\n', "readable"),
    ],
)
def test_what_is_no_table_ends_in_a_line(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "table.csv"
    path.write_text(text)
    assert "table.csv" in str(refused(lambda: read_columns(path, ("x", "height"), ("time",)), said=said))
