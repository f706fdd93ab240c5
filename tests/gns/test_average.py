"""The mean of the weights of models."""

from pathlib import Path

import pytest
import torch

from datasets import command_line
from gns.average import average
from gns.inference import members, models
from gns.model import checkpoint
from gns.model.settings import ModelSettings
from gns.model.simulator import Normalisation, Simulator
from tests.gns.conftest import NORMALISATION


def write(path: Path, settings: ModelSettings, seed: int, normalisation: Normalisation = NORMALISATION) -> Path:
    torch.manual_seed(seed)
    checkpoint.save(path, Simulator(settings, normalisation), {"command": f"train {seed}", "seed": seed})
    return path


def call(*models: Path, out: Path, flags: tuple[str, ...] = ()) -> int:
    return command_line.run(average, "python -m gns.average", [*map(str, models), "--out", str(out), *flags])


def test_the_weights_are_the_mean_and_the_rest_stays(settings: ModelSettings, tmp_path: Path) -> None:
    files = [write(tmp_path / f"{seed}.safetensors", settings, seed) for seed in range(3)]
    out = tmp_path / "mean" / "mean.safetensors"
    assert call(*files, out=out) == 0
    assert members(out) == []
    found = checkpoint.load(out)
    states = [checkpoint.load(file).simulator.state_dict() for file in files]
    for name, value in found.simulator.state_dict().items():
        torch.testing.assert_close(value, sum(state[name] for state in states) / 3)
    assert found.provenance["averaged"] == ["train 0", "train 1", "train 2"]
    assert found.provenance["seed"] == 2
    assert "gns.average" in found.provenance["command"]


def test_what_was_averaged_stays_beside_as_members(settings: ModelSettings, tmp_path: Path) -> None:
    files = [write(tmp_path / f"{seed}.safetensors", settings, seed) for seed in range(3)]
    out = tmp_path / "mean" / "mean.safetensors"
    assert call(*files, out=out, flags=("--members",)) == 0
    assert [path.name for path in members(out)] == [f"mean-{number}.safetensors" for number in (1, 2, 3)]
    assert models(out.parent) == [out]
    for file, member in zip(files, members(out), strict=True):
        own, kept = (checkpoint.load(path) for path in (file, member))
        assert own.provenance == kept.provenance
        state = kept.simulator.state_dict()
        assert all(torch.equal(value, state[name]) for name, value in own.simulator.state_dict().items())


def test_models_that_do_not_belong_together(
    settings: ModelSettings, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write(tmp_path / "model.safetensors", settings, 0)
    wider = write(tmp_path / "wider.safetensors", ModelSettings(**{**settings.__dict__, "width": 24}), 0)
    scaled = Normalisation(displacement=3e-3, acceleration=8e-4, friction_mean=0.6, friction_std=0.2)
    other = write(tmp_path / "other.safetensors", settings, 0, scaled)
    for found, said in (((file,), "at least two"), ((file, wider), "settings"), ((file, other), "normalisation")):
        assert call(*found, out=tmp_path / "mean.safetensors") == 2
        error = capsys.readouterr().err
        assert said in error
        assert len(error.splitlines()) == 1
    assert call(file, file, out=tmp_path / "mean.pt") == 2
    assert "mean.pt: --out: expected a name that ends in .safetensors" in capsys.readouterr().err
    assert not (tmp_path / "mean.safetensors").exists()
