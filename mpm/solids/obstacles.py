"""The solids in the box for the kernel: faces, which of them are near a cell, nodes deep inside, and where
each particle touches at the start (`mpm.physics.contact`)."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.geometry.nearest import feet, nearest
from datasets.geometry.surface import Surface, surface_of
from datasets.scene import Domain, Scene
from mpm.arrays.layout import Contact
from mpm.arrays.properties import CONTACT_WIDTH, search_distance
from mpm.solids.faces import faces_near, node_shape

Array = NDArray[Any]

FIXED_DEPTH = 0.5
"""Depth [cells] from which nodes in a solid are held."""
NO_SLIP = 1.0e9
"""Coulomb coefficient that stands for no slip: times no pressure it is none."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Obstacles:
    """Solids for the kernel: F faces, C cells, K nodes that are held."""

    faces: Array
    """A line per face: corners [m], normals of face, corners and edges, friction at the corners [-], adhesion [Pa],
    number of its solid; see `mpm.arrays.layout.Features.face_normal` and what follows it; shape [F, columns]."""
    cell_faces: Array
    """Where the list of each cell begins in `near_faces`, shape [C + 1]."""
    near_faces: Array
    """The faces near the cells."""
    fixed_nodes: Array
    """1 + the line of each node in `node_contacts`, 0 where no solid holds it, shape [C + 1]."""
    node_contacts: Array
    """Of each held node the normal, friction and the number of its solid, shape [K, D + 2]."""


@dataclass(frozen=True, kw_only=True)
class FirstEntries:
    """Where those of one scene begin among the obstacles of several."""

    cell: int
    """In `cell_faces` and `fixed_nodes`."""
    face: int
    """In `faces`."""


def obstacles_of(scenes: Sequence[Scene], dimension: int) -> tuple[Obstacles, list[FirstEntries]]:
    """The solids of several scenes in `dimension` dimensions in one, and where each scene's begin.

    Raises InputError as `datasets.geometry.surface.surface_of`.
    """
    parts = [obstacles_in(scene) for scene in scenes]
    firsts = [FirstEntries(cell=0, face=0)]
    near = fixed = 0
    none = np.zeros(0, np.int32)
    cell_faces, near_faces, fixed_nodes = [none], [none], [none]
    for part in parts:
        first = firsts[-1]
        cell_faces.append(part.cell_faces + near)
        near_faces.append(part.near_faces + first.face)
        fixed_nodes.append(np.where(part.fixed_nodes > 0, part.fixed_nodes + fixed, 0))
        near, fixed = near + len(part.near_faces), fixed + len(part.node_contacts)
        firsts.append(FirstEntries(cell=first.cell + len(part.cell_faces), face=first.face + len(part.faces)))
    together = Obstacles(
        faces=np.concatenate([np.zeros((0, face_columns(dimension))), *(part.faces for part in parts)]),
        cell_faces=np.concatenate(cell_faces),
        near_faces=np.concatenate(near_faces),
        fixed_nodes=np.concatenate(fixed_nodes),
        node_contacts=np.concatenate([np.zeros((0, dimension + 2)), *(part.node_contacts for part in parts)]),
    )
    return together, firsts[:-1]


def obstacles_in(scene: Scene) -> Obstacles:
    """The solids of one scene, with faces listed up to a cell beyond the distance that is searched; empty without any.

    A particle from farther away needs more than a step to come within that distance.
    """
    surface = surface_of(scene)
    if surface is None:
        columns, none = face_columns(scene.dimension), np.zeros(int(np.prod(node_shape(scene.domain))) + 1, np.int32)
        return Obstacles(
            faces=np.zeros((0, columns)),
            cell_faces=none,
            near_faces=none[:0],
            fixed_nodes=none,
            node_contacts=np.zeros((0, scene.dimension + 2)),
        )
    return obstacles_with(surface, scene.domain, 1.0 + search_distance(scene) / scene.domain.cell)


@lru_cache(maxsize=32)
def obstacles_with(surface: Surface, domain: Domain, cutoff: float) -> Obstacles:
    """The solids with `surface` in a box, listed up to `cutoff` cells from it; runs of one geometry share them."""
    near = faces_near(domain, surface, cutoff=cutoff)
    deep = np.flatnonzero(near.distance <= -FIXED_DEPTH * domain.cell * (1.0 - 1.0e-9))
    fixed = np.zeros(len(near.first), np.int32)
    fixed[near.nodes[deep]] = np.arange(1, len(deep) + 1)
    count = len(surface.corners)
    return Obstacles(
        faces=np.concatenate(
            [
                *(
                    part.reshape(count, -1)
                    for part in (surface.corners, surface.normals, surface.corner_normals, surface.edge_normals)
                ),
                np.minimum(surface.friction, NO_SLIP),
                surface.adhesion[:, None],
                surface.solid[:, None],
            ],
            axis=1,
        ),
        cell_faces=near.first,
        near_faces=near.faces,
        fixed_nodes=fixed,
        node_contacts=np.concatenate(
            [near.normal[deep], np.minimum(near.friction[deep], NO_SLIP)[:, None], near.solid[deep, None]], axis=1
        ),
    )


def face_columns(dimension: int) -> int:
    """Numbers in a line of `Obstacles.faces`."""
    normals = 1 + dimension + (3 if dimension == 3 else 0)
    return dimension * (dimension + normals + 1) + 2


def initial_contacts(scene: Scene, positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Contact of particles at `positions` [m], shape [N, D], as the kernel finds it: what `Contact` lists, [N, ...]."""
    count, dimension = positions.shape
    found = np.zeros((count, len(Contact) - 1 + 2 * dimension))
    found[:, Contact.DISTANCE] = np.inf
    surface = surface_of(scene)
    if surface is None:
        return found
    width = CONTACT_WIDTH * scene.domain.cell
    cutoff = search_distance(scene) + scene.domain.cell
    nearest_points = nearest(surface, positions, cutoff)
    q = np.clip(nearest_points.distance / width, 0.0, 1.0)
    _, _, weights = feet(surface.corners[nearest_points.face], positions)
    found[:, Contact.DELTA] = 2.0 / width * (1.0 - q * q * (3.0 - 2.0 * q))
    found[:, Contact.DISTANCE] = np.clip(nearest_points.distance, 0.0, cutoff)
    found[:, Contact.ADHESION] = surface.adhesion[nearest_points.face]
    found[:, Contact.FRICTION] = (weights * np.minimum(surface.friction, NO_SLIP)[nearest_points.face]).sum(axis=1)
    found[:, Contact.FACE] = nearest_points.face
    found[:, Contact.NORMAL : Contact.NORMAL + dimension] = nearest_points.normal
    return found
