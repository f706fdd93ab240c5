"""The boundary of everything solid in a scene, as segments or triangles with normals, labels and friction.

All baffles and solids of a scene are one solid in contact, their union: what touches has no joint between. It goes on
some cells beyond the box where it reaches a side of it, so that no face lies on a side. The sign of a distance from it
comes from angle-weighted pseudonormals (Baerentzen & Aanaes 2005, https://doi.org/10.1109/TVCG.2005.49).
"""

import dataclasses
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from datasets.geometry.margins import KEPT, Box
from datasets.geometry.solid import Solid
from datasets.scene import Scene

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """The boundary of the union of all solids of a scene; F faces in D dimensions."""

    corners: Floats
    """Ends of segments, the solid on the left, or corners of triangles, anticlockwise from outside [m], [F, D, D]."""
    normals: Floats
    """Outward unit normals, shape [F, D]."""
    corner_normals: Floats
    """Pseudonormals at the corners, of unit length, shape [F, D, D]."""
    edge_normals: Floats
    """Pseudonormals of the edges of triangles, shape [F, 3, 3]; edge k joins corners k and k + 1. [F, 0, 2] in 2D."""
    solid: NDArray[np.int32]
    """The solid that each face belongs to: first the scene's baffles, then its solids; shape [F]."""
    friction: Floats
    """Coulomb coefficient at the corners [-], linear between them; inf without slip; shape [F, D]."""
    adhesion: Floats
    """Tension that each face bears [Pa], shape [F]."""

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return int(self.corners.shape[-1])


def surface_of(scene: Scene) -> Surface | None:
    """The surface of all baffles and solids of `scene`; None where it has none. Raises InputError.

    The same scene, or one with the same box and solids, gives the same object.
    """
    if not scene.baffles and not scene.solids:
        return None
    return surface_in(Box(scene.domain.size, scene.domain.cell), *solids_of(scene))


def solids_of(scene: Scene) -> tuple[tuple[Solid, ...], tuple[str, ...]]:
    """Everything solid in `scene`, in the order of its numbers, and the keys of each."""
    baffles = [
        Solid(
            lower=each.lower,
            size=each.size,
            turned_deg=each.turned_deg,
            friction=scene.baffle_friction if each.friction is None else each.friction,
        )
        for each in scene.baffles
    ]
    keys = [f"{kind}[{index}]" for kind in ("baffles", "solids") for index in range(len(getattr(scene, kind)))]
    return (*baffles, *scene.solids), tuple(keys)


@lru_cache(maxsize=32)
def surface_in(box: Box, solids: tuple[Solid, ...], keys: tuple[str, ...]) -> Surface:
    """The surface of `solids` in `box`; errors name the keys."""
    # The libraries of solid geometry load only where there is something solid.
    if box.dimension == 2:
        from datasets.geometry import planar

        segments = planar.boundary([planar.ring_of(*each, box) for each in zip(solids, keys, strict=True)], box)
        corners, corner_normals, owner, friction = (
            segments.corners,
            segments.corner_normals,
            segments.ring,
            segments.friction,
        )
        along = corners[:, 1] - corners[:, 0]
        normals = planar.unit(np.stack([along[:, 1], -along[:, 0]], axis=1))
        edge_normals = np.zeros((len(corners), 0, 2))
    else:
        from datasets.geometry import spatial

        triangles = spatial.boundary([spatial.body_of(*each, box) for each in zip(solids, keys, strict=True)], box)
        corners, corner_normals, owner, friction = (
            triangles.corners,
            triangles.corner_normals,
            triangles.body,
            triangles.friction,
        )
        normals, edge_normals = triangles.normals, triangles.edge_normals
    stuck = np.array([solid.contact == "no-slip" for solid in solids])[owner]
    everything = Surface(
        corners=corners,
        normals=normals,
        corner_normals=corner_normals,
        edge_normals=edge_normals,
        solid=owner,
        friction=np.where(stuck[:, None], np.inf, friction),
        adhesion=np.array([solid.adhesion for solid in solids])[owner],
    )
    margin = KEPT * box.cell
    near = (corners.max(axis=1) >= -margin).all(axis=1) & (corners.min(axis=1) <= np.array(box.size) + margin).all(
        axis=1
    )
    return Surface(**{field.name: getattr(everything, field.name)[near] for field in dataclasses.fields(Surface)})
