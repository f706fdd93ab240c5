"""Where the gates of a held mass stand: which nodes of the grid they hold.

A gate is a smooth vertical wall at a lateral face of a mass: the nodes from the face to `BEYOND` cells outside of it have
no velocity across it. The nodes between are those to which the mass's own particles reach, so nothing of the mass passes.
A face that lies on a wall of the box needs no gate.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datasets.scene import TOLERANCE, Mass, Scene
from mpm.layout import PADDING

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
