"""A model on disk: weights as safetensors, settings and provenance as JSON in the file's metadata; no flags, no pickle.

| key of the metadata | what                                                            |
| `format`            | `FORMAT`                                                        |
| `settings`          | `gns.settings.ModelSettings`                              |
| `provenance`        | command, seed, datasets, minutes and scores that made the weights |

A network is built without memory of its own; it uses the tensors read from the file.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import safe_open
from safetensors.torch import save as serialised
from torch import Tensor

from datasets import files
from datasets.errors import InputError, naming, require
from datasets.files import file_size, json_object, reading
from datasets.schema import from_mapping
from gns.settings import ModelSettings
from gns.simulator import Simulator
from gns.surroundings.forces import Normalisation

WHAT = "whole weights of a model"
FORMAT = "5"  # changes with the layout of the file


@dataclass(frozen=True, kw_only=True)
class Model:
    """A simulator and its history."""

    simulator: Simulator  # in evaluation mode and frozen: a gradient with respect to the flow is then much cheaper
    provenance: Mapping[str, Any]  # command, seed, datasets, minutes and scores that made the weights


def save(path: Path, simulator: Simulator, provenance: Mapping[str, Any]) -> None:
    """Write a model; `provenance` holds strings, numbers and lists or mappings of them."""
    settings, history = json.dumps(asdict(simulator.settings)), json.dumps(files.finite(provenance))
    tensors = {name: value.cpu().float().contiguous() for name, value in simulator.state_dict().items()}
    with files.replacing(path) as part:
        part.write_bytes(serialised(tensors, {"format": FORMAT, "settings": settings, "provenance": history}))


def load(path: Path) -> Model:
    """Read what `save` wrote and build the simulator. Raises InputError, which names the file and what is wrong."""
    with naming(path):
        tensors, metadata = read(path)
        if metadata.get("format") != FORMAT:
            raise InputError(f"expected a model of format {FORMAT}", key="format")
        described, provenance = (json_object(metadata.get(key, ""), key) for key in ("settings", "provenance"))
        settings = from_mapping(ModelSettings, described)
        for name, tensor in tensors.items():
            require(bool(torch.isfinite(tensor).all()), name, "finite numbers", "others")
    corrected = any(name.startswith("correction.") for name in tensors)
    with reading(path, "weights of a model of these settings"), torch.device("meta"):
        # The true constants are among the tensors.
        simulator = Simulator(settings, Normalisation(), corrected=corrected)
        simulator.load_state_dict(tensors, assign=True)
    return Model(simulator=simulator.eval().requires_grad_(False), provenance=provenance)


def read(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Tensors and metadata of a file of safetensors. Raises InputError."""
    file_size(path, WHAT)
    with reading(path, WHAT), safe_open(path, framework="pt") as file:
        return {name: file.get_tensor(name).float() for name in file.keys()}, file.metadata() or {}  # noqa: SIM118
