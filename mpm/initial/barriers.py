"""Where the gates of a held mass stand: which nodes of the grid they hold.

A gate is a smooth vertical wall at a lateral face of a mass: the nodes from the face to `BEYOND` cells outside of it
have no velocity across it. These are all nodes beyond the face that the mass's own particles reach, so none of it
passes. A face that lies on a wall of the box needs no gate.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datasets.particles import Particles
from datasets.scene import TOLERANCE, Mass, Scene
from mpm.arrays.layout import PADDING, Held, Holding
from mpm.arrays.layout import Gate as GateColumn
from mpm.physics.barriers import ENERGY, FORCE

BEYOND = 2
"""Cells beyond a face in which nodes are held: a quadratic B-spline reaches one and a half."""

Range = NDArray[np.int32]
"""Indices of nodes, [low, high) per axis, shape [2, D]."""


@dataclass(frozen=True)
class Gate:
    """The nodes that a gate holds."""

    axis: int
    """Across which it stands: 0 or 2."""
    nodes: Range


def gates(scene: Scene, mass: Mass) -> list[Gate]:
    """The gates of `mass`, one for each lateral face that is not on a wall of the box."""
    found = []
    for axis in (0, 2)[: scene.dimension - 1]:
        low, high = mass.lower[axis], mass.lower[axis] + mass.size[axis]
        around = nodes_around(scene, mass)
        if low > TOLERANCE:
            nodes = around.copy()
            nodes[:, axis] = (face := floor_node(scene, low)) - BEYOND, face + 1
            found.append(Gate(axis, nodes))
        if high < scene.domain.size[axis] - TOLERANCE:
            nodes = around.copy()
            nodes[:, axis] = (face := ceiling_node(scene, high)), face + BEYOND + 1
            found.append(Gate(axis, nodes))
    return found


def nodes_around(scene: Scene, mass: Mass) -> Range:
    """The nodes in the box of `mass` and up to BEYOND cells around it; below it only where it stands on the floor."""
    low = [floor_node(scene, length) - BEYOND for length in mass.lower]
    high = [ceiling_node(scene, a + b) + BEYOND + 1 for a, b in zip(mass.lower, mass.size, strict=True)]
    if mass.lower[1] > TOLERANCE:
        # What lies below is another mass's: its gates are its own.
        low[1] = ceiling_node(scene, mass.lower[1])
    return np.array([low, high], np.int32)


def floor_node(scene: Scene, length: float) -> int:
    """The last node at or before a coordinate [m]."""
    return PADDING + int(np.floor((length + TOLERANCE) / scene.domain.cell))


def ceiling_node(scene: Scene, length: float) -> int:
    """The first node at or after a coordinate [m]."""
    return PADDING + int(np.ceil((length - TOLERANCE) / scene.domain.cell))


def inside(nodes: Range, indices: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of the nodes with `indices`, shape [n, D], are in a range; shape [n]."""
    return np.asarray(((indices >= nodes[0]) & (indices < nodes[1])).all(axis=1))


def gate_rows(scene: Scene, held: int) -> list[list[int]]:
    """Lines of the array `gates` for the held masses of `scene`, of which the first is line `held` of `held`."""
    rows = []
    for number, mass in enumerate(held_masses(scene).values()):
        found = [(gate.axis, gate.nodes) for gate in gates(scene, mass)]
        if mass.release == "settled":
            low = [floor_node(scene, length) for length in mass.lower]
            high = [ceiling_node(scene, a + b) + 1 for a, b in zip(mass.lower, mass.size, strict=True)]
            found.append((len(GateColumn), np.array([low, high], np.int32)))
        for axis, nodes in found:
            row = dict.fromkeys(GateColumn, 0) | {GateColumn.HELD: held + number, GateColumn.AXIS: axis}
            for k in range(scene.dimension):
                row[GateColumn(GateColumn.LOW_X + k)] = int(nodes[0, k])
                row[GateColumn(GateColumn.HIGH_X + k)] = int(nodes[1, k])
            rows.append([row[column] for column in GateColumn])
    return rows


def held_rows(scene: Scene, particles: Particles) -> list[list[int]]:
    """Lines of the array `held`, in the order of `Held`, one for each held mass of `scene`."""
    rows = []
    for index, mass in held_masses(scene).items():
        mine = np.flatnonzero(particles.mass == index)
        values = dict.fromkeys(Held, 0) | {
            Held.FIRST: int(mine[0]),
            Held.LAST: int(mine[-1]) + 1,
            Held.RELEASE: 0 if isinstance(mass.release, str) else round((mass.release or 0.0) / scene.frame_dt),
        }
        rows.append([values[column] for column in Held])
    return rows


def holding_rows(scene: Scene, particles: Particles) -> list[list[float]]:
    """Lines of the array `holding`, in the order of `Holding`, one for each held mass of `scene`."""
    rows = []
    for index, mass in held_masses(scene).items():
        particle = float(particles.volume[particles.mass == index][0])
        material, height = scene.material_of(mass), mass.size[1]
        weight, speed = material.density * float(np.prod(mass.size)), scene.gravity * height / material.wave_speed
        values = dict.fromkeys(Holding, 0.0) | {
            Holding.RATE: np.pi * material.wave_speed / height,
            Holding.PARTICLE: material.density * particle,
            Holding.MOST_KINETIC: ENERGY * 0.5 * weight * speed**2,
            Holding.MOST_IMPULSE: FORCE * weight * scene.gravity * scene.frame_dt,
        }
        rows.append([values[column] for column in Holding])
    return rows


def held_masses(scene: Scene) -> dict[int, Mass]:
    """The masses that begin behind gates, by their index."""
    return {index: mass for index, mass in enumerate(scene.masses) if mass.release is not None}


def release_times(scene: Scene, opened: NDArray[np.int32]) -> list[float | None] | None:
    """When each mass was let go [s]: 0 where it was never held, None where it still is; None for a scene without gates.

    opened: the frames in which the gates of the held masses opened, 0 where they did not.
    """
    held = held_masses(scene)
    if not held:
        return None
    frames = dict(zip(held, opened.tolist(), strict=True))
    return [(frames[k] * scene.frame_dt or None) if k in frames else 0.0 for k in range(len(scene.masses))]
