"""The card of a surrogate: what it is, what it was trained on, how well it does, and whether a scene is within.

A training leaves `best.json` beside its weights `best.safetensors`, with the range of each quantity (`gns.ranges`) in
each dataset; outside of all ranges the error is unknown. `python -m gns.score DATASET... --model MODEL --keep` adds
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

LEVELS = (0.5, 0.8, 0.95)  # of the bands that it has quantiles for


@dataclass(frozen=True, kw_only=True)
class Calibration(Record):
    """How far a deposit may be from the MPM's, by flows that no training saw (`gns.score`)."""

    front: dict[str, float]
    """Level -> quantile of the front's absolute error over the extent [-]."""
    profile: dict[str, float]
    """Level -> quantile of the profile's error over the extent [-]."""
    flows: int
    """Number of flows that it was found on."""
    errors: dict[str, float] = field(default_factory=dict)
    """Error (`gns.score.Score`) -> its mean amount over these flows; without those that are not known."""


@dataclass(frozen=True, kw_only=True)
class Dataset(Record):
    """What a model was trained on: a definition or a folder."""

    scenes: int
    """For training."""
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
    """What began the last training."""
    seed: int | None
    """Of its weights and samples."""
    updates: int | None
    """Updates of the weights in all; None where the model does not say."""


@dataclass(frozen=True, kw_only=True)
class Card(Record):
    """What there is to know of a model."""

    settings: ModelSettings
    features: dict[str, int]
    """Features of a particle in their order -> how many numbers."""
    normalisation: dict[str, float]
    """Scales of displacement and acceleration [m per step], mean and standard deviation of tan(phi) [-]."""
    training: Training
    licence: str
    """Of the weights."""
    scores: str
    """Tables in Markdown of whole rollouts, by `python -m gns.score`; empty where none were given."""
    datasets: dict[str, Dataset]
    """Definition or folder -> what it holds."""

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
        """The narrowest at `level` of the datasets whose ranges hold `scene`, else the widest; None where none is."""
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
    """The card of a model of this history that was trained on these scenes, by definition or folder."""
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
    """The card beside a model's file; None where there is none. Raises InputError, which names the file."""
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
    return f"{weights.name} is outside of its training range: {'; '.join(reasons)}" if reasons else None


def total_updates(provenance: Mapping[str, Any]) -> int:
    """Updates of the weights in all: of a training and of those that it began with."""
    begin = provenance.get("begin")
    return int((provenance.get("log") or {}).get("updates", 0)) + (total_updates(begin) if begin else 0)
