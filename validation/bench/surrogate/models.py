"""The models that are held against the MPM, and what is to be known of each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from datasets.errors import InputError
from gns.inference import SHIPPED
from gns.model import checkpoint
from gns.model.settings import ModelSettings
from gns.model.simulator import Simulator
from inverse.report.markdown import table


@dataclass(frozen=True, kw_only=True)
class Bars:
    """The most seconds that the tall column's whole second may take on this machine."""

    forward: float
    gradient: float
    """Forward and backward."""


FOLDER = SHIPPED.parent
NAMES = ("flow2d", "flow2d-fast", "obstacle3d")
"""What is looked for in the folder of the weights where no model is named."""
FAST, ACCURATE = Bars(forward=3.0, gradient=8.0), Bars(forward=12.0, gradient=32.0)
BARS = {"flow2d-fast": FAST, "flow2d": ACCURATE}


@dataclass(frozen=True, kw_only=True)
class Model:
    """A model on disk."""

    path: Path
    simulator: Simulator
    provenance: Mapping[str, Any]

    @property
    def name(self) -> str:
        """The file's name without its ending."""
        return self.path.stem

    @property
    def settings(self) -> ModelSettings:
        """Resolution and sizes."""
        return self.simulator.settings

    @property
    def bars(self) -> Bars:
        """What its seconds are held against: a model that is not shipped as the fast one, against the wider ones."""
        return BARS.get(self.name, ACCURATE)


def load(paths: Sequence[Path]) -> tuple[list[Model], list[str]]:
    """The models at `paths`, or those of the shipped ones that there are; and the names of those that there are not.

    Raises InputError for a path without a model, and where there is nothing to show.
    """
    shipped = {name: FOLDER / f"{name}.pt" for name in NAMES}
    found = paths or [path for path in shipped.values() if path.exists()]
    missing = [] if paths else [name for name, path in shipped.items() if not path.exists()]
    if not found:
        raise InputError("expected the weights of a model, there are none", where=str(FOLDER))
    names = [path.stem for path in found]
    if len(set(names)) < len(names):
        raise InputError(f"expected models of different names, got {', '.join(names)}", key="--models")
    models = []
    for path in found:
        stored = checkpoint.load(path)
        models.append(Model(path=path, simulator=stored.simulator.requires_grad_(False), provenance=stored.provenance))
    return models, missing


def facts(models: Sequence[Model]) -> list[str]:
    """A column per model."""
    rows = {
        "dimension": [f"{model.settings.dimension}D" for model in models],
        "parameters": [f"{sum(each.numel() for each in model.simulator.parameters()):,}" for model in models],
        "file": [f"{model.path.stat().st_size / 1e6:.2f} MB" for model in models],
        "cell, points per cell": [
            f"{1000 * model.settings.cell:g} mm, {model.settings.particles_per_cell}" for model in models
        ],
        "step": [f"{1000 * model.settings.step:g} ms" for model in models],
        "radius": [f"{1000 * model.settings.radius:g} mm" for model in models],
        "width x layers": [f"{model.settings.width} x {model.settings.layers}" for model in models],
        "past displacements": [str(model.settings.history) for model in models],
        "training": [trained(model.provenance) for model in models],
        "data": [", ".join(str(each) for each in model.provenance.get("datasets", ())) or "-" for model in models],
        "seed": [str(model.provenance.get("seed", "-")) for model in models],
    }
    return table(["", *(f"`{model.name}`" for model in models)], [[key, *cells] for key, cells in rows.items()])


def trained(provenance: Mapping[str, Any]) -> str:
    """How long a model was trained, with the models that it was begun with."""
    updates, at = 0, provenance
    while at:
        updates += at.get("log", {}).get("updates", 0)
        at = at.get("begin") or {}
    return f"{updates:,} updates" if updates else "-"
