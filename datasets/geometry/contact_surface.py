"""The solids of a scene for the contact search: listed faces, and the raster of a 3D terrain itself.

Contact with a smooth bed uses the raster (`mpm.solids.bed`), of which no triangle is stored. The faces of all other
solids are united with each other (`datasets.geometry.surface`) but not with the terrain: if one of them stands in the
ground, the nearer of both counts. The face on which it stands is no surface.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from datasets.geometry.closed import pseudonormals
from datasets.geometry.ground import CLOSING, TOUCHING, Floats, grid_triangles, ground_grid, interpolated
from datasets.geometry.surface import Surface, solids_of, surface_in
from datasets.scene.parts import Domain, SceneLayout, Solid

DOWNWARD = -0.5  # largest upward component of the normal of faces on which a solid stands, if they lie in the ground
PARTS = np.linspace(0.0, 1.0, 17).tolist()
PLACES = np.array([[u, v, 1.0 - u - v] for u in PARTS for v in PARTS if u + v <= 1.0])
"""Weights of the corners at places all over a triangle."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HeightField:
    """A raster of X times Z posts, linear on two triangles a cell (`datasets.geometry.ground.grid_triangles`)."""

    x: Floats  # of the posts [m], shape [X]: evenly spaced except one post at either end, far beyond the box
    z: Floats  # [m], shape [Z]
    heights: Floats  # [m], shape [X, Z]
    friction: Floats  # Coulomb coefficient [-], shape [X, Z], or [1, 1] if it is uniform; inf without slip
    solid: int  # its index among the solids of its scene

    @property
    def steepest(self) -> float:
        """A slope that no triangle exceeds [-]."""
        along = np.abs(np.diff(self.heights, axis=0)).max(axis=1) / np.diff(self.x)
        across = np.abs(np.diff(self.heights, axis=1)).max(axis=0) / np.diff(self.z)
        return float(np.hypot(along.max(), across.max()))

    def elevation(self, points: Floats) -> Floats:
        """Elevation of the raster, shape [N], above or below points [m], shape [N, 3]."""
        return interpolated((self.x, self.z), self.heights, points[:, ::2])

    def around(self, low: Floats, high: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """x, z, heights and friction, both [X, Z], of the posts over a rectangle from `low` to `high` [m], shape [2].
        They include the cells around, so that the normals inside are those of the whole raster."""
        sides = (self.x, low[0], high[0]), (self.z, low[1], high[1])
        ends = [np.searchsorted(axis, (near - TOUCHING, far + TOUCHING)).tolist() for axis, near, far in sides]
        rows, columns = (slice(max(first - 2, 0), last + 2) for first, last in ends)
        friction = np.broadcast_to(self.friction, self.heights.shape)[rows, columns]
        return self.x[rows], self.z[columns], self.heights[rows, columns], friction

    def triangles(self, low: Floats, high: Floats) -> Surface:
        """The triangles of the posts `around` a rectangle."""
        x, z, heights, friction = self.around(low, high)
        plan = np.stack(np.meshgrid(x, z, indexing="ij"), axis=-1)
        vertices = np.stack([plan[..., 0], heights, plan[..., 1]], axis=-1).reshape(-1, 3)
        faces = grid_triangles(heights)
        solid = np.full(len(faces), self.solid, np.int32)
        return Surface(vertices[faces], *pseudonormals(vertices, faces), solid, friction.ravel()[faces])


@dataclass(frozen=True, kw_only=True, eq=False)
class ContactSurface:
    """The boundary of all solids: F listed faces, and a raster."""

    faces: Surface
    field: HeightField | None

    def around(self, points: Floats, reach: float) -> Surface:
        """The listed faces, and the triangles of the raster within `reach` [m] of points [m], shape [N, D]."""
        if self.field is None:
            return self.faces
        plan = points[:, ::2]
        ground = vars(self.field.triangles(plan.min(axis=0) - reach, plan.max(axis=0) + reach))
        return Surface(**{name: np.concatenate([array, ground[name]]) for name, array in vars(self.faces).items()})


def has_field(scene: SceneLayout) -> bool:
    """Whether a terrain in a scene is a height field: in 3D, and the only one."""
    return scene.dimension == 3 and sum(solid.kind == "terrain" for solid in scene.solids) == 1


def has_faces(scene: SceneLayout) -> bool:
    """Whether a scene has solids whose faces are listed."""
    return len(scene.baffles) + len(scene.solids) > int(has_field(scene))


def contact_surface_of(scene: SceneLayout) -> ContactSurface | None:
    """The surface of all baffles and solids of a scene, one object for equal ones; None without. Raises InputError."""
    if not scene.baffles and not scene.solids:
        return None
    if not has_field(scene):
        return ContactSurface(faces=surface_in(scene.domain, *solids_of(scene)), field=None)
    return contact_surface_in(scene.domain, *solids_of(scene))


@lru_cache(maxsize=4)
def contact_surface_in(domain: Domain, solids: tuple[Solid, ...], keys: tuple[str, ...]) -> ContactSurface:
    """The surface of `solids` in a box in 3D, of which one is terrain; errors name the keys."""
    (number,) = (index for index, solid in enumerate(solids) if solid.kind == "terrain")
    field = height_field(solids[number], keys[number], number, domain)
    others = [index for index in range(len(solids)) if index != number]
    if not others:
        return ContactSurface(faces=Surface.empty(3), field=field)
    surface = surface_in(domain, *(tuple(given[index] for index in others) for given in (solids, keys)))
    down, kept = np.flatnonzero(surface.normals[:, 1] < DOWNWARD), np.full(len(surface.solid), True)
    places = np.einsum("pc,fcd->fpd", PLACES, surface.corners[down])
    above = places[:, :, 1] - field.elevation(places.reshape(-1, 3)).reshape(places.shape[:2])
    kept[down] = (above > CLOSING * domain.cell).any(axis=1)  # except those on the ground or in it
    faces = surface.chosen(kept)
    return ContactSurface(faces=replace(faces, solid=np.array(others, np.int32)[faces.solid]), field=field)


def height_field(solid: Solid, key: str, number: int, domain: Domain) -> HeightField:
    """The raster of a terrain, to some cells beyond the box. Raises InputError."""
    (x, z), heights, friction = ground_grid(solid, key, domain)
    if solid.contact == "no-slip":
        friction = np.full((1, 1), np.inf)
    elif friction.min() == friction.max():
        friction = friction[:1, :1]
    return HeightField(x=x, z=z, heights=heights, friction=friction, solid=number)
