"""The card of a surrogate: what it is, what it was trained on, how well it does, and whether a scene is within.

    python -m gns.card runs/mine/best.safetensors

writes `runs/mine/best.json` beside the weights, as a training does at its end. Its ranges are the least and the
greatest value of each quantity (`gns.ranges`) over the scenes that the model was trained on, in the folders that it
names. A network interpolates; outside of these ranges its error is unknown.
`python -m gns.score DATASET... --model MODEL --keep` adds scores and bands.
"""

import dataclasses
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from datasets import files
from datasets.command_line import run
from datasets.errors import InputError
from datasets.records import Record, from_mapping, read_json
from datasets.scene import Scene
from datasets.trajectory import open_trajectory, trajectory_files
from gns.library import model_path, shipped
from gns.ranges import Range, outside, ranges_of
from gns.settings import ModelSettings, features
from gns.units import Units

if TYPE_CHECKING:
    from gns.simulator import Simulator

SHORT, FAR_TOO_SHORT = 0.25, 0.05
"""Below these shares of a shipped model's updates a training is called too short."""
LICENCE = "MIT"
"""That of the repository."""


@dataclass(frozen=True, kw_only=True)
class Data(Record):
    """What a model was trained on, and by which command."""

    scenes: dict[str, int]
    """Definition or folder -> training scenes."""
    cells_across: dict[str, Range]
    """The same -> fewest and most cells of the MPM over the length of the released body."""
    command: str
    """What began the last training."""
    seed: int | None
    """Of its weights and samples."""
    updates: int | None
    """Updates of the weights in all; None where the model does not say."""


@dataclass(frozen=True, kw_only=True)
class Calibration(Record):
    """How far a predicted front may be from the MPM's, by the spread of an ensemble (`gns.uncertainty`)."""

    floor: float
    """b: error that the members have in common, over the extent of the flow [-]."""
    quantiles: dict[str, float]
    """Level -> q, the quantile of the absolute errors over sqrt(spread^2 + (b extent)^2) [-]."""
    flows: int
    """Number of flows that it was found on."""


@dataclass(frozen=True, kw_only=True)
class Card(Record):
    """What there is to know of a model."""

    settings: ModelSettings
    features: dict[str, int]
    """Features of a particle in their order -> how many numbers."""
    normalisation: dict[str, float]
    """Scales of displacement and acceleration [m per step], mean and standard deviation of tan(phi) [-]."""
    data: Data
    licence: str
    """Of the weights."""
    scores: str
    """Tables in Markdown of whole rollouts, by `python -m gns.score`; empty where none were given."""
    ranges: dict[str, Range]
    """Quantity (`gns.ranges.quantities`) -> least and greatest value in the training data."""
    calibration: Calibration | None = None
    """None before `python -m gns.score --keep`."""


def describe(
    simulator: "Simulator", provenance: Mapping[str, Any], scenes: Mapping[str, Sequence[Scene]], scores: str = ""
) -> Card:
    """The card of a model of this history that was trained on these scenes, by definition or folder."""
    settings = simulator.settings
    constants = ("displacement_scale", "acceleration_scale", "friction_mean", "friction_std")
    across = {
        name: [Units.of_body(scene).length / scene.domain.cell for scene in some] for name, some in scenes.items()
    }
    return Card(
        settings=settings,
        features=features(settings),
        normalisation={name: float(getattr(simulator, name)) for name in constants},
        data=Data(
            scenes={name: len(some) for name, some in scenes.items()},
            cells_across={name: (round(min(some), 2), round(max(some), 2)) for name, some in across.items()},
            command=str(provenance.get("command", "")),
            seed=provenance.get("seed"),
            updates=total_updates(provenance) or None,
        ),
        licence=LICENCE,
        scores=scores,
        ranges=ranges_of((scene for some in scenes.values() for scene in some), settings),
    )


def stored(datasets: Sequence[Path]) -> dict[str, list[Scene]]:
    """The training scenes in folders that `python -m mpm.generate` made. Raises InputError."""
    found = {}
    for folder in datasets:
        found[folder.name] = [open_trajectory(file).scene for file in trajectory_files(folder / "train")]
        if not found[folder.name]:
            raise InputError("expected trajectories in train/*.npz or *.h5, there are none", where=str(folder))
    return found


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
        raise error.at(f"{path}, which python -m gns.card writes") from None


def write(weights: Path, card: Card) -> None:
    """Write the card beside the model's file."""
    files.write_json(card_path(weights), dataclasses.asdict(card))


def warning(weights: Path, scene: Scene) -> str | None:
    """Why the model in the file `weights` may err on `scene`, in a line; None where there is no reason.

    Raises InputError for a card that cannot be read.
    """
    card = read(weights)
    if card is None:
        return f"{weights.name} has no card (python -m gns.card): its training range is unknown"
    reasons = []
    if found := outside(scene, card.ranges):
        reasons.append(f"{weights.name} is outside of its training range: {'; '.join(found)}")
    updates = card.data.updates
    if updates is not None and (share_of_shipped(updates, scene.dimension) or 1.0) < SHORT:
        reasons.append(f"{weights.name}: {length_of_training(updates, scene.dimension)}")
    return "; ".join(reasons) or None


def total_updates(provenance: Mapping[str, Any]) -> int:
    """Updates of the weights in all: of a training and of those that it began with."""
    begin = provenance.get("begin")
    return int((provenance.get("log") or {}).get("updates", 0)) + (total_updates(begin) if begin else 0)


def share_of_shipped(updates: int, dimension: int) -> float | None:
    """So many updates over those of the shipped model in 2D or 3D; None where none ships, or its card does not say."""
    path = shipped(dimension)
    reference = read(path) if path.exists() else None
    return updates / reference.data.updates if reference and reference.data.updates else None


def length_of_training(updates: int, dimension: int) -> str:
    """A line on so many updates against those of the shipped model."""
    text, share = f"{updates} updates in all", share_of_shipped(updates, dimension)
    if share is None:
        return text
    text += f", {100.0 * share:.3g} % of those of {shipped(dimension).name}"
    if share < SHORT:
        text += ": far too short, no answer should rest on this model" if share < FAR_TOO_SHORT else ": train longer"
    return text


def main(model: Path, /, *datasets: Path) -> None:
    """Write the card of a model beside it; scores and bands of a former one stay.

    Parameters
    ----------
    model
        The model's file, or the name of a shipped one.
    datasets
        Folders of its training data; those that the model names unless given.
    """
    # Here, because torch takes seconds, which --help should not.
    from gns import checkpoint

    model = model_path(model)
    loaded, former = checkpoint.load(model), read(model)
    scenes = stored(datasets or [Path(each) for each in loaded.provenance.get("datasets", [])])
    if not scenes:
        raise InputError("expected the datasets in the model's provenance, there are none", where=str(model))
    card = describe(loaded.simulator, loaded.provenance, scenes)
    if former is not None:
        card = dataclasses.replace(card, scores=former.scores, calibration=former.calibration)
    write(model, card)
    print(f"{card_path(model)}: {len(card.ranges)} ranges over {sum(card.data.scenes.values())} scenes")


if __name__ == "__main__":
    sys.exit(run(main, "python -m gns.card"))
