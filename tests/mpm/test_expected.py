"""What work is expected to take: by the latest runs of its kind; a broken file of them is no failure."""

import json
from pathlib import Path

import pytest

from datasets.command_line import run
from datasets.library import read_scene
from mpm import expected as module
from mpm.expected import KEPT, expected, kind_of, learn, planned, spoken
from mpm.footprint import footprint
from mpm.run import command
from tests.breaking import SCENE

KIND = "2D f32 cpu"
MIB = 2**20


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where speeds are kept; every run counts."""
    monkeypatch.setenv("TALUS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(module, "SHORTEST", 0.0)
    return tmp_path / "cache" / "speeds.json"


def test_a_machine_that_is_not_known_is_said_to_be(file: Path) -> None:
    line = str(expected(KIND, 3.0e9, memory=300 * MIB))
    assert line == "expected: about 4.6 min, 300 MiB of memory; no such run was measured on this machine yet"
    assert not file.exists()


def test_the_next_run_takes_what_the_latest_ones_took(file: Path) -> None:
    learn(KIND, 2.0e7, 2.0, start=3.0)
    assert str(expected(KIND, 4.0e7, memory=300 * MIB)) == "expected: about 7 s, 300 MiB of memory"
    # On two processors 1.5 times the work; of another kind nothing is known.
    assert expected(KIND, 6.0e7, memory=0, processors=2, after=60.0).seconds == pytest.approx(66.0)
    assert not expected(KIND + " solids", 1.0, memory=0).measured
    # Two runs beside others do not count, nor does what was long ago.
    for seconds in (4.0, 4.0, 40.0, 4.0, 40.0):
        learn(KIND, 8.0e7, seconds, processors=2)
    assert expected(KIND, 1.0e7, memory=0, least=True).seconds == pytest.approx(3.0 + 1.0)
    assert str(expected(KIND, 1.0e7, memory=0, least=True)).startswith("expected: at least 4 s")
    assert len(json.loads(file.read_text())[KIND]["speed"]) == KEPT


def test_a_short_run_says_nothing(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SHORTEST", 0.2)
    learn(KIND, 1.0e7, 0.1)
    assert not file.exists()


@pytest.mark.parametrize(
    "text", ["{", "[1]", '{"2D f32 cpu": 3}', '{"2D f32 cpu": {"speed": ["a"]}}', '{"2D f32 cpu": {"speed": [0, -1]}}']
)
def test_a_broken_file_counts_as_none(file: Path, text: str) -> None:
    file.parent.mkdir()
    file.write_text(text)
    assert not expected(KIND, 1.0e7, memory=0).measured
    learn(KIND, 1.0e7, 1.0, start=1.0)
    assert expected(KIND, 1.0e7, memory=0).seconds == pytest.approx(2.0)


def test_a_folder_that_cannot_be_made_is_no_failure(file: Path) -> None:
    file.parent.write_text("a file")
    learn(KIND, 1.0e7, 1.0)
    assert not expected(KIND, 1.0e7, memory=0).measured


def test_runs_are_planned_from_scenes_alone() -> None:
    scenes = [read_scene("column-short-21"), read_scene("column-tall-42")]
    work, size = planned(scenes)
    plans = [footprint(scene) for scene in scenes]
    assert work == sum(plan.work for plan in plans)
    assert size == plans[1].bytes
    assert kind_of(read_scene("baffles-2"), until_rest=True, many=True) == "3D f32 cpu solids until rest many"
    assert [spoken(seconds) for seconds in (0.123, 119.0, 128.0, 9000.0)] == ["0.12 s", "120 s", "2.1 min", "2.5 h"]


def test_a_command_says_it_and_keeps_what_it_took(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "pile.toml").write_text(SCENE.replace("duration = 0.25", "duration = 0.1"))
    for end in ("; no such run was measured on this machine yet\n", " of memory\n"):
        assert run(command, "mpm.run", [str(tmp_path / "pile.toml"), "--out", str(tmp_path / "out")]) == 0
        line = capsys.readouterr().out.splitlines(keepends=True)[0]
        assert line.startswith("400 particles, 47 x 27 nodes, ")
        assert "; expected: about " in line
        assert line.endswith(end)
