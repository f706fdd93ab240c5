"""The card of a surrogate: the range of validity given by its training data, and whether a scene lies within.

    python -m gns.card gns/weights/flow2d.pt

writes `gns/weights/flow2d.json` beside the weights: minimum and maximum of each quantity over the scenes that the model
was trained on, drawn anew from the definitions of its datasets (`datasets.definitions.definition`). A network
interpolates; outside of these ranges its error is unknown.
"""

import dataclasses
import json
import math
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from datasets import files
from datasets.command_line import run
from datasets.definitions import DEFINITIONS
from datasets.definitions.definition import Split
from datasets.errors import InputError
from datasets.material import Material
from datasets.records import Record, from_mapping
from datasets.scene import Scene
from gns.inference import shipped
from gns.model import checkpoint
from gns.training.convergence import SHORT, summary, total_updates

MARGIN = 0.1
"""Admitted extrapolation beyond a range, as a fraction of its width."""

Values = Callable[[Scene], Sequence[float]]


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A quantity of a scene whose range bounds a surrogate's validity."""

    unit: str
    values: Values
    """Its values in a scene."""


def material(number: Callable[[Material], float]) -> Values:
    """A constant of the material of each mass."""
    return lambda scene: [number(scene.material_of(mass)) for mass in scene.masses]


def extent(axis: int) -> Values:
    """Extent of all masses together along an axis [m]; none where the scene has no such axis."""

    def values(scene: Scene) -> list[float]:
        if axis >= scene.dimension:
            return []
        ends = [mass.lower[axis] + mass.size[axis] for mass in scene.masses]
        return [max(ends) - min(mass.lower[axis] for mass in scene.masses)]

    return values


def speeds(scene: Scene) -> list[float]:
    """Initial speed of each mass [m/s]."""
    return [math.hypot(*(mass.velocity or (0.0,))) for mass in scene.masses]


def spins(scene: Scene) -> list[float]:
    """Largest component of the initial velocity gradient of each mass [1/s]."""
    return [float(abs(mass.spin).max()) for mass in scene.masses]


QUANTITIES: dict[str, Quantity] = {
    "friction_deg": Quantity(unit="deg", values=material(lambda sand: sand.friction_deg)),
    "cohesion": Quantity(unit="Pa", values=material(lambda sand: sand.cohesion)),
    "density": Quantity(unit="kg/m^3", values=material(lambda sand: sand.density)),
    "young": Quantity(unit="Pa", values=material(lambda sand: sand.young)),
    "poisson": Quantity(unit="", values=material(lambda sand: sand.poisson)),
    "dilation_deg": Quantity(unit="deg", values=material(lambda sand: sand.dilation_deg)),
    "strength_gradient": Quantity(unit="Pa/m", values=material(lambda sand: sand.strength_gradient)),
    "floor_friction": Quantity(unit="", values=lambda scene: [scene.floor_friction]),
    "wall_friction": Quantity(unit="", values=lambda scene: [scene.wall_friction]),
    "baffle_friction": Quantity(unit="", values=lambda scene: [scene.baffle_friction] if scene.baffles else []),
    "damping": Quantity(unit="", values=lambda scene: [scene.damping]),
    "gravity": Quantity(unit="m/s^2", values=lambda scene: [scene.gravity]),
    "slope_deg": Quantity(unit="deg", values=lambda scene: [scene.slope_deg]),
    "cell": Quantity(unit="m", values=lambda scene: [scene.domain.cell]),
    "box_length": Quantity(unit="m", values=lambda scene: [scene.domain.size[0]]),
    "box_height": Quantity(unit="m", values=lambda scene: [scene.domain.size[1]]),
    "box_width": Quantity(unit="m", values=lambda scene: list(scene.domain.size[2:])),
    "mass_length": Quantity(unit="m", values=extent(0)),
    "mass_height": Quantity(unit="m", values=extent(1)),
    "mass_width": Quantity(unit="m", values=extent(2)),
    "speed": Quantity(unit="m/s", values=speeds),
    "spin": Quantity(unit="1/s", values=spins),
    "baffles": Quantity(unit="", values=lambda scene: [float(len(scene.baffles))]),
    "baffle_height": Quantity(unit="m", values=lambda scene: [baffle.size[1] for baffle in scene.baffles]),
    "duration": Quantity(unit="s", values=lambda scene: [scene.duration]),
}
RENAMED = {"body_length": "mass_length", "body_height": "mass_height", "body_width": "mass_width"}
"""Quantities in older cards, and what they are called now."""
UPPER_BOUND_ONLY = ("duration",)
"""Of which less than the minimum is within range: a shorter flow is a part of a longer one."""
UNSUPPORTED = "softening, initial stress or barriers"
"""What no dataset has and no range can express."""


@dataclass(frozen=True, kw_only=True)
class Card(Record):
    """The range of validity of a model."""

    datasets: dict[str, int]
    """Definition -> training scenes."""
    ranges: dict[str, tuple[float, float]]
    """Quantity -> minimum and maximum, in the units of `QUANTITIES`; those without any are left out."""
    updates: int | None = None
    """Updates of the weights in all; None in older cards."""

    def outside(self, scene: Scene) -> list[str]:
        """The quantities of `scene` outside of the training range: each with its value and the range."""
        found = []
        for name, quantity in QUANTITIES.items():
            values = quantity.values(scene)
            if not values:
                continue
            if name not in self.ranges:
                found.append(f"{name} {values[0]:g} {quantity.unit}".rstrip() + " (none in the training data)")
                continue
            low, high = self.ranges[name]
            slack = MARGIN * (high - low) + 1e-6 * max(abs(low), abs(high))
            worst = max(values, key=lambda value: max(low - value, value - high))
            if worst > high + slack or (worst < low - slack and name not in UPPER_BOUND_ONLY):
                trained = f"{low:g}" if low == high else f"{low:g} to {high:g}"
                found.append(f"{name} {worst:g} (trained: {trained}) {quantity.unit}".rstrip())
        softens = any(scene.material_of(mass).softening_length is not None for mass in scene.masses)
        if softens or any(mass.k0 is not None or mass.release is not None for mass in scene.masses):
            found.append(UNSUPPORTED)
        return found


def from_definitions(scenes: dict[str, int], updates: int | None = None) -> Card:
    """The card of a model trained on so many scenes of each definition. Raises InputError for an unknown one."""
    ranges: dict[str, tuple[float, float]] = {}
    for name, count in scenes.items():
        if name not in DEFINITIONS:
            raise InputError(f"expected one of {', '.join(DEFINITIONS)}, got {name!r}", key="datasets")
        training = [each.scene for each in DEFINITIONS[name].entries(seed=0) if each.split is Split.TRAIN][:count]
        for key, quantity in QUANTITIES.items():
            values = [value for scene in training for value in quantity.values(scene)]
            if values:
                low, high = ranges.get(key, (math.inf, -math.inf))
                ranges[key] = (round(min(low, *values), 9), round(max(high, *values), 9))
    return Card(datasets=scenes, ranges=ranges, updates=updates)


def card_path(weights: Path) -> Path:
    """The file of the card of the model in the file `weights`."""
    return weights.with_suffix(".json")


def read(weights: Path) -> Card | None:
    """The card beside a model's file; None where there is none. Raises InputError, which names the file."""
    path = card_path(weights)
    if not path.exists():
        return None
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(data, dict):
            raise InputError("expected a card in JSON")
        if isinstance(data.get("ranges"), dict):
            data["ranges"] = {RENAMED.get(key, key): value for key, value in data["ranges"].items()}
        return from_mapping(Card, data)
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise error.at(str(path)) from None
        raise InputError(f"expected a card in JSON, {error}", where=str(path)) from None


def warning(weights: Path, scene: Scene) -> str | None:
    """Why the model in the file `weights` may err on `scene`, in a line; None where there is no reason.

    Raises InputError for a card that cannot be read.
    """
    card = read(weights)
    if card is None:
        return f"{weights.name} has no card (python -m gns.card): its training range is unknown"
    reasons = []
    if outside := card.outside(scene):
        reasons.append(f"{weights.name} is outside of its training range: {'; '.join(outside)}")
    if card.updates is not None and card.updates < SHORT * reference_updates(scene.dimension):
        reasons.append(f"{weights.name}: {length_of_training(card.updates, scene.dimension)}")
    return "; ".join(reasons) or None


def reference_updates(dimension: int) -> int:
    """Updates of the weights of the shipped model in 2D or 3D. Raises InputError where its card does not name them."""
    path = shipped(dimension)
    card = read(path)
    if card is None or card.updates is None:
        raise InputError("expected the number of updates", where=str(card_path(path)), key="updates")
    return card.updates


def length_of_training(updates: int, dimension: int, scores: Sequence[float] = ()) -> str:
    """A line on so many updates against those of the shipped model; scores: of the validations, in order."""
    return summary(updates, reference_updates(dimension), shipped(dimension).name, scores)


def main(model: Path, /) -> None:
    """Write the card of a model beside it: the ranges of the quantities of its training scenes.

    Parameters
    ----------
    model
        The model's file; its datasets are those that its provenance names.
    """
    provenance = checkpoint.load(model).provenance
    named = provenance.get("datasets", [])
    counts = {
        match[1]: int(match[2]) for each in named if (match := re.fullmatch(r"(\w+): (\d+) trajectories", str(each)))
    }
    if not counts:
        raise InputError("expected the datasets in the model's provenance, there are none", where=str(model))
    card = from_definitions(counts, total_updates(provenance) or None)
    files.write_json(card_path(model), dataclasses.asdict(card))
    print(f"{card_path(model)}: {len(card.ranges)} ranges over {sum(counts.values())} scenes")


if __name__ == "__main__":
    sys.exit(run(main, "python -m gns.card"))
