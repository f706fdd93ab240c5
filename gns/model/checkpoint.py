"""A model on disk: settings, weights, normalisation and where they come from; it loads without flags or pickle."""

import dataclasses
import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from datasets.errors import InputError
from datasets.files import replacing
from gns.model.settings import ModelSettings
from gns.model.simulator import Normalisation, Simulator

FORMAT = 3
"""Raised when files get another layout; those of format 2 are read too, with the names of their weights renamed."""
SECTIONS = {
    "network.encoder.": "network.encoder.mlp.",
    "network.contexts.": "network.processor.contexts.",
    "network.layers.": "network.processor.steps.",
    "network.norm.": "network.decoder.norm.",
    "network.decoder.": "network.decoder.mlp.",
}
"""Prefixes of weights in files of format 2, and what they are called now."""


@dataclass(frozen=True, kw_only=True)
class Model:
    """A simulator and its history."""

    simulator: Simulator
    """Built, with weights, in evaluation mode."""
    provenance: Mapping[str, Any]
    """Command, seed, datasets, minutes and scores that made the weights."""


def save(path: Path, simulator: Simulator, provenance: Mapping[str, Any]) -> None:
    """Write a model; `provenance` holds strings, numbers and lists or mappings of them."""
    content = {
        "format": FORMAT,
        "settings": dataclasses.asdict(simulator.settings),
        "state": simulator.state_dict(),
        "provenance": dict(provenance),
    }
    with replacing(path) as part:
        torch.save(content, part)


def load(path: Path) -> Model:
    """Read what `save` wrote and build the simulator. Raises InputError, which names the file."""
    content = read(path)
    if not isinstance(content, dict) or content.get("format") not in (2, FORMAT):
        raise InputError(f"expected a model of format 2 or {FORMAT}", where=str(path), key="format")
    try:
        settings = ModelSettings.from_mapping(content["settings"])
        # The true constants are buffers in the state.
        blank = Normalisation(displacement=1.0, acceleration=1.0, friction_mean=0.0, friction_std=1.0)
        simulator = Simulator(settings, blank)
        simulator.load_state_dict(renamed(content["state"]))
        provenance = content["provenance"]
    except (KeyError, TypeError, RuntimeError) as error:
        raise InputError(f"expected a whole model, {str(error).splitlines()[0]}", where=str(path)) from None
    except InputError as error:
        raise error.at(str(path)) from None
    return Model(simulator=simulator.eval(), provenance=provenance)


def renamed(state: Mapping[str, Any]) -> dict[str, Any]:
    """Weights by today's names, of a file of format 2 or later."""
    if not any("network.contexts." in name for name in state):
        return dict(state)

    def new(name: str) -> str:
        head, _, tail = name.partition("network.")
        old = next((each for each in SECTIONS if f"network.{tail}".startswith(each)), "")
        return head + SECTIONS[old] + f"network.{tail}".removeprefix(old) if old and tail else name

    return {new(name): value for name, value in state.items()}


def read(path: Path) -> Any:
    """Plain tensors, strings and numbers from a file that torch wrote. Raises InputError."""
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise InputError("expected the weights of a model, there is no such file", where=str(path)) from None
    except (OSError, RuntimeError, EOFError, ValueError, KeyError, pickle.UnpicklingError) as error:
        first = next(iter(str(error).splitlines()), "empty file")
        raise InputError(f"expected whole weights of a model, {first}", where=str(path)) from None
