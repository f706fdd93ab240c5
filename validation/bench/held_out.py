"""Scenes that no surrogate has learned from, the MPM's deposits of them on fine cells, and errors against these.

The scenes are drawn by the definitions that draw the training data, with another seed: no stream of random numbers is
shared. Variants of other scenes are left out.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from datasets.definitions import flow2d, obstacle3d, paper_families
from datasets.flow import measures
from datasets.flow.measures import Deposit
from datasets.flow.trajectory import Trajectory
from datasets.scene import Domain, Mass, Scene
from datasets.scene.material import Material
from datasets.scene.particles import initial_particles
from mpm.resolution import ROUNDING, characteristic_length, fitted_cell

SEED = 1
"""Of the held-out scenes; the training data have 0."""
FAMILIES = {
    "columns2d": (paper_families.COLUMNS, paper_families.COLUMNS2D),
    "flow2d": (flow2d.KINDS, flow2d.FLOW2D),
    "baffles3d": (paper_families.BAFFLES, paper_families.BAFFLES3D),
    "obstacle3d": (obstacle3d.KINDS, obstacle3d.OBSTACLE3D),
}
"""Kinds of flows and definition of the training data, by its name."""
CREST = ((0.3, 0.0), (1.1, 0.0), (0.7, 0.2))
MOUNDS: dict[str, tuple[float, float]] = {
    "45° on 12°": (45.0, 12.0),
    "42° on 8°": (42.0, 8.0),
    "35° on the level": (35.0, 0.0),
}
"""Angles of friction and of the floor [deg] under which a mound of the corners `CREST` [m] stays where it is."""


def held_out(family: str, number: int) -> list[tuple[str, Scene]]:
    """So many scenes that no training data have, with their kinds: the first of every kind, then the second, ..."""
    drawn, definition = FAMILIES[family]
    kinds = [each.__name__.replace("_", " ") for each in drawn]
    found: dict[str, list[tuple[str, Scene]]] = {kind: [] for kind in kinds}
    rounds, streams = math.ceil(number / len(found)), set[int]()
    for index in count():
        if all(len(each) == rounds for each in found.values()):
            break
        kind, stream = kinds[index % len(kinds)], definition.stream(index)
        if stream not in streams and len(found[kind]) < rounds:
            streams.add(stream)
            found[kind].append((kind, definition.draw(np.random.default_rng([SEED, stream]), index)))
    return [each for group in zip(*found.values(), strict=True) for each in group][:number]


def coarse(scene: Scene, cells: int) -> Scene:
    """A scene on so many cells across the smallest side of its body, or a few more.

    Its box is made higher by part of a cell where it has to be: else its height, a whole number of fine cells, would
    decide which coarser ones fit.
    """
    length, height, *width = scene.domain.size
    plan = replace(scene.domain, size=(length, length, *width))
    cell = fitted_cell(plan, characteristic_length(scene) / cells)
    domain = Domain(size=(length, math.ceil(height / cell - ROUNDING) * cell, *width), cell=cell)
    return replace(scene, domain=domain, particles_per_axis=2, step_fraction=0.9)


def deposit_of(flow: Trajectory) -> Deposit:
    """That of a reference: the MPM on fine cells."""
    scene, start = flow.scene, initial_particles(flow.scene).positions
    return Deposit.of_positions(start, flow.positions[-1], flow.volumes, scene.domain.size, measures.ground_of(scene))


@dataclass(frozen=True, kw_only=True)
class Measured(measures.Errors):
    """One scene by one method, and its errors beside the reference's deposit."""

    seconds: float
    """On one thread, without compilation and without loading a model [s]."""

    @staticmethod
    def of_flow(flow: Trajectory, reference: Deposit) -> "Measured":
        errors = reference.errors(flow.positions[-1], flow.volumes)
        return Measured(seconds=flow.summary["wall_s"], **vars(errors))


def mound(title: str, seed: int) -> Scene:
    """One of the `MOUNDS`: less steep than its angle of friction, so that it is stable."""
    friction_deg, slope_deg = MOUNDS[title]
    return Scene(
        domain=Domain(size=(2.0, 0.4), cell=0.01),
        material=Material(friction_deg=friction_deg),
        masses=(Mass(kind="polygon", vertices=CREST),),
        duration=1.5,
        frame_dt=0.02,
        floor_friction=0.9,
        slope_deg=slope_deg,
        seed=seed,
    )


def creep(flow: Trajectory, share: float = 0.5) -> float:
    """Speed of the faster of a deposit's ends over the last `share` of a flow, outwards [mm/s]."""
    first = round((1.0 - share) * (len(flow.positions) - 1))
    seconds = float(flow.time[-1] - flow.time[first])
    old, new = (measures.ends(flow.positions[frame], flow.volumes) for frame in (first, -1))
    return 1000.0 * max(old[0] - new[0], new[1] - old[1], key=abs) / seconds


def mean(values: Sequence[float]) -> float:
    """Mean of the absolute values; nan of none."""
    return float(np.mean(np.abs(values))) if values else math.nan


def worst(values: Sequence[float]) -> float:
    """The value of the largest amount, with its sign; nan of none."""
    return max(values, key=abs) if values else math.nan
