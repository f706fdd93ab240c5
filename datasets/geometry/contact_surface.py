"""Everything solid in a scene as contact finds it: faces that are listed, and the raster of a terrain in 3D itself.

The triangles of a raster follow from the place in plan, so none of them is stored. Where other solids stand in a
terrain, the cells of the raster around them are cut out of it, and their triangles, united with these solids, are faces
like others. Together they are the surface of `datasets.geometry.surface`.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from datasets.geometry.closed import Body, pseudonormals
from datasets.geometry.ground import BEYOND, CLOSING, TOUCHING, Floats, Integers, first_diagonal, grid_triangles
from datasets.geometry.ground import ground_grid as grid_of
from datasets.geometry.surface import (
    Surface,
    body_of,
    boundary,
    near_box,
    raster_body,
    solids_of,
    surface_in,
    without_slip,
)
from datasets.scene.parts import Domain, SceneLayout, Solid

Rectangle = tuple[int, int, int, int]
"""Cells of a raster: from and to before, along x and along z."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HeightField:
    """A raster of X times Z posts, linear on two triangles a cell (`datasets.geometry.ground.grid_triangles`)."""

    x: Floats
    """Of the posts [m], shape [X]: evenly apart but for one post at either end, far beyond the box."""
    z: Floats
    """[m], shape [Z]."""
    even: tuple[int, ...]
    """The first of the evenly spaced posts, along x and along z."""
    spacing: tuple[float, ...]
    """Between them [m]."""
    heights: Floats
    """[m], shape [X, Z]."""
    friction: Floats
    """Coulomb coefficient [-], shape [X, Z], or [1, 1] where it is one; inf without slip."""
    second: NDArray[np.bool_]
    """Whether the triangles of a cell meet along its second diagonal, shape [X - 1, Z - 1]."""
    cut: NDArray[np.bool_]
    """Whether the triangles of a cell are faces that are listed, shape [X - 1, Z - 1]."""
    solid: int
    """Its number among the solids of its scene."""

    @property
    def steepest(self) -> float:
        """A slope that no triangle exceeds [-]."""
        along = np.abs(np.diff(self.heights, axis=0)).max(axis=1) / np.diff(self.x)
        across = np.abs(np.diff(self.heights, axis=1)).max(axis=0) / np.diff(self.z)
        return float(np.hypot(along.max(), across.max()))

    def cells_over(self, low: Floats, high: Floats) -> Rectangle:
        """The cells that a rectangle in plan from `low` to `high` [m], shape [2], meets."""
        ends = []
        for axis, near, far in ((self.x, low[0], high[0]), (self.z, low[1], high[1])):
            at = np.searchsorted(axis, [near - TOUCHING, far + TOUCHING]) - 1
            ends.append(np.clip(at, 0, len(axis) - 2).tolist())
        (first, last), (before, end) = ends
        return first, last + 1, before, end + 1

    def grown(self, cells: Rectangle) -> Rectangle:
        """A rectangle and the cells around it."""
        rows, columns = self.cut.shape
        return max(cells[0] - 1, 0), min(cells[1] + 1, rows), max(cells[2] - 1, 0), min(cells[3] + 1, columns)

    def posts(self, cells: Rectangle) -> tuple[Floats, Floats, Floats, Floats]:
        """x, z, heights and friction, both [X, Z], of the posts of a rectangle of cells."""
        rows, columns = slice(cells[0], cells[1] + 1), slice(cells[2], cells[3] + 1)
        friction = np.broadcast_to(self.friction, self.heights.shape)[rows, columns]
        return self.x[rows], self.z[columns], self.heights[rows, columns], friction

    def triangles(self, cells: Rectangle) -> tuple[Surface, Integers]:
        """The triangles of a rectangle of cells that are not cut out, T of them, and their numbers, shape [T]."""
        around = self.grown(cells)
        x, z, heights, friction = self.posts(around)
        plan = np.stack(np.meshgrid(x, z, indexing="ij"), axis=-1)
        vertices = np.stack([plan[..., 0], heights, plan[..., 1]], axis=-1).reshape(-1, 3)
        faces = grid_triangles(heights)
        i, k = np.meshgrid(np.arange(*around[:2]), np.arange(*around[2:]), indexing="ij")
        inner = (i >= cells[0]) & (i < cells[1]) & (k >= cells[2]) & (k < cells[3])
        kept = np.repeat((inner & ~self.cut[i, k]).ravel(), 2)
        numbers = (2 * (i * self.cut.shape[1] + k).ravel()[:, None] + [0, 1]).ravel()
        solid = np.full(len(faces), self.solid, np.int32)
        found = Surface(vertices[faces], *pseudonormals(vertices, faces), solid, friction.ravel()[faces])
        return found.chosen(kept), numbers[kept]


@dataclass(frozen=True, kw_only=True, eq=False)
class ContactSurface:
    """The boundary of everything solid: F listed faces, and the triangles of a raster, whose numbers begin at F."""

    faces: Surface
    field: HeightField | None

    def near(self, low: Floats, high: Floats) -> tuple[Surface, Integers]:
        """The listed faces, and the raster's triangles over a rectangle in plan [m]; and their numbers, shape [T]."""
        numbers = np.arange(len(self.faces.corners))
        if self.field is None:
            return self.faces, numbers
        ground, own = self.field.triangles(self.field.cells_over(low, high))
        parts = {name: np.concatenate([array, vars(ground)[name]]) for name, array in vars(self.faces).items()}
        return Surface(**parts), np.concatenate([numbers, len(numbers) + own])

    def around(self, points: Floats, reach: float) -> tuple[Surface, Integers]:
        """`near` of all that is within `reach` [m] of points [m], shape [N, D]."""
        plan = points[:, ::2]
        return self.near(plan.min(axis=0) - reach, plan.max(axis=0) + reach)


def has_field(scene: SceneLayout) -> bool:
    """Whether a terrain in a scene is a height field: in 3D, and the only one."""
    return scene.dimension == 3 and sum(solid.kind == "terrain" for solid in scene.solids) == 1


def has_faces(scene: SceneLayout) -> bool:
    """Whether a scene has solids whose faces are listed."""
    return len(scene.baffles) + len(scene.solids) > int(has_field(scene))


def contact_surface_of(scene: SceneLayout) -> ContactSurface | None:
    """The surface of all baffles and solids of `scene`; None where it has none. Raises InputError.

    The same scene, or one with the same box and solids, gives the same object.
    """
    if not scene.baffles and not scene.solids:
        return None
    if not has_field(scene):
        return ContactSurface(faces=surface_in(scene.domain, *solids_of(scene)), field=None)
    return contact_surface_in(scene.domain, *solids_of(scene))


@lru_cache(maxsize=4)
def contact_surface_in(domain: Domain, solids: tuple[Solid, ...], keys: tuple[str, ...]) -> ContactSurface:
    """The surface of `solids` in a box in 3D, of which one is terrain; errors name the keys."""
    (number,) = (index for index, solid in enumerate(solids) if solid.kind == "terrain")
    bodies = {index: body_of(solid, keys[index], domain) for index, solid in enumerate(solids) if index != number}
    field = height_field(solids[number], keys[number], number, domain)
    cores: list[Rectangle] = []
    for body in bodies.values():
        plan = body.vertices[:, ::2]
        cores = with_rectangle(cores, field.cells_over(plan.min(axis=0), plan.max(axis=0)))
    for first, last, before, end in cores:
        field.cut[first:last, before:end] = True
    return ContactSurface(faces=united(field, bodies, cores, solids, domain), field=field)


def height_field(solid: Solid, key: str, number: int, domain: Domain) -> HeightField:
    """The raster of a terrain, to some cells beyond the box. Raises InputError."""
    (x, z), heights, friction = grid_of(solid, key, domain)
    if solid.contact == "no-slip":
        friction = np.full((1, 1), np.inf)
    elif friction.min() == friction.max():
        friction = friction[:1, :1]
    origin, spacing = solid.origin or (0.0, 0.0), solid.spacing or (1.0, 1.0)
    even = tuple(int(np.searchsorted(axis, first - TOUCHING)) for axis, first in zip((x, z), origin, strict=True))
    second = ~first_diagonal(heights)
    cut = np.zeros_like(second)
    return HeightField(
        x=x, z=z, even=even, spacing=spacing, heights=heights, friction=friction, second=second, cut=cut, solid=number
    )


def with_rectangle(known: list[Rectangle], new: Rectangle) -> list[Rectangle]:
    """Rectangles at least three cells apart that cover `known` ones, which are, and another one."""
    kept = []
    for each in known:
        apart = max(each[0] - new[1], new[0] - each[1], each[2] - new[3], new[2] - each[3])
        if apart >= 3:
            kept.append(each)
        else:
            grown = min(each[0], new[0]), max(each[1], new[1]), min(each[2], new[2]), max(each[3], new[3])
            return with_rectangle([other for other in known if other is not each], grown)
    return [*kept, new]


def united(
    field: HeightField, bodies: dict[int, Body], cores: list[Rectangle], solids: tuple[Solid, ...], domain: Domain
) -> Surface:
    """The faces of the union of `bodies`, by their numbers among the solids, and the parts `cores` of the raster."""
    if not bodies:
        return field.triangles((0, 1, 0, 1))[0].chosen(np.zeros(2, bool))
    deep = min(0.0, float(field.heights.min())) - BEYOND * domain.cell
    # With the cells around them, so that normals on their rim are those of the raster.
    patches = [raster_body(*field.posts(field.grown(core)), deep=deep, key="terrain") for core in cores]
    found = boundary([*bodies.values(), *patches], CLOSING * domain.cell)
    middle = found.corners.mean(axis=1)
    kept = found.solid < len(bodies)
    for index, (first, last, before, end) in enumerate(cores):
        x, z = middle[:, 0], middle[:, 2]
        inner = (x > field.x[first]) & (x < field.x[last]) & (z > field.z[before]) & (z < field.z[end])
        kept |= (found.solid == len(bodies) + index) & inner
    found = found.chosen(kept & near_box(found, domain))
    owners = np.array([*bodies, *(field.solid for _ in cores)], np.int32)[found.solid]
    return without_slip(replace(found, solid=owners), solids)
