"""The mean of the weights of models."""

from pathlib import Path

import pytest
import torch

from datasets import command_line
from gns.average import average
from gns.model import checkpoint
from gns.model.settings import ModelSettings
from gns.model.simulator import Normalisation, Simulator
from tests.gns.conftest import NORMALISATION


def write(path: Path, settings: ModelSettings, seed: int, normalisation: Normalisation = NORMALISATION) -> Path:
    torch.manual_seed(seed)
    checkpoint.save(path, Simulator(settings, normalisation), {"command": f"train {seed}", "seed": seed})
    return path


def call(*models: Path, out: Path) -> int:
    return command_line.run(average, "python -m gns.average", [*map(str, models), "--out", str(out)])


def test_the_weights_are_the_mean_and_the_rest_stays(settings: ModelSettings, tmp_path: Path) -> None:
    files = [write(tmp_path / f"{seed}.pt", settings, seed) for seed in range(3)]
    assert call(*files, out=tmp_path / "mean.pt") == 0
    found = checkpoint.load(tmp_path / "mean.pt")
    states = [checkpoint.load(file).simulator.state_dict() for file in files]
    for name, value in found.simulator.state_dict().items():
        torch.testing.assert_close(value, sum(state[name] for state in states) / 3)
    assert found.provenance["averaged"] == ["train 0", "train 1", "train 2"]
    assert found.provenance["seed"] == 2
    assert "gns.average" in found.provenance["command"]


def test_models_that_do_not_belong_together(
    settings: ModelSettings, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write(tmp_path / "model.pt", settings, 0)
    wider = write(tmp_path / "wider.pt", ModelSettings(**{**settings.__dict__, "width": 24}), 0)
    scaled = Normalisation(displacement=3e-3, acceleration=8e-4, friction_mean=0.6, friction_std=0.2)
    other = write(tmp_path / "other.pt", settings, 0, scaled)
    for models, said in (((file,), "at least two"), ((file, wider), "settings"), ((file, other), "normalisation")):
        assert call(*models, out=tmp_path / "mean.pt") == 2
        error = capsys.readouterr().err
        assert said in error
        assert len(error.splitlines()) == 1
    assert not (tmp_path / "mean.pt").exists()
