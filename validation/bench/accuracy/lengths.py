"""Across which length of a mass its cells are to be counted, so that an error carries over to other shapes."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from datasets.scene import Scene
from mpm.resolution import characteristic_length, with_resolution
from validation.bench.accuracy.studies import Findings, own

SMALLEST = "smallest side"
LENGTHS: dict[str, Callable[[Scene], float]] = {
    SMALLEST: characteristic_length,
    "length": lambda scene: scene.masses[0].size[0],
    "height": lambda scene: scene.masses[0].size[1],
    "root of the area": lambda scene: math.sqrt(scene.masses[0].size[0] * scene.masses[0].size[1]),
}


@dataclass(frozen=True, kw_only=True)
class PowerOfCells:
    """The errors of all scenes as one power of the cells across a length."""

    length: str
    exponent: float
    factor: float
    """exp of the standard deviation of log(error) about the power law."""


def compare(findings: Findings) -> list[PowerOfCells]:
    """The errors of a study over the cells across each length, that with the smallest scatter first."""
    study = findings.study
    errors = [
        (with_resolution(scene, own(cells)), findings.lasting(own(cells))[name])
        for name, scene in study.scenes.items()
        for cells in study.cells
    ]
    return sorted((fit(length, errors) for length in LENGTHS), key=lambda each: each.factor)


def fit(length: str, errors: Sequence[tuple[Scene, float]]) -> PowerOfCells:
    """Fit one power of the cells across a length to the errors of scenes on their grids."""
    cells = np.log([LENGTHS[length](scene) / scene.domain.cell for scene, _ in errors])
    logs = np.log([error for _, error in errors])
    exponent, offset = np.polyfit(cells, logs, 1)
    residual = logs - (offset + exponent * cells)
    scatter = math.sqrt(float(np.sum(residual**2)) / (len(errors) - 2))
    return PowerOfCells(length=length, exponent=float(exponent), factor=math.exp(scatter))
