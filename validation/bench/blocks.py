"""The paper's column of ten layers cut into 1 to 100 blocks, whose velocities are unknown."""

import dataclasses
from itertools import product

import numpy as np
from numpy.typing import NDArray

from datasets.library import read_scene
from datasets.scene import Mass, Scene
from inverse.parameters import Parameter
from inverse.problem import Problem
from inverse.settings import ObservationSettings, TargetSettings

SCENE = "layers-10"
CUTS = {1: (1, 1), 10: (1, 10), 100: (10, 10)}
"""Blocks along x and along y, by the number of unknowns."""
AT_FLOOR, AT_TOP = 1.5, 0.15
"""True velocities [m/s], about the paper's; a block has that of its middle."""
FRACTION = 0.5
"""Of the true velocities: where the gradient is evaluated."""
STEPS = {1: 0.15, 10: 0.15, 100: 0.5}
"""Step of the differences [m/s]: a smaller part of the sand moves the deposit less."""
MOST_COLUMNS = 10
"""Unknowns whose differences are run; the seconds of more are multiplied."""
HUNDRED = "velocity-blocks-100"
"""The problem of a hundred blocks; a start of 0.75 m/s and the bounds of `velocity-layers-10`."""


def blocks(columns: int, layers: int) -> Scene:
    """The layers' sand in `columns` times `layers` blocks at their true velocities, cut between its particles.

    However it is cut, its particles are the same: no cut goes through a particle's share of a cell.
    """
    whole = read_scene(SCENE)
    spacing = whole.particle_spacing
    across = round(whole.masses[0].size[0] / spacing)
    up = round(max(mass.lower[1] + mass.size[1] for mass in whole.masses) / spacing)
    x, y = (np.round(np.linspace(0, count, parts + 1)) for count, parts in ((across, columns), (up, layers)))
    masses = []
    for j, i in product(range(layers), range(columns)):
        middle = (y[j] + y[j + 1]) / 2.0 / up
        masses.append(
            Mass(
                lower=(float(x[i] * spacing), float(y[j] * spacing)),
                size=(float((x[i + 1] - x[i]) * spacing), float((y[j + 1] - y[j]) * spacing)),
                velocity=(AT_FLOOR + (AT_TOP - AT_FLOOR) * float(middle), 0.0),
            )
        )
    return dataclasses.replace(whole, masses=tuple(masses))


def blocks_problem(unknowns: int, *, duration: float | None = None) -> Problem:
    """The velocities of so many blocks from their deposit; it starts at `FRACTION` of the true ones."""
    scene = blocks(*CUTS[unknowns])
    scene = scene if duration is None else dataclasses.replace(scene, duration=duration)
    return Problem(
        name=f"blocks-{unknowns}",
        scene=scene,
        parameters=tuple(
            Parameter(
                name=f"masses[{index}].velocity_x",
                initial=FRACTION * (mass.velocity or (0.0,))[0],
                lower=-3.0,
                upper=3.0,
            )
            for index, mass in enumerate(scene.masses)
        ),
        observations=(ObservationSettings(kind="deposit"),),
        target=TargetSettings(twin=True),
    )


def hundred_problem() -> Problem:
    """As `velocity-layers-10`, of a hundred blocks."""
    problem = blocks_problem(100)
    numbers = tuple(dataclasses.replace(each, initial=0.75, lower=-1.0, upper=3.0) for each in problem.parameters)
    return dataclasses.replace(problem, name=HUNDRED, parameters=numbers)


def sampled(count: int) -> NDArray[np.int64]:
    """Unknowns whose differences are run, ascending: all, or `MOST_COLUMNS` of them along the diagonal of the cuts."""
    return np.unique(np.linspace(0, count - 1, min(count, MOST_COLUMNS)).round().astype(np.int64))
