"""Models on disk: whole or refused in one line."""

import dataclasses
from pathlib import Path

import pytest
import torch

from datasets.errors import InputError
from gns.model import checkpoint
from gns.model.simulator import Simulator
from tests.gns.conftest import NORMALISATION, Cloud


def test_a_model_comes_back_without_flags(lively: Simulator, cloud: Cloud, tmp_path: Path) -> None:
    file = tmp_path / "model.pt"
    checkpoint.save(file, lively, {"seed": 3, "datasets": ["a"]})
    model = checkpoint.load(file)
    assert model.simulator.settings == lively.settings
    assert model.provenance == {"seed": 3, "datasets": ["a"]}
    assert model.simulator.acceleration_scale.item() == pytest.approx(NORMALISATION.acceleration)
    state, conditions = cloud()
    with torch.no_grad():
        assert torch.equal(model.simulator(state, conditions).positions, lively(state, conditions).positions)


def test_missing_truncated_and_foreign_files_are_input_errors(lively: Simulator, tmp_path: Path) -> None:
    file = tmp_path / "model.pt"
    checkpoint.save(file, lively, {})
    whole = file.read_bytes()
    for content in (whole[: len(whole) // 2], whole[:10], b"", b"not a model"):
        file.write_bytes(content)
        with pytest.raises(InputError, match=r"model\.pt: expected whole weights"):
            checkpoint.load(file)
    with pytest.raises(InputError, match="there is no such file"):
        checkpoint.load(tmp_path / "absent.pt")
    torch.save({"weights": torch.zeros(1)}, file)
    with pytest.raises(InputError, match="format"):
        checkpoint.load(file)


def test_weights_of_another_shape_are_refused(lively: Simulator, tmp_path: Path) -> None:
    file = tmp_path / "model.pt"
    settings = dataclasses.asdict(lively.settings) | {"width": 8}
    torch.save(
        {"format": checkpoint.FORMAT, "settings": settings, "state": lively.state_dict(), "provenance": {}}, file
    )
    with pytest.raises(InputError, match="expected a whole model"):
        checkpoint.load(file)
