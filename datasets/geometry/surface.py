"""The boundary of everything solid in a scene, as segments or triangles with normals, labels and friction.

All baffles and solids of a scene are one solid in contact, their union: what touches has no joint between. It goes on
some cells beyond the box where it reaches a side of it, so that no face lies on a side. The sign of a distance from it
comes from angle-weighted pseudonormals (Baerentzen & Aanaes 2005, https://doi.org/10.1109/TVCG.2005.49).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from datasets.scene import Domain, Scene, Solid

Floats = NDArray[np.float64]

KEPT = 3.0
"""Cells beyond the box in which faces are kept: the grid ends there (`mpm.arrays.layout.PADDING`)."""


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
    return surface_in(scene.domain, *solids_of(scene))


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
def surface_in(domain: Domain, solids: tuple[Solid, ...], keys: tuple[str, ...]) -> Surface:
    """The surface of `solids` in a box; errors name the keys."""
    # The libraries of solid geometry load only where there is something solid.
    if domain.dimension == 2:
        from datasets.geometry import planar

        found = planar.boundary([planar.ring_of(*each, domain) for each in zip(solids, keys, strict=True)], domain)
    else:
        from datasets.geometry import spatial

        found = spatial.boundary([spatial.body_of(*each, domain) for each in zip(solids, keys, strict=True)], domain)
    stuck = np.array([solid.contact == "no-slip" for solid in solids])[found["solid"]]
    found["friction"] = np.where(stuck[:, None], np.inf, found["friction"])
    found["adhesion"] = np.array([solid.adhesion for solid in solids])[found["solid"]]
    margin, high = KEPT * domain.cell, np.array(domain.size)
    corners = found["corners"]
    near = ((corners.max(axis=1) >= -margin) & (corners.min(axis=1) <= high + margin)).all(axis=1)
    return Surface(**{name: values[near] for name, values in found.items()})
