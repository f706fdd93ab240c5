"""Training on flows with a formula, as a command: it resumes, stops when asked, and leaves a model that runs."""

import csv
import dataclasses
import errno
import itertools
import signal
from pathlib import Path
from typing import Any

import pytest
import torch

from datasets import command_line
from datasets.lock import locked
from datasets.scene import Baffle, Domain, Solid
from datasets.training.samples import Flow, load_flows
from datasets.trajectory import Trajectory
from gns import train as command
from gns.model import checkpoint
from gns.model.settings import ModelSettings
from gns.train import pick, train
from gns.training.budget import Clock
from gns.training.run_file import read
from gns.training.update import Run

TINY = [
    *("--width", "8", "--layers", "1", "--rounds", "1", "--grid-channels", "4", "--grid-layers", "1"),
    *("--threads", "1", "--unroll", "1", "--unroll", "2", "--validate-flows", "1", "--device", "cpu"),
]


def run(dataset: Path, out: Path, *flags: str) -> int:
    """Train a tiny model; the exit status."""
    return command_line.run(train, "train", [str(dataset), "--out", str(out), *TINY, *flags])


def rows(out: Path) -> list[dict[str, str]]:
    """The log, but for the minutes."""
    with (out / "log.csv").open() as file:
        return [{key: value for key, value in row.items() if key != "minutes"} for row in csv.DictReader(file)]


def same(one: Any, other: Any) -> bool:
    """Whether two contents of files are equal to the bit."""
    if isinstance(one, torch.Tensor):
        return torch.equal(one, other)
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    return bool(one == other)


def test_minutes_of_a_resumed_run_add_up(dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # A clock that goes on by a tenth of a second whenever it is read, however busy the machine is.
    ticks = itertools.count()
    monkeypatch.setattr(Clock, "now", lambda clock: next(ticks) / 10.0)
    assert run(dataset, tmp_path, "--minutes", "0.02") == 0
    first = read(tmp_path / "last.safetensors")[0]["position"]
    assert run(dataset, tmp_path, "--minutes", "0.04", "--resume") == 0
    second = read(tmp_path / "last.safetensors")[0]["position"]
    assert second["updates"] > first["updates"] > 0
    assert 3.0 > second["seconds"] >= 2.4 > 1.8 > first["seconds"] >= 1.2
    assert [int(row["updates"]) for row in rows(tmp_path)] == [first["updates"], second["updates"]]
    provenance = checkpoint.load(tmp_path / "best.safetensors").provenance
    assert (provenance["seed"], provenance["clock"], provenance["minutes"]) == (0, "wall", 0.04)
    assert "released at rest" in (tmp_path / "scores.md").read_text()


def test_a_training_can_begin_with_a_model(dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(dataset, tmp_path / "first", "--updates", "2") == 0
    model, other = (tmp_path / name / "best.safetensors" for name in ("first", "second"))
    # At hardly any learning rate it stays what it was.
    still = ("--learning-rate", "1e-30", "--final-learning-rate", "0")
    assert run(dataset, tmp_path / "second", "--updates", "1", "--begin", str(model), *still) == 0
    first, second = (checkpoint.load(path).simulator.state_dict() for path in (model, other))
    for name, weight in first.items():
        torch.testing.assert_close(second[name], weight)
    assert checkpoint.load(other).provenance["begin"]["updates"] == 2
    # No weight depends on the speed of rest.
    slower = ("--begin", str(model), "--rest-speed", "0.02", *still)
    assert run(dataset, tmp_path / "slower", "--updates", "1", *slower) == 0
    assert checkpoint.load(tmp_path / "slower" / "best.safetensors").simulator.settings.rest_speed == 0.02
    assert run(dataset, tmp_path / "third", "--updates", "1", "--begin", str(model), "--history", "2") == 2
    assert "other is history" in capsys.readouterr().err


@pytest.fixture(scope="module")
def unbroken(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Seven updates without a break, a validation after every third."""
    out = tmp_path_factory.mktemp("unbroken")
    torch.set_num_threads(1)
    assert run(dataset, out, "--updates", "7", "--validate-updates", "3") == 0
    assert [row["updates"] for row in rows(out)] == ["3", "6", "7"]
    return out


def broken(call: str, number: int, kind: signal.Signals, monkeypatch: pytest.MonkeyPatch) -> None:
    """Send this process a signal in the call `number` of an update or of a validation."""
    owner: Any = Run if call == "update" else command
    inner, calls = getattr(owner, call), []

    def outer(*given: Any, **flags: Any) -> Any:
        calls.append(None)
        if len(calls) == number:
            signal.raise_signal(kind)
            if call == "update":
                # As torchrun does, which hands on what the terminal has sent too.
                signal.raise_signal(kind)
        return inner(*given, **flags)

    monkeypatch.setattr(owner, call, outer)


@pytest.mark.parametrize(
    ("call", "number", "kind", "done"),
    [
        ("update", 3, signal.SIGTERM, 3),
        ("evaluate", 3, signal.SIGINT, 7),
    ],
)
def test_a_run_that_was_stopped_anywhere_ends_the_same(
    call: str, number: int, kind: signal.Signals, done: int,
    unbroken: Path, dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    flags = ("--updates", "7", "--validate-updates", "3")
    handlers = [signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)]
    with monkeypatch.context() as patch:
        broken(call, number, kind, patch)
        assert run(dataset, tmp_path, *flags) == 128 + kind
    assert [signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)] == handlers
    assert read(tmp_path / "last.safetensors")[0]["position"]["updates"] == done
    assert run(dataset, tmp_path, *flags, "--resume") == 0
    assert rows(tmp_path) == rows(unbroken)
    found, expected = (read(out / "last.safetensors") for out in (tmp_path, unbroken))
    for described, _ in (found, expected):
        for key in ("seconds", "validated_seconds", "log_size"):
            del described["position"][key]
    assert same(dict(enumerate(found)), dict(enumerate(expected)))
    assert same(*(checkpoint.read(out / "best.safetensors")[0] for out in (tmp_path, unbroken)))


def test_a_folder_that_another_process_writes_into_is_refused(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with locked(tmp_path):
        assert run(dataset, tmp_path, "--updates", "1") == 1
    assert "writes here since" in capsys.readouterr().err.splitlines()[-1]


def test_a_full_disk_is_the_last_line(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(tmp_path / "last.safetensors"))

    monkeypatch.setattr(Run, "save", full)
    assert run(dataset, tmp_path, "--updates", "1") == 1
    last = capsys.readouterr().err.splitlines()[-1]
    assert last == f"talus: {tmp_path / 'last.safetensors'}: No space left on device; what was finished is kept"


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
    flags = [str(tmp_path / "data"), "--out", str(tmp_path / "out"), *TINY, "--updates", "2", "--batch", "4"]
    flags[flags.index("--validate-flows") + 1] = "4"
    assert command_line.run(train, "train", flags) == 0
    assert len((tmp_path / "out" / "scores.md").read_text().splitlines()) > 2


def test_minutes_may_be_of_the_processor(dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gns.training.budget.time.process_time", iter(range(100)).__next__)
    assert run(dataset, tmp_path, "--minutes", "0.1", "--clock", "cpu") == 0
    assert checkpoint.load(tmp_path / "best.safetensors").provenance["clock"] == "cpu"
    assert 6.0 <= read(tmp_path / "last.safetensors")[0]["position"]["seconds"] < 12.0


def test_validation_flows_are_half_released(dataset: Path, settings: ModelSettings) -> None:
    released = load_flows(dataset, "train", step=settings.step, dimension=2, spacing=settings.cell)

    def names(flows: list[Flow]) -> list[str]:
        return [flow.name for flow in flows]

    assert names(pick(released, 2)) == [released[0].name, released[2].name]
    assert len(pick(released, 10)) == 4


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--resume"], "there is no last.safetensors"),
        (["--layers", "3"], "layers: expected a multiple of the 2 rounds"),
        (["--batch", "0"], "batch: expected a positive number"),
        (["--minutes", "0"], "minutes: expected a positive number"),
        (["--updates", "0"], "updates: expected an integer of at least 1"),
        (["--memory-gib", "-1"], "memory_gib: expected a number of at least 0"),
        (["--device", "cpu", "--mixed", "--updates", "1"], "mixed: expected a GPU"),
        (["--frames-per-step", "3", "--frame-dt", "0.001"], "expected frames 0.003 s apart"),
        (["--unroll", "40"], "expected at least 40 steps of 0.01 s, got 25"),
        (["--dimension", "3"], "expected a 3D trajectory"),
        (["--widht", "3"], "widht"),
    ],
)
def test_mistakes_are_named_in_one_line(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], flags: list[str], message: str
) -> None:
    assert command_line.run(train, "train", [str(dataset), "--out", str(tmp_path), *flags]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert message in lines[-1]
