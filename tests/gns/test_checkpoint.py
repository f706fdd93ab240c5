"""Models on disk: whole or refused in one line."""

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import save_file

from gns import checkpoint
from gns.simulator import Simulator
from tests.gns.conftest import NORMALISATION
from tests.refusals import refused

LAST = "network.decoder.mlp.2.weight"


@pytest.fixture
def file(lively: Simulator, tmp_path: Path) -> Path:
    path = tmp_path / "model.safetensors"
    checkpoint.save(path, lively, {"seed": 3, "datasets": ["a"], "score": math.nan})
    return path


def test_a_model_comes_back_without_flags(lively: Simulator, file: Path) -> None:
    model = checkpoint.load(file)
    assert model.simulator.settings == lively.settings
    assert model.provenance == {"seed": 3, "datasets": ["a"], "score": None}
    assert model.simulator.acceleration_scale.item() == pytest.approx(NORMALISATION.acceleration_scale)
    assert not model.simulator.training
    again, own = model.simulator.state_dict(), lively.state_dict()
    assert again.keys() == own.keys()
    assert all(torch.equal(again[name], own[name]) for name in own)


def test_missing_truncated_and_foreign_files_are_input_errors(file: Path, tmp_path: Path) -> None:
    whole = file.read_bytes()
    for content in (whole[: len(whole) // 2], whole[:10], b"", b"not a model"):
        file.write_bytes(content)
        refused(checkpoint.load, file, said="model.safetensors: expected whole weights")
    refused(checkpoint.load, tmp_path / "absent.safetensors", said="there is none")
    save_file({"weights": torch.zeros(1)}, file)
    refused(checkpoint.load, file, said="model.safetensors: format: expected a model of format")


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"width": 10**9}, "expected weights of a model of these settings.*size mismatch"),
        ({"rounds": 0}, "rounds: expected an integer of at least 1, got 0"),
        ({"layers": 9998}, r"settings: expected at most \d+ layers, from the tensors in the file, got \d+"),
        ({"radius": -1.0}, "radius: expected a positive number, got -1.0"),
        ({"rounds": 1, "layers": 1}, "expected weights of a model of these settings.*Unexpected key"),
        ({"widht": 8}, "widht: expected a known key, did you mean 'width'"),
        ({}, LAST + ": expected finite numbers"),
    ],
)
def test_each_fault_is_named_in_a_line(file: Path, changes: dict[str, Any], expected: str) -> None:
    tensors, metadata = checkpoint.read(file)
    settings = json.dumps(json.loads(metadata["settings"]) | changes)
    if not changes:
        tensors[LAST] *= math.nan
    save_file(tensors, file, {**metadata, "settings": settings})
    assert re.search(r"model\.safetensors: " + expected, str(refused(checkpoint.load, file)))


@pytest.mark.parametrize("text", ["", "3", "{", "[" * 10_000])
def test_metadata_that_is_no_table_is_refused(file: Path, text: str) -> None:
    tensors, metadata = checkpoint.read(file)
    for key in ("settings", "provenance"):
        save_file(tensors, file, {**metadata, key: text})
        assert "JSON" in str(refused(checkpoint.load, file, said=f"model.safetensors: {key}: expected"))
