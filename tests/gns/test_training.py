"""A training learns, keeps as much as fits, goes on where it was, and stops when asked."""

import itertools
import math
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from datasets import command_line
from gns import checkpoint, training
from gns.samples import Sampler, flows_of
from gns.settings import ModelSettings, TrainingSettings
from gns.simulator import Simulator
from gns.train import train
from gns.training import LAST, UnrolledLoss, learning_rate, rollout_loss, unrolled_steps
from tests.gns.conftest import NORMALISATION, TINY, rows


def test_the_loss_measures_positions_and_displacements() -> None:
    targets = torch.zeros(2, 1, 1)
    positions = torch.tensor([0.0, 1.0, 3.0]).view(3, 1, 1)
    # Errors over s = 2: positions 0.5 and 1.5 / 2 = 0.75, displacements 0.5 and 1.
    expected = (0.125 + 0.28125) / 2 + (0.125 + 0.5) / 2
    assert rollout_loss(positions, targets, 2.0).item() == pytest.approx(expected)


def test_the_schedules_of_steps_and_rate() -> None:
    assert [unrolled_steps((1, 2, 2, 8), progress) for progress in (0.0, 0.24, 0.26, 0.7, 0.8, 1.0)] == [
        1, 1, 2, 2, 8, 8,
    ]  # fmt: skip
    settings = TrainingSettings(warmup=5, learning_rate=1e-2)
    assert learning_rate(settings, 0.0, 0) == pytest.approx(1e-2 / 5)
    assert learning_rate(settings, 0.0, 100) == pytest.approx(1e-2)
    assert learning_rate(settings, 1.0, 100) == pytest.approx(1e-5)


def test_what_fits_into_the_memory_is_kept_and_the_rest_makes_no_difference(
    settings: ModelSettings, dataset: Path
) -> None:
    sampler = Sampler([flows_of(dataset, "train", settings)], settings, TrainingSettings(batch=2))
    batch, gradients = sampler.batch(4, np.random.default_rng(0)), []
    for gib in (1e-9, 2e-3, 1.0):
        torch.manual_seed(0)
        simulator = Simulator(settings, NORMALISATION)
        UnrolledLoss(simulator, TrainingSettings(memory_gib=gib))(batch).backward()
        gradients.append([parameter.grad for parameter in simulator.parameters()])
    for others in gradients[1:]:
        assert all(torch.equal(one, other) for one, other in zip(gradients[0], others, strict=True))


def run(dataset: Path, out: Path, *flags: str) -> int:
    """Train a tiny model; the exit status."""
    return command_line.run(train, "train", [str(dataset), "--out", str(out), *TINY, *flags])


def last(out: Path) -> dict[str, Any]:
    found: dict[str, Any] = torch.load(out / LAST, weights_only=True)
    return found


def test_a_training_learns(dataset: Path, tmp_path: Path) -> None:
    flags = ("--updates", "60", "--validations", "3", "--learning-rate", "1e-2", "--warmup", "5")
    assert run(dataset, tmp_path, *flags) == 0
    scores = [float(row["score"]) for row in rows(tmp_path)]
    assert scores[-1] < 0.5 * scores[0]
    assert last(tmp_path)["muon"]["state"]
    assert last(tmp_path)["adam"]["state"]


def test_minutes_of_a_resumed_run_add_up(dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # A clock that goes on by a tenth of a second whenever it is read, however busy the machine is.
    ticks = itertools.count()
    monkeypatch.setattr("gns.training.time.perf_counter", lambda: next(ticks) / 10.0)
    assert run(dataset, tmp_path, "--minutes", "0.02") == 0
    first = last(tmp_path)["position"]
    assert run(dataset, tmp_path, "--minutes", "0.04", "--resume") == 0
    second = last(tmp_path)["position"]
    assert second["updates"] > first["updates"] > 0
    assert 3.0 > second["seconds"] >= 2.4 > 1.8 > first["seconds"] >= 1.2
    assert {first["updates"], second["updates"]} <= {int(row["updates"]) for row in rows(tmp_path)}


@pytest.mark.parametrize(("call", "number", "done"), [("learning_rate", 3, 3), ("evaluate", 1, 3)])
def test_a_run_that_was_stopped_goes_on(
    call: str, number: int, done: int, dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flags = ("--updates", "6", "--validations", "2")
    handlers = [signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)]
    inner, calls = getattr(training, call), itertools.count(1)

    def outer(*given: Any, **named: Any) -> Any:
        if next(calls) == number:
            # Twice, as torchrun does, which hands on what the terminal has sent too.
            signal.raise_signal(signal.SIGTERM)
            signal.raise_signal(signal.SIGTERM)
        return inner(*given, **named)

    with monkeypatch.context() as patch:
        patch.setattr(training, call, outer)
        assert run(dataset, tmp_path, *flags) == 128 + signal.SIGTERM
    assert [signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)] == handlers
    assert last(tmp_path)["position"]["updates"] == done
    assert run(dataset, tmp_path, *flags, "--resume") == 0
    assert [row["updates"] for row in rows(tmp_path)] == ["3", "6"]
    assert math.isfinite(last(tmp_path)["position"]["best"])


def test_a_gradient_that_is_not_finite_ends_the_run_and_leaves_an_older_file(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(dataset, tmp_path, "--updates", "2", "--validations", "1") == 0
    before = (tmp_path / LAST).read_bytes()
    monkeypatch.setattr(training, "rollout_loss", lambda positions, *_: (positions * torch.nan).sum())
    assert run(dataset, tmp_path, "--updates", "3", "--resume") == 1
    assert "the gradient of update 3 is not finite; last.pt is older and whole" in capsys.readouterr().err
    assert (tmp_path / LAST).read_bytes() == before
    assert checkpoint.load(tmp_path / "best.safetensors").provenance["log"]["updates"] == 2
