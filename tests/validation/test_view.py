"""`python -m validation.view`: from a file, the folder of a run or of an inversion to a page; mistakes are one line."""

import json
from pathlib import Path

import pytest

from datasets.command_line import run
from tests.datasets.conftest import toy
from tests.datasets.exchange.test_page import parts
from tests.refusals import refused_by
from validation.view import command


def test_a_run_and_one_over_it(tmp_path: Path) -> None:
    for name in ("mpm", "gns"):
        toy(2).save(tmp_path / name / "trajectory.npz")
    assert run(command, "view", [str(tmp_path / "mpm")]) == 0
    page = tmp_path / "mpm" / "view.html"
    assert [entry["label"] for entry in parts(page)[0]["runs"]] == ["mpm"]
    other = tmp_path / "both.html"
    assert run(command, "view", [str(tmp_path / "mpm"), str(tmp_path / "gns"), "--out", str(other)]) == 0
    assert [entry["label"] for entry in parts(other)[0]["runs"]] == ["mpm", "gns"]


def test_an_inversion_shows_its_answer_over_what_was_observed(tmp_path: Path) -> None:
    purposes = (("check", 1.3), ("check", 1.0), ("wave", 0.9))
    runs = [{"purpose": p, "unknowns": {"a": value}, "file": f"mpm/{value}.npz"} for p, value in purposes]
    profile = {"x": [0.0, 0.5], "height": [0.1, 0.0]}
    found = {"unknowns": {"a": 0.95}, "certainty": {"a": 0.2}}
    result = found | {"mpm_runs": runs, "observation": {"front": 0.25, "profile": profile}}
    (tmp_path / "result.json").write_text(json.dumps(result))
    toy(2).save(tmp_path / "mpm" / "1.0.npz")
    toy(2, seed=1).save(tmp_path / "mpm" / "target-01-abc.npz")
    assert run(command, "view", [str(tmp_path)]) == 0
    head = parts(tmp_path / "view.html")[0]
    assert [entry["label"] for entry in head["runs"]] == ["MPM nearest to the answer", "observed"]
    assert head["observed"] == {"front": 0.25, **profile}


def test_a_folder_to_which_nobody_may_write_needs_another_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    toy(2).save(tmp_path / "trajectory.npz")
    monkeypatch.setattr("os.access", lambda path, mode: Path(path) != tmp_path)
    assert f"{tmp_path}: --out: expected a folder to write to" in refused_by(capsys, command, tmp_path)
    assert run(command, "view", [str(tmp_path), "--out", str(tmp_path / "pages" / "view.html")]) == 0


def test_a_mistake_is_one_line_that_names_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    toy(2).save(tmp_path / "flat.npz")
    toy(3).save(tmp_path / "deep.npz")
    for name, text in {"empty": '{"mpm_runs": []}', "foreign": '{"mpm_runs": [1]}'}.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "result.json").write_text(text)
    wrong = {"none.npz": ["none.npz"], "deep.npz": ["flat.npz", "deep.npz"]}
    wrong |= {f"{name}/result.json": [name] for name in ("empty", "foreign")}
    for file, paths in wrong.items():
        assert str(tmp_path / file) in refused_by(capsys, command, *(tmp_path / path for path in paths))
