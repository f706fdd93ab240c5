"""A model on disk: weights as safetensors, settings and provenance as JSON in the file's metadata; no flags, no pickle.

| key of the metadata | what                                                            |
| `format`            | `FORMAT`                                                        |
| `settings`          | `gns.settings.ModelSettings`                              |
| `provenance`        | command, seed, datasets, minutes and scores that made the weights |

A file may be anybody's, so nothing is built before it is known to be as large as the tensors that are in the file.
"""

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import safe_open
from safetensors.torch import save as serialised
from torch import Tensor

from datasets import files
from datasets.errors import InputError
from datasets.reading import file_size, json_object, reading
from datasets.records import from_mapping
from gns.settings import ModelSettings
from gns.simulator import Normalisation, Simulator

WHAT = "whole weights of a model"
FORMAT = "4"
"""Raised when files get another layout."""
BLANK = Normalisation(displacement=1.0, acceleration=1.0, friction_mean=0.0, friction_std=1.0)
"""The true constants are among the tensors."""
SCALES = ("displacement_scale", "acceleration_scale", "friction_std")
"""Constants that features are divided by or outputs multiplied with."""


@dataclass(frozen=True, kw_only=True)
class Model:
    """A simulator and its history."""

    simulator: Simulator
    """Built, with weights, in evaluation mode and frozen: a gradient with respect to the flow is then much cheaper."""
    provenance: Mapping[str, Any]
    """Command, seed, datasets, minutes and scores that made the weights."""


def save(path: Path, simulator: Simulator, provenance: Mapping[str, Any]) -> None:
    """Write a model; `provenance` holds strings, numbers and lists or mappings of them."""
    settings = dataclasses.asdict(simulator.settings)
    metadata = {"settings": json.dumps(settings), "provenance": json.dumps(files.finite(provenance))}
    tensors = {
        name: value.detach().to(device="cpu", dtype=torch.float32).contiguous()
        for name, value in simulator.state_dict().items()
    }
    contents = serialised(tensors, {"format": FORMAT, **metadata})
    with files.replacing(path) as part:
        part.write_bytes(contents)


def load(path: Path) -> Model:
    """Read what `save` wrote and build the simulator. Raises InputError, which names the file and what is wrong."""
    try:
        tensors, metadata = read(path)
        if metadata.get("format") != FORMAT:
            raise InputError(f"expected a model of format {FORMAT}", key="format")
        settings = from_mapping(ModelSettings, parsed(metadata, "settings"))
        provenance = parsed(metadata, "provenance")
        check(settings, tensors)
        simulator = Simulator(settings, BLANK)
    except InputError as error:
        raise error.at(str(path)) from None
    simulator.load_state_dict(tensors)
    return Model(simulator=simulator.eval().requires_grad_(False), provenance=provenance)


def read(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Tensors and metadata of a file of safetensors. Raises InputError."""
    file_size(path, WHAT)
    with reading(path, WHAT), safe_open(path, framework="pt") as file:
        return {name: file.get_tensor(name) for name in file.keys()}, file.metadata() or {}  # noqa: SIM118


def parsed(metadata: Mapping[str, str], key: str) -> dict[str, Any]:
    """A table of the metadata. Raises InputError."""
    try:
        return json_object(metadata.get(key, ""))
    except InputError:
        raise InputError("expected a table in JSON in the file's metadata", key=key) from None


def check(settings: ModelSettings, tensors: Mapping[str, Tensor]) -> None:
    """Raise InputError, which names the setting or the tensor, where tensors are not those of a model of `settings`.

    No network is built before the number of its layers is known to be no larger than that of the tensors; and then
    first without memory, to compare every name and shape.
    """
    for name, tensor in tensors.items():
        if tensor.dtype != torch.float32 or tensor.numel() == 0:
            got = f"{tuple(tensor.shape)} of {str(tensor.dtype).removeprefix('torch.')}"
            raise InputError(f"expected numbers of float32, got {got}", key=name)
        if not torch.isfinite(tensor).all():
            raise InputError("expected finite numbers", key=name)
    built = settings.layers * (settings.mlp_layers + 1) + settings.rounds * (settings.grid_layers + 1)
    if built > len(tensors):
        raise InputError(
            f"expected at most {len(tensors)} layers, from the tensors in the file, got {built}", key="settings"
        )
    with torch.device("meta"):
        expected = Simulator(settings, BLANK).state_dict()
    for name, like in expected.items():
        if name not in tensors:
            raise InputError("expected a tensor of that name, there is none", key=name)
        if tensors[name].shape != like.shape:
            raise InputError(f"expected shape {tuple(like.shape)}, got {tuple(tensors[name].shape)}", key=name)
    if other := sorted(tensors.keys() - expected.keys()):
        raise InputError("expected no such tensor in a model of these settings", key=other[0])
    for name in SCALES:
        if not tensors[name] > 0.0:
            raise InputError(f"expected a positive number, got {float(tensors[name]):g}", key=name)
