"""Scenes that no surrogate has learned from, the MPM's deposits of them on fine cells, and errors against these.

The scenes are drawn by the definitions that draw the training data, with another seed: no stream of random numbers is
shared. Variants of other scenes are left out.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
from numpy.typing import NDArray

from datasets import measures
from datasets.definitions import flow2d, obstacle3d, paper_families
from datasets.measures import Positions
from datasets.particles import initial_particles
from datasets.scene import Domain, Scene
from datasets.trajectory import Trajectory
from gns.score import Deposit
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
AT_WALL = 0.01
"""A front within this fraction of the box's length of the wall ahead leans on it, which then bounds everyone's."""


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
    return Deposit.of_positions(initial_particles(flow.scene).positions, flow.positions[-1], flow.volumes)


def at_wall(deposit: Deposit, scene: Scene) -> bool:
    """Whether the front leans on the wall ahead, which then bounds everyone's."""
    length = scene.domain.size[0]
    return (length - deposit.front if deposit.side == 1 else deposit.front) < AT_WALL * length


@dataclass(frozen=True, kw_only=True)
class Measured:
    """One scene by one method; errors are over the extent of the reference's deposit [-], as those of a `Score`."""

    seconds: float
    """On one thread, without compilation and without loading a model [s]."""
    front: float
    profile: float
    depth: float | None = None
    """Of the depths before the baffles: its rms over that of the reference's depths; None where nothing lies there."""

    @staticmethod
    def of_flow(flow: Trajectory, reference: Deposit) -> "Measured":
        front, profile = reference.errors(flow.positions[-1], flow.volumes)
        shown = depths(flow.scene, flow.positions[-1], flow.volumes)
        known = depths(flow.scene, reference.positions, reference.volume)
        depth = float(np.linalg.norm(shown - known) / np.linalg.norm(known)) if known.any() else None
        return Measured(seconds=flow.summary["wall_s"], front=front, profile=profile, depth=depth)


def depths(scene: Scene, positions: Positions, volume: NDArray[np.floating]) -> NDArray[np.float64]:
    """Mean depth of a deposit before each of the baffles, as if none were turned [m], shape [B].

    Over its width, and as far upstream as it is high; each particle is a cube of its volume.
    """
    found, plan = np.zeros(len(scene.baffles)), positions[:, [0, *range(2, positions.shape[1])]]
    edge = volume[:, None] ** (1.0 / positions.shape[1])
    for index, each in enumerate(scene.baffles):
        _, height, *width = each.size
        low, size = np.array([each.lower[0] - height, *each.lower[2:]]), np.array([height, *width])
        within = np.minimum(plan + 0.5 * edge, low + size) - np.maximum(plan - 0.5 * edge, low)
        found[index] = (volume * (np.maximum(within, 0.0) / edge).prod(axis=1)).sum() / size.prod()
    return found


def creep(rollout: Trajectory) -> float:
    """Speed of the faster of a deposit's ends over the second half of a rollout, outwards [mm/s]."""
    middle = len(rollout.positions) // 2
    seconds = float(rollout.time[-1] - rollout.time[middle])
    old, new = (measures.ends(rollout.positions[frame], rollout.volumes) for frame in (middle, -1))
    return 1000.0 * max(old[0] - new[0], new[1] - old[1], key=abs) / seconds


def mean(values: Sequence[float]) -> float:
    """Mean of the absolute values; nan of none."""
    return float(np.mean(np.abs(values))) if values else math.nan


def worst(values: Sequence[float]) -> float:
    """The value of the largest amount, with its sign; nan of none."""
    return max(values, key=abs) if values else math.nan
