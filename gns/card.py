"""The card of a surrogate: what it is, what it was trained on, how well it does, and whether a scene is within.

    python -m gns.card gns/weights/flow2d.safetensors --scores scores.md

writes `gns/weights/flow2d.json` beside the weights. Its ranges are the least and the greatest value of each quantity
(`gns.ranges`) over the scenes that the model was trained on, drawn anew from the definitions of its datasets. A network
interpolates; outside of these ranges its error is unknown. What was trained on data that no shipped definition draws
is given its folders: `python -m gns.card MODEL DATASET...`.
"""

import dataclasses
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from datasets import files
from datasets.command_line import run
from datasets.definitions import DEFINITIONS
from datasets.definitions.definition import Split
from datasets.errors import InputError
from datasets.records import Record, from_mapping, read_json
from datasets.scene import Scene
from datasets.trajectory import open_trajectory, trajectory_files
from gns.inference import shipped
from gns.model import checkpoint, rheology, traction
from gns.model.context import channels
from gns.model.settings import GRAVITY, ModelSettings
from gns.model.simulator import Simulator, conditions_count
from gns.model.solids import feature_count
from gns.ranges import Body, Range, outside, ranges_of
from gns.training.convergence import SHORT, summary, total_updates

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
    """How far a prediction may be from the MPM, by the spread of an ensemble (`gns.uncertainty`)."""

    floor: float
    """b: error that the members have in common, over the extent of the flow [-]."""
    deviation: float
    """Standard deviation of the errors over sqrt(spread^2 + (b extent)^2) [-]."""
    quantiles: dict[str, float]
    """Level -> q, the quantile of the absolute errors over the same [-]."""
    flows: int
    """Number of flows that it was found on."""
    command: str
    """What found it."""


@dataclass(frozen=True, kw_only=True)
class Card(Record):
    """What there is to know of a model."""

    features: dict[str, int]
    """Features of a particle in their order -> how many numbers."""
    graph: dict[str, float]
    """`radius` [m], `history` [steps], `step` [s], `cell` [m] of the thinning, and the sizes of the network."""
    grid: dict[str, float]
    """`cell` [m], `channels` and `layers` of the grid context."""
    normalisation: dict[str, float]
    """Scales of displacement and acceleration [m per step], mean and standard deviation of tan(phi) [-]."""
    units: dict[str, float | None]
    """`body_length` [m], `density` [kg/m^3], `gravity` [m/s^2] to which scenes are scaled; null: they are not."""
    data: Data
    licence: str
    """Of the weights."""
    scores: str
    """Tables in Markdown of whole rollouts, by `python -m gns.score`; empty where none were given."""
    ranges: dict[str, Range]
    """Quantity (`gns.ranges.QUANTITIES`) -> least and greatest value in the training data."""
    calibration: dict[str, Calibration] | None = None
    """Observation (`front`, `transport`) -> calibration; None before `python -m gns.calibrate`."""

    def outside(self, scene: Scene) -> list[str]:
        """The quantities of `scene` outside of the training range: value, range and by how much."""
        return outside(scene, self.ranges)


def describe(
    simulator: Simulator, provenance: Mapping[str, Any], scenes: Mapping[str, Sequence[Scene]], scores: str = ""
) -> Card:
    """The card of a model of this history that was trained on these scenes, by definition or folder."""
    settings = simulator.settings
    constants = ("displacement_scale", "acceleration_scale", "friction_mean", "friction_std")
    across = {
        name: [Body.from_scene(scene).length / scene.domain.cell for scene in some] for name, some in scenes.items()
    }
    return Card(
        features=features(settings),
        graph={
            key: getattr(settings, key) for key in ("radius", "history", "step", "cell", "width", "layers", "rounds")
        },
        grid={"cell": settings.grid_cell, "channels": settings.grid_channels, "layers": settings.grid_layers},
        normalisation={name: float(getattr(simulator, name)) for name in constants},
        units={"body_length": settings.body_length, "density": settings.density, "gravity": GRAVITY},
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


def features(settings: ModelSettings) -> dict[str, int]:
    """Features of a particle in their order -> how many numbers."""
    dimension = settings.dimension
    return {
        "past displacements": settings.history * dimension,
        "their changes": (settings.history - 1) * dimension,
        "solids within the radius": feature_count(dimension),
        "volume": 1,
        "friction, cohesion, floor, walls, damping, gravity": conditions_count(dimension),
        "column on the grid": channels(settings),
        "tractions of surfaces and damping": traction.count(dimension),
        "cohesion over the weight above": 1,
        "forces of pressure and internal friction": rheology.count(dimension),
        "basal friction and damped motion": traction.sliding_count(dimension),
    }


def defined(counts: Mapping[str, int]) -> dict[str, list[Scene]]:
    """The first training scenes of shipped definitions, so many of each. Raises InputError for an unknown one."""
    if unknown := sorted(counts.keys() - DEFINITIONS.keys()):
        raise InputError(f"expected the folders of its data, {unknown[0]} is no shipped definition", key="DATASET")
    return {
        name: [each.scene for each in DEFINITIONS[name].entries(seed=0) if each.split is Split.TRAIN][:count]
        for name, count in counts.items()
    }


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
    if found := card.outside(scene):
        reasons.append(f"{weights.name} is outside of its training range: {'; '.join(found)}")
    updates, reference = card.data.updates, reference_updates(scene.dimension)
    if updates is not None and reference is not None and updates < SHORT * reference:
        reasons.append(f"{weights.name}: {summary(updates, reference, shipped(scene.dimension).name)}")
    return "; ".join(reasons) or None


def reference_updates(dimension: int) -> int | None:
    """Updates of the weights of the shipped model in 2D or 3D; None where none ships, or its card does not say."""
    path = shipped(dimension)
    card = read(path) if path.exists() else None
    return None if card is None else card.data.updates


def length_of_training(updates: int, dimension: int, scores: Sequence[float] = ()) -> str:
    """A line on so many updates against those of the shipped model; scores: of the validations, in order."""
    reference = reference_updates(dimension)
    if reference is None:
        return f"{updates} updates in all"
    return summary(updates, reference, shipped(dimension).name, scores)


def main(model: Path, /, *datasets: Path, scores: Path | None = None) -> None:
    """Write the card of a model beside it.

    Parameters
    ----------
    model
        The model's file.
    datasets
        Folders of its training data; the shipped definitions that its provenance names unless given.
    scores
        Table that python -m gns.score wrote, for the card.
    """
    loaded = checkpoint.load(model)
    if datasets:
        scenes = stored(datasets)
    else:
        named = loaded.provenance.get("datasets", [])
        matches = [re.fullmatch(r"([\w-]+): (\d+) trajectories", str(each)) for each in named]
        scenes = defined({match[1]: int(match[2]) for match in matches if match})
    if not scenes:
        raise InputError("expected the datasets in the model's provenance, there are none", where=str(model))
    try:
        table = "" if scores is None else scores.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise InputError(f"expected a table, {error}", where=str(scores)) from None
    card = describe(loaded.simulator, loaded.provenance, scenes, table)
    write(model, card)
    print(f"{card_path(model)}: {len(card.ranges)} ranges over {sum(card.data.scenes.values())} scenes")


if __name__ == "__main__":
    sys.exit(run(main, "python -m gns.card"))
