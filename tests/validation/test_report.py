"""`report.md` of a loop, for every kind of problem."""

from pathlib import Path

import pytest
from matplotlib.image import imread

from datasets.exchange.vtk import SERIES
from inverse.report import pictures
from inverse.report.markdown import quantity
from inverse.result import Verdict
from tests.validation import reporting
from validation.loop import report as loop_report


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is drawn does not depend on the resolution, the seconds do."""
    monkeypatch.setattr(pictures, "RESOLUTION", 40)


@pytest.mark.parametrize("kind", ["front", "profile", "layers", "toe", "design"])
def test_a_report_tells_all(tmp_path: Path, kind: str) -> None:
    solved = reporting.make(kind, tmp_path)
    loop_report.write(solved, tmp_path)
    text = (tmp_path / "report.md").read_text()
    result = solved.result
    assert text.startswith(f"# {kind}: confirmed")
    assert "The MPM confirms" in text
    for name, value in result.unknowns.items():
        (row,) = [line for line in text.splitlines() if line.startswith(f"| `{name}` |") and "**" in line]
        assert quantity(name, value) in row
        assert result.certainty is not None
        assert f"± {quantity(name, result.certainty[name])}" in row
        if result.target.truth:
            assert quantity(name, result.target.truth[name]) in row
    expected = {"deposit.png", "iterations.png", "stages.png"} | (
        {"unknowns.png"} if len(result.unknowns) > 2 else set()
    )
    assert {path.name for path in tmp_path.glob("*.png")} == expected
    for picture in expected:
        assert f"]({picture})" in text
        assert imread(tmp_path / picture)[..., :3].std() > 0.01
    assert ("may move by" in text) == (kind == "design")
    assert "nan" not in text


@pytest.mark.parametrize("kind", ["front", "toe"])
def test_nothing_has_to_be_known(tmp_path: Path, kind: str) -> None:
    solved = reporting.make(kind, tmp_path, verdict=Verdict.UNREACHABLE, known=False, certain=False)
    loop_report.write(solved, tmp_path)
    text = (tmp_path / "report.md").read_text()
    assert (tmp_path / "deposit.png").exists()
    assert text.startswith(f"# {kind}: unreachable")
    assert "Nothing within the bounds reaches the target" in text
    assert "What it is worth" not in text
    assert "truth" not in text


def test_what_an_observation_cannot_tell_is_told(tmp_path: Path) -> None:
    text = "\n".join(loop_report.document(reporting.make("profile", tmp_path, told=False), tmp_path))
    assert "**Not told**: `cohesion` up while `friction_deg` down, only to ± 90 % of the range" in text
    assert "From other starts" in text


def test_a_verdict_is_never_prettier_than_it_is(tmp_path: Path) -> None:
    solved = reporting.make("toe", tmp_path, verdict=Verdict.UNCONFIRMED)
    text = "\n".join(loop_report.document(solved, tmp_path))
    assert "The MPM confirms" not in text
    assert "The MPM does not confirm" in text
    assert "mm; at most 16 mm is allowed" in text
    assert "unconfirmed" in loop_report.summary(solved.result)


@pytest.mark.parametrize("kind", ["runout", "angles"])
def test_other_kinds_in_words(tmp_path: Path, kind: str) -> None:
    solved = reporting.make(kind, tmp_path)
    text = "\n".join(loop_report.document(solved, tmp_path))
    assert {"runout": "% of the runout", "angles": "root mean square over the points"}[kind] in text
    assert len([line for line in text.splitlines() if "±" in line]) >= 2 * len(solved.result.unknowns)


def test_the_final_run_for_paraview(tmp_path: Path) -> None:
    loop_report.write(reporting.make("toe", tmp_path), tmp_path, vtk=True)
    assert f"`vtk/{SERIES}`" in (tmp_path / "report.md").read_text()
    assert (tmp_path / "vtk" / SERIES).exists()
    assert (tmp_path / "vtk" / "baffles.vtp").exists()
