"""Held-out scenes, and the MPM's runs of them: the fine reference, finer still, and with another jitter.

The scenes are drawn by the definition that draws the training data, with another seed: no stream of random numbers is
shared. The reference is computed and stored as the training data are (`mpm.generate`): on the definition's cells, until
the deposit rests, of the particles those that its storage keeps.
"""

import dataclasses
import importlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import numpy as np

from datasets.command_line import WorkFailed
from datasets.definitions.definition import Definition, Storage
from datasets.errors import InputError
from datasets.files import write_json
from datasets.processes import processors
from datasets.scene import Domain, Scene
from datasets.trajectory import Trajectory
from mpm import Recording, ScenesFailed, simulate_many
from mpm.arrays.layout import Precision
from mpm.generate import thinned
from validation.runs import SHARE, Run, RunStore

SEED = 1
"""Of the held-out scenes; the training data have 0."""
DEFINITIONS = {2: ("datasets.definitions.flow2d", "FLOW2D"), 3: ("datasets.definitions.obstacle3d", "OBSTACLE3D")}
"""Where the definition of the training data of each dimension stands, with `KINDS` of flows beside it."""
OTHER_JITTER = 1000
"""Added to the seed of a scene."""
UNTIL_REST = Recording(until_rest=True)


@dataclass(frozen=True, kw_only=True)
class Family:
    """A definition whose scenes are of some kinds."""

    definition: Definition
    kinds: tuple[str, ...]
    """Of the scenes, repeated along the definition."""
    storage: Storage
    cell: float
    """Of the reference [m]."""


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """A scene that no training data have."""

    kind: str
    number: int
    """Among those of its kind, from 1."""
    scene: Scene

    @property
    def name(self) -> str:
        """Kind and number."""
        return f"{self.kind} {self.number}"


def family(dimension: int) -> Family | None:
    """The definition of a dimension; None where it is not part of this version."""
    module, name = DEFINITIONS[dimension]
    try:
        found = importlib.import_module(module)
    except ModuleNotFoundError:
        return None
    definition: Definition = getattr(found, name)
    assert definition.storage is not None
    kinds = tuple(each.__name__.replace("_", " ") for each in found.KINDS)
    return Family(definition=definition, kinds=kinds, storage=definition.storage, cell=found.CELL)


def draw(source: Family, each: int, keep: Path, *, seed: int = SEED) -> list[HeldOut]:
    """`each` scenes of every kind, in the definition's order; variants of other scenes are left out.

    They are kept in `keep`, because scenes over terrain take seconds to draw. Raises InputError.
    """
    path = keep / f"{source.definition.name}-{seed}-{each}.json"
    if path.exists():
        stored = json.loads(path.read_text())
        return [HeldOut(kind=kind, number=number, scene=Scene.from_json(text)) for kind, number, text in stored]
    if each < 1:
        raise InputError(f"expected at least 1, got {each}", key="--scenes")
    drawn = dict.fromkeys(source.kinds, 0)
    streams: set[int] = set()
    found = []
    for index in count():
        if min(drawn.values()) == each:
            break
        kind, stream = source.kinds[index % len(source.kinds)], source.definition.stream(index)
        if stream in streams or drawn[kind] == each:
            continue
        streams.add(stream)
        drawn[kind] += 1
        scene = source.definition.draw(np.random.default_rng([seed, stream]), index)
        found.append(HeldOut(kind=kind, number=drawn[kind], scene=scene))
    write_json(path, [[one.kind, one.number, one.scene.to_json()] for one in found])
    return found


def on_cell(scene: Scene, cell: float) -> Scene:
    """The same scene on cells of another edge [m]."""
    return dataclasses.replace(scene, domain=Domain(size=scene.domain.size, cell=cell))


def other_jitter(scene: Scene, number: int = 1) -> Scene:
    """The same scene with its particles elsewhere in their cells."""
    return dataclasses.replace(scene, seed=scene.seed + number * OTHER_JITTER)


class References:
    """The MPM's runs, each stored once, thinned as the training data are."""

    def __init__(self, folder: Path, storage: Storage) -> None:
        self.store = RunStore(folder, stored_by(storage))

    def __call__(self, scenes: Sequence[Scene]) -> list[Trajectory]:
        """The trajectory of each scene until it rests; as many as there are processors run side by side."""
        return self.store.run([Run(scene=scene, record=UNTIL_REST) for scene in scenes])


def stored_by(storage: Storage) -> Callable[..., list[Trajectory]]:
    """`mpm.simulate_many` that keeps what `storage` says of each trajectory."""

    def simulate(
        scenes: Sequence[Scene], *, record: Recording = UNTIL_REST, precision: Precision = "f32"
    ) -> list[Trajectory]:
        try:
            return [thinned(flow, storage) for flow in simulate_many(scenes, record=record, precision=precision)]
        except ScenesFailed as error:
            outcomes: list[Trajectory | WorkFailed] = [
                thinned(each, storage) if isinstance(each, Trajectory) else each for each in error.outcomes
            ]
            raise ScenesFailed(outcomes) from None

    return simulate


def core_seconds(flow: Trajectory) -> float:
    """Seconds of a stored run on one core: its share of the wall time of those beside it, times the cores."""
    return float(flow.summary[SHARE]) * processors()
