"""The command that trains: what it leaves, what it begins with, and mistakes."""

import dataclasses
from pathlib import Path

import pytest
import torch

from datasets import command_line
from datasets.lock import locked
from datasets.scene import Baffle, Domain, Solid
from datasets.trajectory import Trajectory
from gns import card, checkpoint
from gns.train import train
from gns.training import LAST
from tests.gns.conftest import TINY


def run(dataset: Path, out: Path, *flags: str) -> int:
    """Train a tiny model; the exit status."""
    return command_line.run(train, "train", [str(dataset), "--out", str(out), *TINY, *flags])


def test_a_training_leaves_a_model_with_its_card(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(dataset, tmp_path, "--updates", "1") == 0
    assert "far too short" in capsys.readouterr().out
    found, best = card.read(tmp_path / "best.safetensors"), checkpoint.load(tmp_path / "best.safetensors")
    assert found is not None
    assert (found.data.scenes, found.data.updates) == ({dataset.name: 4}, 1)
    assert "released at rest" in (tmp_path / "scores.md").read_text() == found.scores
    assert (best.provenance["seed"], best.provenance["datasets"]) == (0, [str(dataset)])
    # The card again, of the folders that the model names.
    assert command_line.run(card.main, "gns.card", [str(tmp_path / "best.safetensors")]) == 0
    assert card.read(tmp_path / "best.safetensors") == found


def test_a_training_can_begin_with_a_model(dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(dataset, tmp_path / "first", "--updates", "1") == 0
    model, other = (tmp_path / name / "best.safetensors" for name in ("first", "second"))
    # At hardly any learning rate it stays what it was; its settings need not be repeated.
    begin = ("--updates", "1", "--begin", str(model), "--learning-rate", "1e-30", "--final-learning-rate", "0")
    flags = [str(dataset), "--out", str(tmp_path / "second"), "--unroll", "1", "--device", "cpu"]
    assert command_line.run(train, "train", [*flags, *begin]) == 0
    first, second = (checkpoint.load(path).simulator.state_dict() for path in (model, other))
    for name, weight in first.items():
        torch.testing.assert_close(second[name], weight)
    assert card.total_updates(checkpoint.load(other).provenance) == 2
    # No weight depends on the speed of rest.
    assert run(dataset, tmp_path / "slower", *begin, "--rest-speed", "0.02") == 0
    assert checkpoint.load(tmp_path / "slower" / "best.safetensors").simulator.settings.rest_speed == 0.02
    assert run(dataset, tmp_path / "third", *begin, "--history", "2") == 2
    assert "other is history" in capsys.readouterr().err


def test_a_folder_that_another_process_writes_into_is_refused(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with locked(tmp_path):
        assert run(dataset, tmp_path, "--updates", "1") == 1
    assert "writes here since" in capsys.readouterr().err.splitlines()[-1]


def test_flows_of_any_surroundings_train_together(dataset: Path, tmp_path: Path) -> None:
    column = Trajectory.load(dataset / "valid" / "0000.npz")
    ramp = Solid(kind="terrain", points=((0.0, 0.0), (0.3, 0.0), (0.6, 0.1)), friction=0.5)
    for name, change in (
        ("baffle", {"baffles": (Baffle(lower=(0.5, 0.0), size=(0.05, 0.1)),)}),
        ("slope", {"slope_deg": 10.0}),
        ("terrain", {"solids": (ramp,)}),
        ("wide", {"domain": Domain(size=(0.8, 0.4), cell=0.01)}),
    ):
        scene = dataclasses.replace(column.scene, **change)
        for split in ("train", "valid"):
            dataclasses.replace(column, scene=scene).save(tmp_path / "data" / split / f"{name}.npz")
    flags = [*TINY, "--updates", "2", "--batch", "4", "--shares", "3", "--shares", "1"]
    flags[flags.index("--validate-flows") + 1] = "4"
    both = [str(tmp_path / "data"), str(dataset), "--out", str(tmp_path / "out"), *flags]
    assert command_line.run(train, "train", both) == 0
    assert len((tmp_path / "out" / "scores.md").read_text().splitlines()) > 2


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--resume"], "there is no last.pt"),
        (["--shares", "1", "--shares", "1"], "shares: expected 1 shares, one of each dataset, got 2"),
        (["--minutes", "0"], "minutes: expected a positive number"),
        (["--frames-per-step", "3", "--frame-dt", "0.001"], "expected frames 0.003 s apart"),
        (["--unroll", "40"], "expected at least 40 steps of 0.01 s, got 25"),
    ],
)
def test_mistakes_are_named_in_one_line(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], flags: list[str], message: str
) -> None:
    assert command_line.run(train, "train", [str(dataset), "--out", str(tmp_path), *flags]) == 2
    assert message in capsys.readouterr().err.splitlines()[-1]


def test_a_run_of_another_model_or_a_broken_file_is_not_resumed(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(dataset, tmp_path, "--updates", "1") == 0
    assert run(dataset, tmp_path, "--updates", "2", "--resume", "--history", "2") == 2
    assert "expected the model settings that the run was begun with" in capsys.readouterr().err.splitlines()[-1]
    whole = (tmp_path / LAST).read_bytes()
    for broken in (whole[: len(whole) // 2], b"not a run"):
        (tmp_path / LAST).write_bytes(broken)
        assert run(dataset, tmp_path, "--updates", "2", "--resume") == 2
        assert "last.pt: expected the last.pt of a run" in capsys.readouterr().err.splitlines()[-1]
