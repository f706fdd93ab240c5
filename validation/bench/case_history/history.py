"""A case history: a scene on real ground, a runout that was observed, and the bed friction that explains it.

Where no deposit was surveyed, the runout is that of a twin: the same release on the same ground, computed with a bed
friction that the back-analysis does not use and another initial jitter, and then rounded to the raster of a survey.
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.library import read_scene
from datasets.measures import Positions, front
from datasets.records import Record, from_mapping, read_toml
from datasets.scene import Domain, Scene
from inverse.parameters import kind, with_parameters
from validation.bench.experiments.angle import AngleSearch, InferredAngle, search_all
from validation.bench.experiments.computed import Simulate
from validation.experiments.experiment import Assumption

FOLDER = Path(__file__).parent


@dataclass(frozen=True, kw_only=True)
class Twin(Record):
    """How the observed runout was made."""

    bed_friction: float
    """Coulomb coefficient [-]; the back-analysis does not use it."""
    seed: int
    """Of its initial jitter."""
    cell: float
    """Its grid cell [m]."""


@dataclass(frozen=True, kw_only=True)
class History(Record):
    """The contents of a `history.toml`."""

    title: str
    what: str
    source: str
    licence: str
    scene: str
    """File of the scene, beside the history."""
    bed: str
    """The bed friction as a parameter of an inverse problem, such as solids[0].friction."""
    cells: tuple[float, float]
    """Grid cells, the coarse and the fine one [m]."""
    raster: float
    """Size of a survey's pixel [m], to whose middle the runout is rounded."""
    spread: float
    """One unit of the runout's uncertainty [m]."""
    spread_from: str
    """Where it comes from."""
    twin: Twin
    assumptions: tuple[Assumption, ...] = ()

    def __post_init__(self) -> None:
        for key in ("raster", "spread"):
            if getattr(self, key) <= 0.0:
                raise InputError(f"expected a positive length in m, got {getattr(self, key):g}", key=key)


@dataclass(frozen=True, kw_only=True)
class ReadHistory:
    """A case history and the folder it was read from."""

    name: str
    folder: Path
    history: History

    @property
    def ground(self) -> NDArray[np.float64]:
        """The line of the first terrain of the scene [m], shape [P, 2]; no points where it has none."""
        solids = read_scene(str(self.folder / self.history.scene)).solids
        lines = [solid.points for solid in solids if solid.kind == "terrain"]
        return np.array(lines[0] if lines else np.zeros((0, 2)), dtype=np.float64)

    def scene(self, bed_friction: float, cell: float, seed: int) -> Scene:
        """The scene with another bed friction [-], cell [m] and jitter. Raises InputError."""
        path, bed = self.folder / self.history.scene, self.history.bed
        scene = read_scene(str(path))
        try:
            kind(bed).check(scene)
            scene = with_parameters(scene, [bed], [bed_friction])
        except InputError as error:
            raise InputError(error.message, where=str(path), key=bed) from None
        return dataclasses.replace(scene, domain=Domain(size=scene.domain.size, cell=cell), seed=seed)


@dataclass(frozen=True, kw_only=True)
class BackAnalysis:
    """The result of the back-analysis of a case history."""

    read: ReadHistory
    observed: float
    """Runout that was observed [m]."""
    twin: Positions
    """The deposit that it was observed on [m], shape [N, D]."""
    coarse: InferredAngle
    """Angle of the bed friction on the coarse cells."""
    fine: InferredAngle
    """On the fine cells."""
    deposit: Positions
    """The deposit at the inferred friction on the fine cells [m], shape [N, D]."""
    start: Positions
    """Particles of the release [m], shape [N, D]."""

    @property
    def truth_deg(self) -> float:
        """Angle of the twin's bed friction [deg]."""
        return math.degrees(math.atan(self.read.history.twin.bed_friction))

    @property
    def covers_truth(self) -> bool:
        """Whether the interval on the fine cells covers the truth."""
        return abs(self.fine.deg - self.truth_deg) <= self.fine.half_width_deg

    @property
    def travel_deg(self) -> float:
        """Travel angle [deg] of the twin: slope of the line between the centres of mass of release and deposit."""
        drop, distance = (self.start.mean(axis=0) - self.twin.mean(axis=0))[[1, 0]]
        return math.degrees(math.atan2(drop, -distance))


def read_history(folder: Path) -> ReadHistory:
    """Read `folder`/history.toml. Raises InputError, which names the file and the key."""
    path = folder / "history.toml"
    try:
        return ReadHistory(name=folder.name, folder=folder, history=from_mapping(History, read_toml(path)))
    except InputError as error:
        raise error if error.where else error.at(str(path)) from None


def rounded(runout: float, raster: float) -> float:
    """A runout [m] as a survey on pixels of `raster` [m] shows it: the middle of its pixel."""
    return (math.floor(runout / raster) + 0.5) * raster


def analyse(read: ReadHistory, simulate: Simulate, start: Positions) -> BackAnalysis:
    """Compute the twin, and infer its bed friction from its runout alone; start: of the release [m]."""
    history = read.history
    (twin,) = simulate([read.scene(history.twin.bed_friction, history.twin.cell, history.twin.seed)])
    observed = rounded(front(twin), history.raster)
    searches = {cell: AngleSearch(target=observed, spread=history.spread) for cell in history.cells}

    def extents(requested: Sequence[tuple[float, float]]) -> list[float]:
        scenes = [read.scene(math.tan(math.radians(angle)), cell, history.twin.seed + 1) for cell, angle in requested]
        return [front(deposit) for deposit in simulate(scenes)]

    search_all(searches, extents)
    coarse, fine = (searches[cell].inferred() for cell in history.cells)
    deposit: Positions = np.zeros((0, twin.shape[1]))
    if not math.isnan(fine.deg):
        (deposit,) = simulate([read.scene(math.tan(math.radians(fine.deg)), history.cells[1], history.twin.seed + 1)])
    return BackAnalysis(read=read, observed=observed, twin=twin, coarse=coarse, fine=fine, deposit=deposit, start=start)
