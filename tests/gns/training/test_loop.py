"""A training learns, keeps as much as fits, goes on where it was, stops when asked, and names mistakes in a line."""

import itertools
import math
import shutil
import signal
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import torch

from datasets import Baffle, Domain, Solid, Trajectory, command_line
from gns import card, checkpoint
from gns.settings import ModelSettings, TrainingSettings
from gns.simulator import Simulator
from gns.train import train
from gns.training import loop
from gns.training.loop import LAST, Position
from gns.training.losses import UnrolledLoss, rollout_loss
from gns.training.samples import Sampler, flows_of
from tests.gns.conftest import NORMALISATION, TINY, rows, run_train


def test_the_loss_measures_positions_and_displacements() -> None:
    targets = torch.zeros(2, 1, 1)
    positions = torch.tensor([0.0, 1.0, 3.0]).view(3, 1, 1)
    # Errors over s = 2: positions 0.5 and 1.5 / 2 = 0.75, displacements 0.5 and 1.
    expected = (0.125 + 0.28125) / 2 + (0.125 + 0.5) / 2
    assert rollout_loss(positions, targets, 2.0).item() == pytest.approx(expected)


def test_half_precision_hardly_turns_the_gradient(settings: ModelSettings, dataset: Path) -> None:
    sampler = Sampler([flows_of(dataset, "train", settings)], settings, TrainingSettings(batch=2))
    batch, gradients = sampler.batch(4, np.random.default_rng(0)), []
    for half in (False, True):
        torch.manual_seed(0)
        simulator = Simulator(settings, NORMALISATION)
        simulator.network.half_precision = half
        slopes = torch.autograd.grad(UnrolledLoss(simulator, TrainingSettings())(batch), list(simulator.parameters()))
        gradients.append(torch.cat([slope.flatten() for slope in slopes]))
    assert torch.cosine_similarity(*gradients, dim=0) > 0.99


def run(dataset: Path, out: Path, *flags: str) -> int:
    """Train a tiny model; the exit status."""
    return run_train(dataset, out, *TINY, *flags)


def last(out: Path) -> dict[str, Any]:
    return dict(torch.load(out / LAST, weights_only=True))


def test_a_training_learns_and_leaves_a_model_with_its_card(dataset: Path, tmp_path: Path) -> None:
    flags = ("--updates", "120", "--validations", "2", "--learning-rate", "1e-2", "--average", "0.9", "--warmup", "5")
    assert run(dataset, tmp_path, *flags) == 0
    logged = rows(tmp_path)
    places = [float(row["front"]) + float(row["profile"]) for row in logged]
    # It begins as what bears its weight and stands.
    assert min(places[1:]) < 0.75 * places[0]
    scores = [place + float(row["thickness"]) for place, row in zip(places, logged, strict=True)]
    assert [float(row["score"]) for row in logged] == pytest.approx(scores, abs=1e-3)
    assert min(scores[1:]) < 0.75 * scores[0]
    assert {"height", "thickness", "overlap", "creep"} < logged[0].keys()
    assert last(tmp_path)["muon"]["state"]
    assert last(tmp_path)["adam"]["state"]
    model_card, best = card.read(tmp_path / "best.safetensors"), checkpoint.load(tmp_path / "best.safetensors")
    assert model_card.datasets[dataset.name].scenes == 4
    assert model_card.ranges["friction_deg"] == (20.0, 44.0)
    assert "released at rest" in (tmp_path / "scores.md").read_text() == model_card.scores
    assert (best.provenance["seed"], best.provenance["datasets"]) == (0, [str(dataset)])


def test_minutes_of_a_resumed_run_add_up(dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # A clock that goes on by a tenth of a second whenever it is read, however busy the machine is.
    ticks = itertools.count()
    monkeypatch.setattr("gns.training.loop.time.perf_counter", lambda: next(ticks) / 10.0)
    # Matplotlib reads it too.
    monkeypatch.setattr(loop, "draw", lambda *_: None)
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
    handlers = [signal.getsignal(signum) for signum in (signal.SIGINT, signal.SIGTERM)]
    inner, calls = getattr(loop, call), itertools.count(1)

    def outer(*given: Any, **named: Any) -> Any:
        if next(calls) == number:
            # Twice, as torchrun does, which hands on what the terminal has sent too.
            signal.raise_signal(signal.SIGTERM)
            signal.raise_signal(signal.SIGTERM)
        return inner(*given, **named)

    with monkeypatch.context() as patch:
        patch.setattr(loop, call, outer)
        assert run(dataset, tmp_path, *flags) == 128 + signal.SIGTERM
    assert [signal.getsignal(signum) for signum in (signal.SIGINT, signal.SIGTERM)] == handlers
    assert last(tmp_path)["position"]["updates"] == done
    assert run(dataset, tmp_path, *flags, "--resume") == 0
    assert [row["updates"] for row in rows(tmp_path)] == ["3", "6"]
    assert math.isfinite(last(tmp_path)["position"]["best"])


def test_a_gradient_that_is_not_finite_ends_the_run_and_leaves_an_older_file(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(dataset, tmp_path, "--updates", "2", "--validations", "1") == 0
    before = (tmp_path / LAST).read_bytes()
    monkeypatch.setattr("gns.training.losses.rollout_loss", lambda positions, *_: (positions * torch.nan).sum())
    assert run(dataset, tmp_path, "--updates", "3", "--resume") == 1
    assert "the gradient of update 3 is not finite; last.pt holds an earlier state" in capsys.readouterr().err
    assert (tmp_path / LAST).read_bytes() == before
    assert card.read(tmp_path / "best.safetensors").training.updates == 2


def test_a_training_can_begin_with_a_model(dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(dataset, tmp_path / "first", "--updates", "1") == 0
    model, other = (tmp_path / name / "best.safetensors" for name in ("first", "second"))
    # At hardly any learning rate it stays what it was; its settings need not be repeated.
    begin = ("--updates", "1", "--begin", str(model), "--learning-rate", "1e-30", "--final-learning-rate", "0")
    assert run_train(dataset, tmp_path / "second", "--unroll", "1", "--device", "cpu", *begin) == 0
    first, second = (checkpoint.load(path).simulator.state_dict() for path in (model, other))
    for name, weight in first.items():
        torch.testing.assert_close(second[name], weight)
    assert card.total_updates(checkpoint.load(other).provenance) == 2
    assert "second/best.safetensors: 1 updates, 2 with those before" in capsys.readouterr().out
    # The first row is the score of the weights that it begins with.
    logged = rows(tmp_path / "second")
    assert [(row["updates"], row["loss"] == "nan") for row in logged] == [("0", True), ("1", False)]
    assert logged[0]["score"] == logged[1]["score"]
    assert (tmp_path / "second" / "log.png").stat().st_size > 10_000
    # No weight depends on the speed of rest.
    assert run(dataset, tmp_path / "slower", *begin, "--rest-speed", "0.02") == 0
    assert checkpoint.load(tmp_path / "slower" / "best.safetensors").simulator.settings.rest_speed == 0.02
    assert run(dataset, tmp_path / "third", *begin, "--history", "2") == 2
    assert "these differ: history" in capsys.readouterr().err


def test_weights_that_no_update_improves_stay(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(dataset, tmp_path / "first", "--updates", "1") == 0
    model, scores = tmp_path / "first" / "best.safetensors", itertools.count()
    monkeypatch.setattr(loop, "validation_score", lambda _: float(next(scores)))
    flags = ("--begin", str(model), "--updates", "2", "--validations", "2", "--learning-rate", "1")
    assert run(dataset, tmp_path / "second", *flags) == 0
    assert "0 of 2 updates, 1 with those before" in capsys.readouterr().out
    assert [row["updates"] for row in rows(tmp_path / "second")] == ["0", "1", "2"]
    first, second = (checkpoint.load(tmp_path / name / "best.safetensors").simulator for name in ("first", "second"))
    for name, weight in first.state_dict().items():
        assert torch.equal(second.state_dict()[name], weight)


@pytest.mark.parametrize(("cost", "count"), [(0.1, 12), (10.0, 3), (60.0, 2)])
def test_validations_take_their_share_of_the_minutes(cost: float, count: int) -> None:
    """Four minutes of updates of a second; only the first and the last may take more."""
    position, training = Position(), TrainingSettings(minutes=4.0)
    while position.progress(training) < 1.0 or position.due(training):
        if position.due(training):
            position.validated.append(cost)
            position.seconds += cost
            position.scored = position.seconds, position.updates
        else:
            position.seconds += 1.0
            position.updates += 1
    assert len(position.validated) == count
    assert count == 2 or sum(position.validated) <= 0.15 * 240.0
    # With a number of updates their times do not depend on the machine.
    later = Position(seconds=60.0, updates=4, scored=(30.0, 2), validated=[1e3])
    assert later.due(replace(training, updates=24))
    assert not later.due(training)


def test_flows_of_any_surroundings_train_together(dataset: Path, tmp_path: Path) -> None:
    column = Trajectory.load(dataset / "valid" / "0000.npz")
    ramp = Solid(kind="terrain", points=((0.0, 0.0), (0.3, 0.0), (0.6, 0.1)), friction=0.5)
    for name, change in (
        ("baffle", {"baffles": (Baffle(lower=(0.5, 0.0), size=(0.05, 0.1)),)}),
        ("slope", {"slope_deg": 10.0}),
        ("terrain", {"solids": (ramp,)}),
        ("wide", {"domain": Domain(size=(0.8, 0.4), cell=0.01)}),
    ):
        for split in ("train", "valid"):
            flow = replace(column, scene=replace(column.scene, **change))
            flow.save(tmp_path / "data" / split / f"{name}.npz")
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
        (["--seed", "-1"], "--seed: expected an integer from 0 to 2^62, got -1"),
        (["--minutes", "0"], "minutes: expected a positive number"),
        (["--frames-per-step", "3", "--frame-dt", "0.001"], "expected frames 0.003 s apart"),
        (["--unroll", "40"], "expected at least 40 steps of 0.01 s, got 25"),
    ],
)
def test_mistakes_are_named_in_one_line(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], flags: list[str], message: str
) -> None:
    assert run_train(dataset, tmp_path, *flags) == 2
    assert message in capsys.readouterr().err.splitlines()[-1]


def test_a_training_is_not_lost_to_another(dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / LAST).write_bytes(b"of an earlier training")
    assert run_train(dataset, tmp_path, *TINY, "--updates", "1") == 2
    assert f"{tmp_path}: holds a training: --resume continues last.pt" in capsys.readouterr().err.splitlines()[-1]
    assert (tmp_path / LAST).read_bytes() == b"of an earlier training"


def test_no_other_model_or_file_is_resumed(dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(dataset, tmp_path, "--updates", "1") == 0
    assert run(dataset, tmp_path, "--updates", "2", "--resume", "--history", "2") == 2
    assert "expected the model settings that the run was begun with" in capsys.readouterr().err.splitlines()[-1]
    whole = (tmp_path / LAST).read_bytes()
    for broken in (whole[: len(whole) // 2], b"not a run"):
        (tmp_path / LAST).write_bytes(broken)
        assert run(dataset, tmp_path, "--updates", "2", "--resume") == 2
        assert "last.pt: expected the last.pt of a run" in capsys.readouterr().err.splitlines()[-1]


def test_no_other_flows_are_resumed(dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Scores on other held-out flows do not compare."""
    data, out = shutil.copytree(dataset, tmp_path / dataset.name), tmp_path / "out"
    assert run(dataset, out, "--updates", "1") == 0
    # The same flows in another place.
    assert run(data, out, "--updates", "2", "--resume") == 0
    (data / "valid" / "0001.npz").unlink()
    for other, begin in ((data, ()), (dataset, ("--begin", str(out / "best.safetensors")))):
        assert run(other, out, "--updates", "3", "--resume", *begin) == 2
        said = capsys.readouterr().err.splitlines()[-1]
        assert "expected the flows and the --begin that the run was begun with" in said
    assert last(out)["position"]["updates"] == 2


def test_the_shortest_training_leaves_a_model(dataset: Path, tmp_path: Path) -> None:
    assert run(dataset, tmp_path, "--minutes", "1e-9") == 0
    assert card.read(tmp_path / "best.safetensors").training.updates == 1


def test_validation_flows_are_of_every_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    """Kinds alternate in a dataset, and every fifth flow would be of one of them."""
    flows = [SimpleNamespace(positions=range(99), number=number) for number in range(100)]
    monkeypatch.setattr(loop, "flows_of", lambda *_, **__: flows)
    _, chosen = loop.load([Path("data")], ModelSettings(), TrainingSettings(validate_flows=40), progress=False)
    numbers = [flow.number for flow in cast("list[SimpleNamespace]", chosen)]
    assert len(set(numbers)) == 40
    assert {number % 5 for number in numbers} == set(range(5))
