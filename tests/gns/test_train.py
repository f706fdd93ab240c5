"""Training on flows with a formula: it learns, resumes, and leaves a model that runs."""

import csv
from pathlib import Path

import numpy as np
import pytest
import torch

from datasets import command_line
from datasets.errors import InputError
from datasets.samples import load_flows
from gns import checkpoint
from gns.objective import Curriculum, statistics
from gns.settings import ModelSettings
from gns.simulator import Simulator
from gns.train import Run, TrainingSettings, pick, train
from tests.gns.conftest import NORMALISATION

TINY = [
    *("--width", "8", "--layers", "1", "--rounds", "1", "--grid-channels", "4", "--grid-layers", "1"),
    *("--threads", "1", "--unroll", "1", "--unroll", "2"),
]


def test_the_loss_falls(dataset: Path, settings: ModelSettings) -> None:
    torch.manual_seed(0)
    flows = load_flows(dataset, "train", step=settings.step, dimension=2)
    run = Run(Simulator(settings, statistics(flows)), TrainingSettings(warmup=5, learning_rate=1e-2), seed=0)
    run.set_learning_rate(0.0)
    losses = [run.update(Curriculum([flows], settings), (0.6, 0.4), 9.81, steps=2) for _ in range(60)]
    assert np.mean(losses[-10:]) < 0.5 * np.mean(losses[:5])


def test_a_run_resumes_where_it_was(dataset: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    begin = ["--out", str(out), "--validate-flows", "1", *TINY]
    assert command_line.run(train, "train", [str(dataset), "--minutes", "0.02", *begin]) == 0
    first = checkpoint.read(out / "last.pt")
    assert command_line.run(train, "train", [str(dataset), "--minutes", "0.04", "--resume", *begin]) == 0
    second = checkpoint.read(out / "last.pt")
    assert second["updates"] > first["updates"] > 0
    assert second["elapsed"] >= 2.4 > first["elapsed"] >= 1.2
    with (out / "log.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["updates"]) for row in rows] == [first["updates"], second["updates"]]
    model = checkpoint.load(out / "best.pt")
    assert model.provenance["seed"] == 0
    assert "released at rest" in (out / "scores.md").read_text()


def test_everything_of_a_run_is_brought_back(dataset: Path, settings: ModelSettings, tmp_path: Path) -> None:
    flows = load_flows(dataset, "train", step=settings.step, dimension=2)
    curriculum = Curriculum([flows], settings)

    def begin() -> Run:
        torch.manual_seed(0)
        return Run(Simulator(settings, statistics(flows)), TrainingSettings(), seed=0)

    unbroken, broken = begin(), begin()
    for run in (unbroken, broken):
        run.update(curriculum, (0.6, 0.4), 9.81, steps=1)
    broken.save(tmp_path / "last.pt")
    resumed = begin()
    resumed.resume(tmp_path / "last.pt")
    losses = [run.update(curriculum, (0.6, 0.4), 9.81, steps=1) for run in (unbroken, resumed)]
    assert losses[0] == losses[1]
    for one, other in zip(unbroken.average.parameters(), resumed.average.parameters(), strict=True):
        assert torch.equal(one, other)


def test_validation_flows_are_half_released(dataset: Path, settings: ModelSettings) -> None:
    released = load_flows(dataset, "train", step=settings.step, dimension=2)
    assert pick(released, 2) == [released[0], released[2]]
    assert len(pick(released, 10)) == 4


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--resume"], "there is no last.pt"),
        (["--layers", "3"], "layers: expected a multiple of the 2 rounds"),
        (["--batch", "0"], "batch: expected a positive number"),
        (["--frames-per-step", "3", "--frame-dt", "0.001"], "expected frames 0.003 s apart"),
        (["--dimension", "3"], "expected a 3D trajectory"),
        (["--widht", "3"], "widht"),
    ],
)
def test_mistakes_are_told_in_one_line(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], flags: list[str], message: str
) -> None:
    assert command_line.run(train, "train", [str(dataset), "--out", str(tmp_path), *flags]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert message in lines[-1]


def test_a_run_of_another_model_is_not_resumed(settings: ModelSettings, simulator: Simulator, tmp_path: Path) -> None:
    Run(simulator, TrainingSettings(), seed=0).save(tmp_path / "last.pt")
    other = Simulator(ModelSettings(width=8), NORMALISATION)
    with pytest.raises(InputError, match="settings that the run was begun with"):
        Run(other, TrainingSettings(), seed=0).resume(tmp_path / "last.pt")
