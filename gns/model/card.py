"""The card of a surrogate: the range of what it has learnt, and whether a scene lies in it.

    python -m gns.model.card gns/weights/flow2d.pt

writes `gns/weights/flow2d.json` beside the weights: least and greatest value of each quantity over the scenes that the
model was trained on, drawn anew from the definitions of its datasets (`datasets.definitions.definition`). A network interpolates;
outside of these ranges nothing is known of its error.
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
from datasets.definitions.channel3d import CHANNEL3D
from datasets.definitions.definition import Definition, Split
from datasets.definitions.flow2d import FLOW2D
from datasets.definitions.layers2d import LAYERS2D
from datasets.definitions.obstacle3d import OBSTACLE3D
from datasets.definitions.releases2d import RELEASES2D
from datasets.errors import InputError
from datasets.material import Material
from datasets.records import Record, from_mapping
from datasets.scene import Scene
from gns.model import checkpoint

DEFINITIONS: dict[str, Definition] = {each.name: each for each in (FLOW2D, RELEASES2D, LAYERS2D, OBSTACLE3D, CHANNEL3D)}
MARGIN = 0.1
"""How far outside of a range still counts as inside, as a fraction of its width: what a model may extrapolate."""

Numbers = Callable[[Scene], Sequence[float]]


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """Something of a scene that a surrogate has seen a range of."""

    unit: str
    of: Numbers
    """Its values in a scene."""


def of_materials(number: Callable[[Material], float]) -> Numbers:
    """A constant of the material of each mass."""
    return lambda scene: [number(scene.material_of(mass)) for mass in scene.masses]


def along(axis: int) -> Numbers:
    """Extent of all masses together along an axis [m]; nothing where the scene has no such axis."""

    def extent(scene: Scene) -> list[float]:
        if axis >= scene.dimension:
            return []
        ends = [mass.lower[axis] + mass.size[axis] for mass in scene.masses]
        return [max(ends) - min(mass.lower[axis] for mass in scene.masses)]

    return extent


def speeds(scene: Scene) -> list[float]:
    """Initial speed of each mass [m/s]."""
    return [math.hypot(*(mass.velocity or (0.0,))) for mass in scene.masses]


def spins(scene: Scene) -> list[float]:
    """Largest component of the initial velocity gradient of each mass [1/s]."""
    return [float(abs(mass.spin).max()) for mass in scene.masses]


QUANTITIES: dict[str, Quantity] = {
    "friction_deg": Quantity(unit="deg", of=of_materials(lambda sand: sand.friction_deg)),
    "cohesion": Quantity(unit="Pa", of=of_materials(lambda sand: sand.cohesion)),
    "density": Quantity(unit="kg/m^3", of=of_materials(lambda sand: sand.density)),
    "young": Quantity(unit="Pa", of=of_materials(lambda sand: sand.young)),
    "poisson": Quantity(unit="", of=of_materials(lambda sand: sand.poisson)),
    "dilation_deg": Quantity(unit="deg", of=of_materials(lambda sand: sand.dilation_deg)),
    "strength_gradient": Quantity(unit="Pa/m", of=of_materials(lambda sand: sand.strength_gradient)),
    "floor_friction": Quantity(unit="", of=lambda scene: [scene.floor_friction]),
    "wall_friction": Quantity(unit="", of=lambda scene: [scene.wall_friction]),
    "baffle_friction": Quantity(unit="", of=lambda scene: [scene.baffle_friction] if scene.baffles else []),
    "damping": Quantity(unit="", of=lambda scene: [scene.damping]),
    "gravity": Quantity(unit="m/s^2", of=lambda scene: [scene.gravity]),
    "slope_deg": Quantity(unit="deg", of=lambda scene: [scene.slope_deg]),
    "cell": Quantity(unit="m", of=lambda scene: [scene.domain.cell]),
    "box_length": Quantity(unit="m", of=lambda scene: [scene.domain.size[0]]),
    "box_height": Quantity(unit="m", of=lambda scene: [scene.domain.size[1]]),
    "box_width": Quantity(unit="m", of=lambda scene: list(scene.domain.size[2:])),
    "body_length": Quantity(unit="m", of=along(0)),
    "body_height": Quantity(unit="m", of=along(1)),
    "body_width": Quantity(unit="m", of=along(2)),
    "speed": Quantity(unit="m/s", of=speeds),
    "spin": Quantity(unit="1/s", of=spins),
    "baffles": Quantity(unit="", of=lambda scene: [float(len(scene.baffles))]),
    "baffle_height": Quantity(unit="m", of=lambda scene: [baffle.size[1] for baffle in scene.baffles]),
    "duration": Quantity(unit="s", of=lambda scene: [scene.duration]),
}
LONGER = ("duration",)
"""Of which less than the least is inside: a shorter flow is a part of a longer one."""
SOFTENING = "softening, initial stress or gates"
"""What no dataset has and no range can tell."""


@dataclass(frozen=True, kw_only=True)
class Card(Record):
    """What a model has learnt."""

    datasets: dict[str, int]
    """Definition -> training scenes."""
    ranges: dict[str, tuple[float, float]]
    """Quantity -> least and greatest value, in the units of `QUANTITIES`; those without any are left out."""

    def outside(self, scene: Scene) -> list[str]:
        """What of `scene` is none of what was learnt: each with its value and the range."""
        found = []
        for name, quantity in QUANTITIES.items():
            values = quantity.of(scene)
            if not values:
                continue
            if name not in self.ranges:
                found.append(f"{name} {values[0]:g} {quantity.unit}".rstrip() + " (none was learnt)")
                continue
            low, high = self.ranges[name]
            slack = MARGIN * (high - low) + 1e-6 * max(abs(low), abs(high))
            worst = max(values, key=lambda value: max(low - value, value - high))
            if worst > high + slack or (worst < low - slack and name not in LONGER):
                learnt = f"{low:g}" if low == high else f"{low:g} to {high:g}"
                found.append(f"{name} {worst:g} (learnt: {learnt}) {quantity.unit}".rstrip())
        softens = any(scene.material_of(mass).softening_length is not None for mass in scene.masses)
        if softens or any(mass.k0 is not None or mass.release is not None for mass in scene.masses):
            found.append(SOFTENING)
        return found


def of_definitions(scenes: dict[str, int]) -> Card:
    """The card of a model trained on so many scenes of each definition. Raises InputError for an unknown one."""
    ranges: dict[str, tuple[float, float]] = {}
    for name, count in scenes.items():
        if name not in DEFINITIONS:
            raise InputError(f"expected one of {', '.join(DEFINITIONS)}, got {name!r}", key="datasets")
        training = [each.scene for each in DEFINITIONS[name].entries(seed=0) if each.split is Split.TRAIN][:count]
        for key, quantity in QUANTITIES.items():
            values = [value for scene in training for value in quantity.of(scene)]
            if values:
                low, high = ranges.get(key, (math.inf, -math.inf))
                ranges[key] = (round(min(low, *values), 9), round(max(high, *values), 9))
    return Card(datasets=scenes, ranges=ranges)


def beside(weights: Path) -> Path:
    """Where the card of the model in the file `weights` lies."""
    return weights.with_suffix(".json")


def read(weights: Path) -> Card | None:
    """The card beside a model's file; None where there is none. Raises InputError, which names the file."""
    path = beside(weights)
    if not path.exists():
        return None
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(data, dict):
            raise InputError("expected a card in JSON")
        return from_mapping(Card, data)
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise error.at(str(path)) from None
        raise InputError(f"expected a card in JSON, {error}", where=str(path)) from None


def warning(weights: Path, scene: Scene) -> str | None:
    """What of `scene` the model in the file `weights` has not learnt, in a line; None where there is nothing.

    Raises InputError for a card that cannot be read.
    """
    card = read(weights)
    if card is None:
        return f"{weights.name} has no card (python -m gns.model.card): what it has learnt is not known"
    outside = card.outside(scene)
    return f"{weights.name} has not learnt such a flow: {'; '.join(outside)}" if outside else None


def main(model: Path, /) -> None:
    """Write the card of a model beside it: the ranges of what the scenes of its datasets hold.

    Parameters
    ----------
    model
        The model's file; its datasets are those that its provenance names.
    """
    named = checkpoint.load(model).provenance.get("datasets", [])
    counts = {
        match[1]: int(match[2]) for each in named if (match := re.fullmatch(r"(\w+): (\d+) trajectories", str(each)))
    }
    if not counts:
        raise InputError("expected the datasets in the model's provenance, there are none", where=str(model))
    card = of_definitions(counts)
    files.write_json(beside(model), dataclasses.asdict(card))
    print(f"{beside(model)}: {len(card.ranges)} ranges over {sum(counts.values())} scenes")


if __name__ == "__main__":
    sys.exit(run(main, "python -m gns.model.card"))
