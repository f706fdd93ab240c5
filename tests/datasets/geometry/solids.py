"""Scenes of solids alone, for the tests of their geometry."""

from typing import Any

import manifold3d
import numpy as np
from numpy.typing import NDArray

from datasets.geometry.surface import surface_of
from datasets.scene import Mass, Scene, Solid
from tests import scenes

surface = surface_of
QUADS = ((1, 2, 3, 4), (5, 8, 7, 6), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 8, 4), (4, 8, 5, 1))
"""Of a cube, outwards."""
CUBE = np.array([(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1), (0, 1, 0), (1, 1, 0), (1, 1, 1), (0, 1, 1)], float)
"""Its corners."""


def scene_of(*solids: Solid, size: tuple[float, ...] = (2.0, 1.0), cell: float = 0.02, **others: Any) -> Scene:
    """A scene with `solids` and a small body under the top of the box, at its far end."""
    body = tuple(0.99 * length for length in size), tuple(0.01 * length for length in size)
    return scenes.scene_of(Mass(lower=body[0], size=body[1]), size=size, cell=cell, solids=solids, **others)


def sphere(centre: tuple[float, ...], radius: float, segments: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices [V, 3] and triangles [T, 3] of a sphere with so many segments around."""
    mesh = manifold3d.Manifold.sphere(radius, segments).to_mesh64()
    return np.array(mesh.vert_properties[:, :3]) + centre, np.array(mesh.tri_verts, np.int64)


def as_rows(array: NDArray[np.generic]) -> tuple[tuple[float, ...], ...]:
    return tuple(map(tuple, array.tolist()))
