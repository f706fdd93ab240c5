"""Whether a surrogate knows what it does not know: its bands on held-out fronts, and its warnings."""

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from datasets.errors import InputError
from datasets.records import Record
from datasets.scene import Scene
from gns import card
from validation.bench.surrogate.accuracy import Accuracy
from validation.bench.surrogate.held_out import HeldOut
from validation.bench.surrogate.models import Model
from validation.bench.surrogate.outside import out_of_range
from validation.bench.surrogate.records import Records, digest

LEVEL = 0.95
COVERAGE = (0.9, 0.99)
"""Criterion: the share of fronts that the bands of `LEVEL` hold."""
IN_RANGE = 40
"""Held-out scenes none of which may be warned of."""


@dataclass(frozen=True, kw_only=True)
class Band(Record):
    """Where a model expects the MPM's front."""

    low: float
    """[m]."""
    high: float
    """[m]."""


FrontBand = Callable[[Scene, Path], Band]
"""Scene and file of a model -> where the MPM's front is with a probability of `LEVEL`; InputError where unknown."""


@dataclass(frozen=True, kw_only=True)
class Coverage:
    """The bands of one model on held-out fronts."""

    fronts: int
    inside: int
    """How many of them the bands hold."""
    width: float
    """Mean half-width over the extent [-]."""

    @property
    def share(self) -> float:
        """Of the fronts inside [-]."""
        return self.inside / self.fronts


@dataclass(frozen=True, kw_only=True)
class Warnings:
    """What the card of one model warns of."""

    outside: Mapping[str, bool]
    """What is out of range -> whether it is warned of."""
    inside: Mapping[str, str | None]
    """Held-out scene -> what it is warned of for."""

    @property
    def missed(self) -> list[str]:
        """What is out of range and not warned of."""
        return [name for name, warned in self.outside.items() if not warned]

    @property
    def false(self) -> list[str]:
        """Scenes in range that are warned of."""
        return [name for name, reason in self.inside.items() if reason is not None]


def shipped_bands() -> FrontBand | None:
    """The bands of `gns.uncertainty`; None where this version has none. The one point where they are plugged in."""
    try:
        uncertainty = importlib.import_module("gns.uncertainty")
    except ModuleNotFoundError:
        return None

    def band(scene: Scene, model: Path) -> Band:
        found = uncertainty.predict(scene, model=model, level=LEVEL)
        return Band(low=found.front - found.half_width, high=found.front + found.half_width)

    return band


def coverages(
    accuracy: Accuracy, models: Sequence[Model], keep: Path, band: FrontBand | None
) -> dict[str, Coverage | str]:
    """By model: the coverage of free fronts at larger x, or why there are no bands."""
    if band is None:
        return {}
    stored = Records(keep / "bands.json", Band)
    found: dict[str, Coverage | str] = {}
    for model in models:
        pairs = zip(accuracy.scenes, accuracy.scores[model.name], strict=True)
        free = [(each, score) for each, score in pairs if score.rightwards and not score.at_wall]
        card_file = card.card_path(model.path)
        origin = digest(model.digest, card_file.read_bytes() if card_file.exists() else b"")
        bands = []
        try:
            for each, _ in tqdm(free, desc=f"bands, {model.name}", unit="scene", dynamic_ncols=True):
                key = digest(origin, each.scene)
                if key not in stored.found:
                    stored.add([(key, band(each.scene, model.path))])
                bands.append(stored.found[key])
        except InputError as error:
            found[model.name] = str(error)
            continue
        held = [one.low <= score.front <= one.high for one, (_, score) in zip(bands, free, strict=True)]
        widths = [0.5 * (one.high - one.low) / score.extent for one, (_, score) in zip(bands, free, strict=True)]
        if free:
            found[model.name] = Coverage(fronts=len(free), inside=sum(held), width=sum(widths) / len(widths))
    return found


def warnings(model: Model, scenes: Sequence[HeldOut]) -> Warnings:
    """The warnings of a model's card, of scenes that are out of range and of `IN_RANGE` held-out ones."""
    inside = sorted(scenes, key=lambda each: each.number)[:IN_RANGE]
    return Warnings(
        outside={
            name: card.warning(model.path, scene) is not None for name, scene in out_of_range(model.settings).items()
        },
        inside={each.name: card.warning(model.path, each.scene) for each in inside},
    )
