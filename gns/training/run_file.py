"""The file of a training in progress: its tensors as safetensors, settings, seed and position as JSON beside them."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save as serialised
from torch import Tensor

from datasets import files
from datasets.errors import InputError
from datasets.reading import json_object
from gns.model import checkpoint

FORMAT = "run-1"
KEYS = ("settings", "seed", "position")
"""What the metadata say in JSON, under `run`."""
PARTS = ("weights", "average", "optimiser")
"""What tensors are of; their names begin with it and a slash."""

Tensors = dict[str, Tensor]


def write(path: Path, described: Mapping[str, Any], parts: Mapping[str, Tensors]) -> None:
    """Write the tensors of `PARTS` and what `KEYS` lists."""
    tensors = {
        f"{part}/{name}": value.detach().cpu().clone().contiguous()
        for part, those in parts.items()
        for name, value in those.items()
    }
    contents = serialised(tensors, {"format": FORMAT, "run": json.dumps(described)})
    with files.replacing(path) as part:
        part.write_bytes(contents)


def read(path: Path) -> tuple[dict[str, Any], dict[str, Tensors]]:
    """What `write` wrote. Raises InputError."""
    tensors, metadata = checkpoint.read(path)
    if metadata.get("format") != FORMAT:
        raise InputError(f"expected a run of format {FORMAT}, as python -m gns.train leaves it", key="format")
    described = json_object(metadata.get("run", ""))
    for key in KEYS:
        if key not in described:
            raise InputError("expected a whole run, the key is missing", key=key)
        if key != "seed" and not isinstance(described[key], dict):
            raise InputError("expected a table in JSON", key=key)
    parts: dict[str, Tensors] = {part: {} for part in PARTS}
    for name, value in tensors.items():
        part, _, rest = name.partition("/")
        if part not in parts:
            raise InputError("expected no such tensor in a run", key=name)
        parts[part][rest] = value
    return described, parts


def check(part: str, like: Tensors, found: Tensors) -> None:
    """Raise InputError unless `found` has the tensors of `like`, as large, of the same type and finite."""
    for name, value in like.items():
        key = f"{part}/{name}"
        if name not in found:
            raise InputError("expected a whole run, there is no such tensor", key=key)
        if (found[name].shape, found[name].dtype) != (value.shape, value.dtype):
            raise InputError(f"expected shape {tuple(value.shape)}, got {tuple(found[name].shape)}", key=key)
        if not torch.isfinite(found[name]).all():
            raise InputError("expected finite numbers", key=key)
    if other := sorted(found.keys() - like.keys()):
        raise InputError("expected no such tensor in this run", key=f"{part}/{other[0]}")
