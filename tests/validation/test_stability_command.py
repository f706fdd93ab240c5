"""`python -m validation.bench.stability`: green rows, red rows and runs that blow up, on the page and in the exit status."""

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from tqdm import tqdm

from datasets.command_line import WorkFailed, run
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from tests.validation.sand_at_rest import at_rest
from validation.bench.stability import __main__ as stability
from validation.bench.stability import expectations as expect
from validation.bench.stability import flows
from validation.bench.stability.case import Case
from validation.bench.stability.cases import CASES


def with_rows(monkeypatch: pytest.MonkeyPatch, *cases: Case) -> None:
    monkeypatch.setattr(stability, "CASES", cases)


def call(*arguments: str) -> int:
    return run(stability.command, "python -m validation.bench.stability", arguments)


POINT = next(case for case in CASES if case.name == "one-point")


def test_a_row_for_real(tmp_path: Path) -> None:
    assert call("one-point", "--out", str(tmp_path)) == 0
    page = (tmp_path / "stability.md").read_text()
    assert "All rows are green." in page
    assert re.search(r"\| `one-point` \| one material point falls \| green \| green \|", page)
    assert "## Red rows" not in page


def still(scenes: Sequence[Scene], *, precision: str, fields: bool, until_rest: bool) -> list[Trajectory]:
    """A solver in which nothing moves."""
    assert fields
    flows = [at_rest(scene) for scene in scenes]
    return [dataclasses.replace(flow, summary=flow.summary | {"precision": precision}) for flow in flows]


def test_a_red_row_is_told_with_what_a_smaller_step_and_a_finer_grid_make_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(flows, "simulate_each", still)
    with_rows(monkeypatch, dataclasses.replace(POINT, checks=(expect.lands,), cause="Something holds it."))
    assert call("--out", str(tmp_path)) == 1
    assert "talus: red rows: one-point" in capsys.readouterr().err
    page = (tmp_path / "stability.md").read_text()
    assert "| **red** | **red** |" in page
    (found,) = re.findall(
        r"\| `one-point` \| height at the end ≤ 0.5 cells \| \*\*(\d+\.\d+)\*\* \| \*\*\1\*\* \|", page
    )
    story = page.split("## Red rows")[1]
    assert "Something holds it." in story
    assert f"- f32: height at the end {found} cells (asked for ≤ 0.5)" in story
    assert f"- half the step, f64: height at the end {found} cells (asked for ≤ 0.5)" in story
    (finer,) = re.findall(r"- half the cell, f64: height at the end (\S+) cells \(asked for ≤ 0.5\)", story)
    assert float(finer) == pytest.approx(2.0 * float(found), abs=1.0)


def test_a_run_that_blows_up_is_red_and_the_others_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def simulate(scene: Scene, **options: Any) -> Trajectory | WorkFailed:
        if scene.material.friction_deg == 48.0:
            return WorkFailed("the simulation blew up at t = 0.1 s")
        return still([scene], **{**options, "fields": True, "until_rest": False})[0]

    def simulate_each(scenes: Sequence[Scene], **options: Any) -> list[Trajectory | WorkFailed]:
        return [simulate(scene, **options) for scene in scenes]

    monkeypatch.setattr(flows, "simulate_each", simulate_each)
    with_rows(
        monkeypatch, *(Case(name=name, what="nothing moves") for name in ("friction-48", "friction-12", "column-3d"))
    )
    assert call("--out", str(tmp_path)) == 1
    page = (tmp_path / "stability.md").read_text()
    assert "Red, and explained below: friction-48; all others are green." in " ".join(page.split())
    assert "- f64: the simulation blew up at t = 0.1 s" in page
    assert "- half the cell, f64: the simulation blew up at t = 0.1 s" in page
    assert re.search(r"\| `friction-12` \| nothing moves \| green \| green \|", page)


def test_scenes_run_in_the_kernels_that_they_would_get_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    batches: list[list[Scene]] = []

    def simulate_each(scenes: Sequence[Scene], **options: Any) -> list[Trajectory]:
        batches.append(list(scenes))
        return still(scenes, **options)

    monkeypatch.setattr(flows, "simulate_each", simulate_each)
    scenes = {case.name: case.scene for case in CASES}
    with tqdm(disable=True) as bar:
        assert list(flows.simulate_scenes(scenes, "f32", bar)) == list(scenes)
    assert 1 < len(batches) < len(scenes)
    for batch in batches:
        assert len({scene.dimension for scene in batch}) == 1
        assert len({bool(scene.baffles) for scene in batch}) == 1
        assert len({scene.damping > 0.0 for scene in batch}) == 1
        assert len({scene.volume_correction for scene in batch}) == 1
        assert len({scene.material.cohesion > 0.0 for scene in batch}) == 1
        assert len({len({scene.material_of(mass) for mass in scene.masses}) for scene in batch}) == 1


def test_a_row_brings_the_one_that_it_is_compared_with() -> None:
    assert [case.name for case in stability.chosen(("long-step",))] == ["column", "long-step"]
    assert stability.chosen(()) == list(CASES)


def test_an_unknown_row_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert call("one-pont") == 2
    assert capsys.readouterr().err == "talus: one-pont: expected the name of a row: did you mean 'one-point'?\n"
