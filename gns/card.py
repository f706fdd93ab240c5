"""The card of a surrogate: its settings, its training data, its errors, and whether a scene lies in its training range.

A training writes `best.json` beside its weights `best.safetensors`, with the range of each quantity (`gns.ranges`) in
each dataset; outside these ranges the error is unknown. `python -m gns.score DATASET... --model MODEL --keep` adds
scores and the calibration of the bands.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from datasets import files
from datasets.errors import InputError
from datasets.files import read_json
from datasets.scene import Scene
from datasets.schema import Record, from_mapping
from gns.ranges import Range, outside, ranges_of
from gns.settings import ModelSettings
from gns.surroundings.units import Units

if TYPE_CHECKING:
    from gns.simulator import Simulator

LEVELS = (0.5, 0.8, 0.95)  # for which a card has quantiles


@dataclass(frozen=True, kw_only=True)
class Calibration(Record):
    """How far a deposit may be from the MPM's, by flows that no training saw (`gns.score`)."""

    front: dict[str, float]
    """Level -> quantile of the front's absolute error over the extent [-]."""
    profile: dict[str, float]
    """Level -> quantile of the profile's error over the extent [-]."""
    flows: int
    """Number of flows that the calibration comes from."""
    errors: dict[str, float] = field(default_factory=dict)
    """Error (`gns.score.Score`) -> its mean amount over these flows; unknown errors are left out."""


@dataclass(frozen=True, kw_only=True)
class Dataset(Record):
    """A training dataset of a model: a definition or a folder."""

    scenes: int
    """Number of scenes for training."""
    cells_across: Range
    """Fewest and most cells of the MPM over the length of the released body."""
    ranges: dict[str, Range]
    """Quantity (`gns.ranges.quantities`) -> least and greatest value."""
    calibration: Calibration | None = None
    """None before `python -m gns.score --keep`."""


@dataclass(frozen=True, kw_only=True)
class Training(Record):
    """How a model was made."""

    command: str
    """The command of the last training."""
    seed: int | None
    """Seed of its weights and samples."""
    updates: int | None
    """Updates of the weights in all; None where the model does not say."""


@dataclass(frozen=True, kw_only=True)
class Card(Record):
    """All that is stored about a model."""

    settings: ModelSettings
    features: dict[str, int]
    """Feature of a particle, in order -> how many numbers it has."""
    normalisation: dict[str, float]
    """Scales of displacement and acceleration [m per step], mean and standard deviation of tan(phi) [-]."""
    training: Training
    licence: str
    """Licence of the weights."""
    scores: str
    """Tables in Markdown of whole rollouts, by `python -m gns.score`; empty where none were given."""
    datasets: dict[str, Dataset]
    """Definition or folder -> its content."""

    @property
    def ranges(self) -> dict[str, Range]:
        """Quantity -> least and greatest value in all training data."""
        union: dict[str, Range] = {}
        for dataset in self.datasets.values():
            for name, (low, high) in dataset.ranges.items():
                least, most = union.get(name, (low, high))
                union[name] = min(low, least), max(high, most)
        return union

    def calibration(self, scene: Scene, level: str = "0.95") -> Calibration | None:
        """The narrowest at `level` among datasets whose ranges contain `scene`, else the widest; None if none."""
        bands = [(dataset.ranges, dataset.calibration) for dataset in self.datasets.values() if dataset.calibration]
        if holding := [band for ranges, band in bands if not outside(scene, ranges)]:
            return min(holding, key=lambda band: band.front[level])
        return max((band for _, band in bands), key=lambda band: band.front[level], default=None)

    def keeping(self, calibrations: Mapping[str, Calibration]) -> "Card":
        """This card with calibrations of its datasets by name."""
        calibrated = {name: replace(self.datasets[name], calibration=band) for name, band in calibrations.items()}
        return replace(self, datasets=self.datasets | calibrated)


def describe(
    simulator: "Simulator", provenance: Mapping[str, Any], scenes: Mapping[str, Sequence[Scene]], scores: str = ""
) -> Card:
    """The card of a model with this history, trained on these scenes (by definition or folder)."""
    from gns.network.features import NODES

    datasets = {}
    for name, some in scenes.items():
        across = [round(Units.of_body(scene).length / scene.domain.cell, 2) for scene in some]
        ranges = ranges_of(some, simulator.settings)
        datasets[name] = Dataset(scenes=len(some), cells_across=(min(across), max(across)), ranges=ranges)
    command, updates = provenance.get("command", ""), total_updates(provenance) or None
    return Card(
        settings=simulator.settings,
        features={name: feature.count(simulator.settings) for name, feature in NODES.items()},
        normalisation={name: float(value) for name, value in simulator.named_buffers(recurse=False)},
        training=Training(command=command, seed=provenance.get("seed"), updates=updates),
        licence="MIT",
        scores=scores,
        datasets=datasets,
    )


def card_path(weights: Path) -> Path:
    """The file of the card of the model in the file `weights`."""
    return weights.with_suffix(".json")


def read(weights: Path) -> Card | None:
    """The card beside a model's file; None if there is none. Raises InputError, which names the file."""
    path = card_path(weights)
    try:
        data = read_json(path)
        return None if data is None else from_mapping(Card, data)
    except InputError as error:
        raise error.at(f"{path}, which a training writes") from None


def write(weights: Path, card: Card) -> None:
    files.write_json(card_path(weights), asdict(card))


def warning(weights: Path, scene: Scene) -> str | None:
    """Why the model in the file `weights` may err on `scene`, in a line, or None. Raises InputError for a bad card."""
    card = read(weights)
    if card is None:
        return f"{weights.name} has no card beside it: its training range is unknown"
    reasons = outside(scene, card.ranges)
    return f"{weights.name} lies outside its training range: {'; '.join(reasons)}" if reasons else None


def total_updates(provenance: Mapping[str, Any]) -> int:
    """All updates of the weights: those of a training and of the models that it began with."""
    begin = provenance.get("begin")
    return int((provenance.get("log") or {}).get("updates", 0)) + (total_updates(begin) if begin else 0)
