"""Which length of a body its cells are to be counted across, so that an error carries over to other shapes."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from datasets.scene import Scene
from mpm.resolution import characteristic_length, with_resolution
from validation.bench.accuracy.studies import Findings, own

LENGTHS: dict[str, Callable[[Scene], float]] = {
    "smallest side": characteristic_length,
    "length": lambda scene: scene.masses[0].size[0],
    "height": lambda scene: scene.masses[0].size[1],
    "root of the area": lambda scene: math.sqrt(scene.masses[0].size[0] * scene.masses[0].size[1]),
}


@dataclass(frozen=True, kw_only=True)
class Trial:
    """The error of a scene on a grid."""

    scene: Scene
    error: float


@dataclass(frozen=True, kw_only=True)
class Spread:
    """How well the errors of all scenes follow one power of the cells across some length."""

    length: str
    exponent: float
    factor: float
    """exp of the standard deviation of log(error) about the power law."""


def compare(findings: Findings) -> list[Spread]:
    """The errors of a study against the cells across each length, the one that brings them closest together first."""
    study = findings.study
    trials = [
        Trial(scene=with_resolution(scene, own(cells)), error=findings.lasting(own(cells))[name])
        for name, scene in study.scenes.items()
        for cells in study.cells
    ]
    return sorted((spread(length, of, trials) for length, of in LENGTHS.items()), key=lambda each: each.factor)


def spread(length: str, of: Callable[[Scene], float], trials: Sequence[Trial]) -> Spread:
    """Fit one power of the cells across a length to the errors of all trials."""
    cells = np.log([of(trial.scene) / trial.scene.domain.cell for trial in trials])
    errors = np.log([trial.error for trial in trials])
    exponent, offset = np.polyfit(cells, errors, 1)
    rest = errors - (offset + exponent * cells)
    return Spread(
        length=length,
        exponent=float(exponent),
        factor=math.exp(math.sqrt(float(np.sum(rest**2)) / (len(trials) - 2))),
    )
