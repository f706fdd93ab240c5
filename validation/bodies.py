"""Which length of a body its cells are to be counted across, so that an error carries over to other shapes."""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from datasets.library import read_scene
from datasets.scene import Mass, Scene
from mpm.resolution import Resolution, at, characteristic_length
from validation import deposits
from validation.deposits import Run, Way
from validation.scores import score, truth

SHAPES = {"short": (0.4, 0.2), "tall": (0.2, 0.4), "flat": (0.4, 0.1), "slender": (0.1, 0.4)}
"""Length and height of a column [m]."""
ANGLES = ("21", "42")
CELLS = (5.0, 10.0)
"""Across the smallest side; the reference has four times as many."""
QUARTER = 4.0
SEEDS = (1, 2)
LENGTHS: dict[str, Callable[[Scene], float]] = {
    "smallest side": characteristic_length,
    "length": lambda scene: scene.masses[0].size[0],
    "height": lambda scene: scene.masses[0].size[1],
    "root of the area": lambda scene: math.sqrt(math.prod(scene.masses[0].size)),
}


@dataclass(frozen=True, kw_only=True)
class Trial:
    """A column at one resolution against a quarter of its cell."""

    name: str
    scene: Scene
    cells: float
    """Across its smallest side."""
    error: float
    bias: float
    scatter: float
    """Over the reach, as in `validation.scores`."""


@dataclass(frozen=True, kw_only=True)
class Spread:
    """How well errors of all shapes follow one power of the cells across some length."""

    length: str
    exponent: float
    factor: float
    """exp of the standard deviation of log(error) about the power law."""
    trials: tuple[Trial, ...]


def bodies() -> dict[str, Scene]:
    """The columns by name; of the paper's in all but their shape."""
    scenes = {}
    for (shape, size), angle in product(SHAPES.items(), ANGLES):
        body = Mass(lower=(0.0, 0.0), size=size)
        name = f"{shape}-{angle}, {size[0]:g} x {size[1]:g} m"
        scenes[name] = dataclasses.replace(read_scene(f"column-short-{angle}"), masses=(body,))
    return scenes


def runs(scene: Scene, cells: float) -> list[Run]:
    """Of a column at a resolution, one per seed."""
    what = Resolution(cells=cells, particles_per_axis=2, step_fraction=0.9, precision="f32")
    return [
        Run(scene=dataclasses.replace(at(scene, what), seed=seed), precision="f32", way=Way.TOGETHER) for seed in SEEDS
    ]


def compare(folder: Path) -> list[Spread]:
    """Run what `folder` does not have yet; the same trials against each length."""
    scenes = bodies()
    wanted = {
        (name, cells): runs(scene, cells)
        for name, scene in scenes.items()
        for cells in {*CELLS, *(QUARTER * each for each in CELLS)}
    }
    deposits.compute([run for group in wanted.values() for run in group], folder)
    flows = {key: deposits.read_all(group, folder) for key, group in wanted.items()}
    trials = []
    for name, cells in product(scenes, CELLS):
        found = score(flows[name, cells], truth(flows[name, QUARTER * cells]))
        trials.append(
            Trial(
                name=name,
                scene=flows[name, cells][0].scene,
                cells=cells,
                error=found.error,
                bias=found.bias,
                scatter=found.scatter,
            )
        )
    return [spread(length, of, tuple(trials)) for length, of in LENGTHS.items()]


def spread(length: str, of: Callable[[Scene], float], trials: tuple[Trial, ...]) -> Spread:
    """Fit one power of the cells across a length to the errors of all trials."""
    cells = np.log([of(trial.scene) / trial.scene.domain.cell for trial in trials])
    errors = np.log([trial.error for trial in trials])
    exponent, offset = np.polyfit(cells, errors, 1)
    rest = errors - (offset + exponent * cells)
    return Spread(
        length=length,
        exponent=float(exponent),
        factor=math.exp(math.sqrt(float(np.sum(rest**2)) / (len(trials) - 2))),
        trials=trials,
    )
