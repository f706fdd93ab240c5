"""`python -m validation.bench stability`: green rows, red rows and runs that blow up, on the page and in the status."""

import dataclasses
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datasets.command_line import WorkFailed
from datasets.material import Material
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from mpm import Recording, exact_solutions
from tests.validation.bench.sand_at_rest import at_rest, scene_of
from validation.bench.__main__ import main
from validation.bench.stability import bench as page
from validation.bench.stability import critical_height, verdict
from validation.bench.stability import expectations as expect
from validation.bench.stability.rows import ROWS, Row

POINT = next(row for row in ROWS if row.name == "one-point")


def with_rows(monkeypatch: pytest.MonkeyPatch, *rows: Row) -> None:
    monkeypatch.setattr(page, "ROWS", rows)
    monkeypatch.setattr(page, "CUTS", ())


def call(*flags: str) -> int:
    return main(["stability", *flags])


def still(scenes: Sequence[Scene], *, precision: str, record: Recording, **_: Any) -> list[Trajectory]:
    """A solver in which nothing moves."""
    assert "pressure" in record.fields
    flows = [at_rest(scene) for scene in scenes]
    return [dataclasses.replace(flow, summary=flow.summary | {"precision": precision}) for flow in flows]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::UserWarning")  # A thin body, a block that nothing holds: rows that warn.
def test_rows_for_real(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("--quick", "--out", str(tmp_path)) == 0
    text = (tmp_path / "stability.md").read_text()
    assert f"{len(page.QUICK)} of {len(page.QUICK)} rows are green." in text
    assert "rows are green" in capsys.readouterr().out
    assert re.search(r"\| `one-point` +\| one material point falls +\| green +\| green", text)
    assert "## Red" not in text


def test_a_red_row_shows_its_findings_at_a_smaller_step_and_on_a_finer_grid(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(verdict, "simulate_each", still)
    with_rows(monkeypatch, dataclasses.replace(POINT, checks=(expect.lands,), cause="Something holds it."))
    assert call("--out", str(tmp_path)) == 1
    assert "talus: red rows: one-point" in capsys.readouterr().err
    text = (tmp_path / "stability.md").read_text()
    assert "0 of 1 rows are green; red: one-point." in text
    assert re.search(r"\*\*red\*\* +\| \*\*red\*\*", text)
    (found,) = re.findall(r"\| height at the end ≤ 0.5 cells +\| \*\*(\d+\.\d+)\*\* +\| \*\*\1\*\*", text)
    story = text.split("## Red: one-point")[1]
    assert "Something holds it." in story
    assert f"- f32: height at the end {found} cells (required ≤ 0.5)" in story
    assert f"- half the step, f64: height at the end {found} cells (required ≤ 0.5)" in story
    (finer,) = re.findall(r"- half the cell, f64: height at the end (\S+) cells \(required ≤ 0.5\)", story)
    assert float(finer) == pytest.approx(2.0 * float(found), abs=1.0)


def test_a_run_that_blows_up_is_red_and_the_others_are_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def simulate_each(scenes: Sequence[Scene], **options: Any) -> list[Trajectory | WorkFailed]:
        return [
            WorkFailed("the simulation blew up at t = 0.1 s")
            if scene.material.friction_deg == 48.0
            else still([scene], **options)[0]
            for scene in scenes
        ]

    monkeypatch.setattr(verdict, "simulate_each", simulate_each)
    with_rows(
        monkeypatch, *(Row(name=name, what="nothing moves") for name in ("friction-48", "friction-12", "column-3d"))
    )
    assert call("--out", str(tmp_path)) == 1
    text = (tmp_path / "stability.md").read_text()
    assert "2 of 3 rows are green; red: friction-48." in text
    assert "- f64: the simulation blew up at t = 0.1 s" in text
    assert "- half the cell, f64: the simulation blew up at t = 0.1 s" in text
    assert re.search(r"\| `friction-12` +\| nothing moves +\| green +\| green", text)


def test_a_row_brings_the_one_that_it_is_compared_with() -> None:
    assert [row.name for row in page.choose(("long-step",))] == ["column", "long-step"]
    assert page.choose(()) == list(ROWS)


def test_an_unknown_row_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("--rows", "one-pont", "--out", str(tmp_path)) == 2
    assert capsys.readouterr().err == "talus: one-pont: expected the name of a row: did you mean 'one-point'?\n"


CUT = scene_of(material=Material(friction_deg=30.0, cohesion=1000.0))


@pytest.mark.parametrize("critical", [0.6, 0.95, 1.2])
def test_bisection_finds_what_fails(critical: float) -> None:
    assert 0.2 / exact_solutions.critical_height(critical_height.at_ratio(CUT, critical)) == pytest.approx(critical)
    found = critical_height.bracket(CUT, lambda scene: 0.2 / exact_solutions.critical_height(scene) > critical)
    assert found.holds <= critical <= found.fails <= critical_height.WITHIN * found.holds


@pytest.mark.parametrize(("friction_deg", "raised"), [(0.0, 0.0548), (30.0, 0.0720)])
def test_little_tension_raises_the_critical_height(friction_deg: float, raised: float) -> None:
    """The least over the width b of gamma H = 2 c t + gamma b t / 2 + T t (H / b - t)."""
    t = math.tan(math.radians(45.0 + 0.5 * friction_deg))
    found = exact_solutions.stability_number(friction_deg, 0.003)
    assert found == pytest.approx(2.0 * t * (1.0 + raised), rel=1e-4)
    widths = np.linspace(0.01, 0.2, 2000) * found
    slices = (2.0 * t + 0.5 * widths * t - 0.003 * t**2) / (1.0 - 0.003 * t / widths)
    assert found == pytest.approx(slices.min(), rel=1e-6)
    assert exact_solutions.stability_number(friction_deg, 0.0) == pytest.approx(2.0 * t)
    assert critical_height.bracket(CUT, lambda scene: True).tension == pytest.approx(0.003)
    assert math.isnan(critical_height.bracket(CUT, lambda scene: True).holds)
    assert math.isnan(critical_height.bracket(CUT, lambda scene: False).fails)
