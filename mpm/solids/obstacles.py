"""The solids in the box for the kernel: faces near cells, holds of nodes deep inside, contact at the start.

**Window.** Cells and nodes have lists only in a box around the faces; outside of it no face is near. Cells and nodes
are numbered alike in the box, the last axis fastest: a cell has the number of its lowest node.

**Terrain.** A terrain in 3D is not listed. The kernel finds its bed by the place in plan (`mpm.solids.terrain`), in
addition to the nearest face, and the bed holds nodes after the listed faces have acted on their velocity.

**Lists.** A point p of a cell with centre c and half diagonal h has d(c, F) - h <= d(p, F) <= d(c, F) + h from a face
F. So F can be the nearest one of a point at a distance of at most `cutoff` only where d(c, F) <= min(smallest + 2 h,
cutoff + h), `smallest` being the distance of c from its nearest face, and a displacement of at most a cell `dx` that
starts in the cell can cut F only where d(c, F) <= h + dx. With h of a cell enlarged by `SLACK` on all sides, the first
also holds for places around the cell: a particle need not search anew as soon as it leaves its cell.

**Holds.** A node in a solid is held by every face that it lies behind and that is almost the nearest, each with a share
that is continuous in the position of the solid. With d_k the distance of face k, N_k its normal and n_k the direction
from the node to its nearest point, b = `BLEND` and s a smooth step of the depth over `FADE`,

    share_k = s(min d) w_k / sum_l w_l,    w_k = (n_k . N_k)_+ (1 - (d_k - min d) / b)_+^2

**Covered walls.** A floor under a terrain or a wall behind a lining has no effect. A node at or beyond a side of the
box has no wall where the side lies in a solid, at the node and one cell around it, as far as its material reaches:
beside a solid that stands on the floor, the floor remains.
"""

import dataclasses
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, minimum_filter

from datasets.geometry.contact_surface import ContactSurface, contact_surface_of
from datasets.geometry.nearest import Search, feet, nearest
from datasets.geometry.surface import Surface
from datasets.scene import NO_SLIP, Domain, Scene
from mpm.arrays.layout import PADDING, Contact, node_shape
from mpm.arrays.properties import CONTACT_WIDTH, roughest, search_distance
from mpm.solids.bed import Bed, bed_of, frictions_of
from mpm.solids.face_lookup import SKIN, SLACK
from mpm.solids.terrain import FADE

Array = NDArray[Any]
Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

BLEND = 0.5  # distance beyond the nearest face [cells] from which another face no longer holds a node


@dataclass(frozen=True, kw_only=True)
class Window:
    """A box of cells, and of the nodes at their lowest corners; D dimensions."""

    low: tuple[int, ...]  # the lowest node, counted from the first padding node of the grid, shape [D]
    shape: tuple[int, ...]  # cells along each axis, shape [D]
    cell: float  # [m]

    @property
    def count(self) -> int:
        """Cells in it, C."""
        return math.prod(self.shape)

    def positions(self, numbers: Integers) -> Floats:
        """Positions of the nodes with these numbers [m], shape [N, D]."""
        return np.asarray((self.nodes(numbers) - PADDING) * self.cell)

    def numbers(self, nodes: Integers) -> Integers:
        """Numbers of nodes in it from their indices in the grid, shape [N, D]; shape [N]."""
        return np.asarray(np.ravel_multi_index(tuple((nodes - np.array(self.low)).T), self.shape))

    def nodes(self, numbers: Integers) -> Integers:
        """The indices in the grid, shape [N, D], of the nodes with these numbers, shape [N]."""
        return np.asarray(np.stack(np.unravel_index(numbers, self.shape), axis=-1) + np.array(self.low))


def window_around(domain: Domain, surface: Surface, cutoff: float) -> Window:
    """The cells that may list a face, up to `cutoff` cells from it; none without faces."""
    if not len(surface.corners):
        return Window(low=(0,) * domain.dimension, shape=(0,) * domain.dimension, cell=domain.cell)
    corners = surface.corners.reshape(1, -1, domain.dimension)
    # Distance of the centre of a cell that lists a face; a step moves a particle by at most a cell.
    limit = (max(cutoff + SLACK * math.sqrt(domain.dimension), 1.0) + 0.5 * math.sqrt(domain.dimension)) * domain.cell
    low, high = (bounds[0] for bounds in boxes_around(domain, corners, limit))
    shape = np.array(node_shape(domain))
    low = np.clip(low, 0, shape - 1)
    high = np.clip(high, low + 1, shape)
    return Window(low=tuple(low.tolist()), shape=tuple((high - low).tolist()), cell=domain.cell)


def window_of(domain: Domain, nodes: Integers) -> Window:
    """The box around nodes by their indices, shape [N, D]."""
    low, high = nodes.min(axis=0), nodes.max(axis=0) + 1
    return Window(low=tuple(low.tolist()), shape=tuple((high - low).tolist()), cell=domain.cell)


def boxes_around(domain: Domain | Window, corners: Floats, limit: float) -> tuple[Integers, Integers]:
    """The boxes [low, high) of cells whose centres may lie within `limit` [m] of corners, [F, K, D]; [F, D] each."""
    low = np.floor((corners.min(axis=1) - limit) / domain.cell - 0.5).astype(np.int64) + PADDING
    high = np.ceil((corners.max(axis=1) + limit) / domain.cell - 0.5).astype(np.int64) + PADDING + 1
    return low, high


@dataclass(frozen=True, kw_only=True, eq=False)
class Obstacles:
    """Solids of scenes for the kernel: F listed faces, C cells in the windows of all scenes, K holds of nodes."""

    faces: Array
    """A line per face: corners [m], normals of face, corners and edges, friction at the corners [-], number
    of its solid; see `mpm.arrays.features.Features.face`; shape [F, columns]."""
    cell_faces: Array  # where the list of each cell begins in `near_faces`, shape [C + 1] of each scene
    near_faces: Array  # the faces near the cells
    cell_distance: Array  # lower bound of a cell's distance to unlisted faces [m], shape [C + 1]
    node_holds: Array  # where the holds of each node begin in `holds`, shape [C + 1]
    holds: Array  # of each hold its face, the friction there [-] and its share [-], shape [K, 3]
    covered: Array  # of each node the sides of the box that a solid covers, bit k for x-, x+, y-, ..., shape [C + 1]
    windows: tuple[Window, ...]  # of each scene
    beds: tuple[Bed | None, ...]  # of each scene
    frictions: tuple[Floats, ...]  # of the posts of their terrain [-], [X, Z]; [1, 1] if uniform; empty without terrain


def obstacles_of(scenes: Sequence[Scene]) -> tuple[Obstacles, Integers]:
    """The solids of several scenes in one; and the start of each scene in `cell_faces`, `faces` and `holds`, with the
    end of the last, shape [scenes + 1, 3].

    Raises InputError as `datasets.geometry.contact_surface.contact_surface_of` does."""
    parts = [obstacles_in(scene) for scene in scenes]
    counts = [(len(part.cell_faces), len(part.faces), len(part.holds), len(part.near_faces)) for part in parts]
    firsts = np.cumsum([(0, 0, 0, 0), *counts], axis=0)
    shifted = []
    for part, (_, face, hold, near) in zip(parts, firsts[:-1].tolist(), strict=True):
        starts = {"cell_faces": part.cell_faces + near, "node_holds": part.node_holds + hold}
        numbers = {"near_faces": part.near_faces + face, "holds": part.holds + np.array([face, 0.0, 0.0])}
        shifted.append(vars(part) | starts | numbers)
    of_scenes = ("windows", "beds", "frictions")
    together: dict[str, Any] = {name: sum((vars(part)[name] for part in parts), ()) for name in of_scenes}
    for name in shifted[0].keys() - of_scenes:
        together[name] = np.concatenate([tables[name] for tables in shifted])
    return Obstacles(**together), firsts[:, :3]


def obstacles_in(scene: Scene) -> Obstacles:
    """The solids of one scene, with faces listed up to a cell beyond the search distance; empty without solids.

    A particle from farther away needs more than a step to come within the search distance."""
    surface = contact_surface_of(scene) or ContactSurface(faces=Surface.empty(scene.dimension), field=None)
    return obstacles_with(surface, scene.domain, farthest(scene), roughest(scene))


def farthest(scene: Scene) -> float:
    """Distance from solids up to which faces are listed [cells]."""
    return 1.0 + search_distance(scene) / scene.domain.cell


def holds_at(scene: Scene, solid: ContactSurface, nodes: Integers) -> tuple[Window, NDArray[np.int32], Floats, Floats]:
    """For `nodes` by their indices, shape [N, D]: a window around them, the start of the holds of each of its nodes by
    listed faces, these holds, shape [K, 3], and the normals of their faces, shape [K, D]."""
    window, surface = window_of(scene.domain, nodes), limited(solid.faces, roughest(scene))
    if not len(surface.corners):
        return window, np.zeros(window.count + 1, np.int32), np.zeros((0, 3)), np.zeros((0, scene.dimension))
    first, holds = holds_of(window, surface, np.sort(window.numbers(nodes)), cutoff=farthest(scene))
    return window, first, holds, surface.normals[holds[:, 0].astype(np.int64)]


def bed_holds_at(scene: Scene, solid: ContactSurface, nodes: Integers) -> tuple[Floats, Floats, Floats]:
    """For `nodes` by their indices, shape [N, D]: the share with which the bed of a terrain holds them, its normals,
    [N, D], and its friction; empty without a bed."""
    if solid.field is None:
        return np.zeros(len(nodes)), np.zeros(nodes.shape), np.zeros(len(nodes))
    bed = bed_of(solid.field, scene.domain)
    places = np.asarray((nodes - PADDING) * scene.domain.cell, np.float64)
    d, normal, rough = bed.contact(places, frictions_of(bed, roughest(scene)))
    part = np.clip(-d / (FADE * scene.domain.cell), 0.0, 1.0)
    return part * part * (3.0 - 2.0 * part), normal, rough


def limited(surface: Surface, most: float) -> Surface:
    """`surface` with Coulomb coefficients of at most `most` [-]."""
    return dataclasses.replace(surface, friction=np.minimum(surface.friction, most))


def face_lines(surface: Surface) -> Floats:
    """`Obstacles.faces` of a surface."""
    normals = surface.normals, surface.corner_normals, surface.edge_normals
    described: tuple[Array, ...] = (surface.corners, *normals, surface.friction, surface.solid)
    return np.concatenate([array.reshape(len(array), math.prod(array.shape[1:])) for array in described], axis=1)


@lru_cache(maxsize=4)
def obstacles_with(solid: ContactSurface, domain: Domain, cutoff: float, most: float) -> Obstacles:
    """The solids with the surface `solid` in a box, listed up to `cutoff` cells from faces; runs of one geometry share
    them.

    most: largest Coulomb coefficient of their faces [-]."""
    faces, window = limited(solid.faces, most), window_around(domain, solid.faces, cutoff)
    cell_faces, near_faces = faces_near(window, faces, cutoff=cutoff)
    listed = np.flatnonzero(np.diff(cell_faces))
    # From any other cell, the path to a face enters a listed cell and is still `cutoff` cells long from there.
    node_holds, holds, beyond = np.zeros(1, np.int32), np.zeros((0, 3)), np.zeros(0)
    covered = np.zeros(0, np.int32)
    if window.count:
        apart = distance_transform_edt((np.diff(cell_faces) == 0).reshape(window.shape)).ravel()
        beyond = np.maximum(apart - math.sqrt(domain.dimension), 0.0)
        node_holds, holds = holds_of(window, faces, listed, cutoff=cutoff)
        covered = covered_sides(window, domain, solid, cutoff=cutoff)
    field = solid.field
    return Obstacles(
        faces=face_lines(faces),
        cell_faces=cell_faces,
        near_faces=near_faces,
        cell_distance=np.append((cutoff + beyond) * domain.cell, 0.0),
        node_holds=node_holds,
        holds=holds,
        covered=np.append(covered, np.int32(0)),
        windows=(window,),
        beds=(None if field is None else bed_of(field, domain),),
        frictions=(np.zeros((0, 0)) if field is None else np.minimum(field.friction, most),),
    )


def covered_sides(window: Window, domain: Domain, solid: ContactSurface, *, cutoff: float) -> NDArray[np.int32]:
    """For each node of a window, the sides of the box that a solid covers, as bits, shape [C]."""
    shape, cell = node_shape(domain), domain.cell
    covered = np.zeros(window.shape, np.int32)
    for axis, side in itertools.product(range(len(shape)), (0, 1)):
        row = (shape[axis] - 1 - PADDING if side else PADDING) - window.low[axis]
        if not 0 <= row < window.shape[axis]:
            continue
        numbers = np.moveaxis(np.arange(window.count).reshape(window.shape), axis, 0)[row]
        places = window.positions(numbers.ravel())
        places[:, axis] += (2 * side - 1) * SKIN * cell
        distance = np.full(len(places), np.inf)
        if len(solid.faces.corners):
            distance = nearest(solid.faces, places, cutoff * cell).distance
        # A place far from the surface but beside an inside place is deep in the solid.
        inside, deep = distance < -0.5 * SKIN * cell, np.isinf(distance)
        if solid.field is not None:
            ground = bed_of(solid.field, domain).contact(places, np.zeros((1, 1)))[0] < -0.5 * SKIN * cell
            inside, deep = inside | ground, ground
        inside = inside.reshape(numbers.shape)
        whole = inside & minimum_filter(inside | deep.reshape(numbers.shape), 3, mode="nearest")
        beyond = np.moveaxis(covered, axis, 0)[row:] if side else np.moveaxis(covered, axis, 0)[: row + 1]
        beyond |= whole.astype(np.int32) << (2 * axis + side)
    return covered.ravel()


def covered_at(scene: Scene, nodes: Integers) -> NDArray[np.int32]:
    """The sides of the box that a solid covers, as bits, shape [N], of nodes by their indices, shape [N, D]."""
    solid = contact_surface_of(scene)
    if solid is None:
        return np.zeros(len(nodes), np.int32)
    window = window_of(scene.domain, np.concatenate([nodes - 1, nodes + 1]))
    return covered_sides(window, scene.domain, solid, cutoff=farthest(scene))[window.numbers(nodes)]


def holds_of(window: Window, surface: Surface, nodes: Integers, *, cutoff: float) -> tuple[NDArray[np.int32], Floats]:
    """The start of the holds of each node, and these holds, for `nodes` up to `cutoff` cells deep."""
    cell = window.cell
    depth = -nearest(surface, window.positions(nodes), cutoff * cell).distance
    deep = (depth > 0.0) & (depth <= cutoff * cell)
    nodes, depth = nodes[deep], depth[deep]
    places = window.positions(nodes)
    pairs = [(np.zeros(0, np.int64), np.zeros(0, np.int64)), *Search(surface).pairs(places, depth + BLEND * cell)]
    node, face = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    order = np.lexsort((face, node))
    node, face = node[order], face[order]
    foot, distance, corner_weights = feet(surface.corners[face], places[node])
    behind = ((foot - places[node]) * surface.normals[face]).sum(axis=1) / distance
    near = 1.0 - (distance - depth[node]) / (BLEND * cell)
    weight = np.maximum(behind, 0.0) * np.maximum(near, 0.0) ** 2
    part = np.minimum(depth / (FADE * cell), 1.0)
    whole = np.maximum(np.bincount(node, weight, len(nodes)), np.finfo(float).tiny)
    share = (part * part * (3.0 - 2.0 * part) / whole)[node] * weight
    corners = np.minimum(surface.friction, NO_SLIP)[face]
    friction = np.where((corners == NO_SLIP).any(axis=1), NO_SLIP, (corner_weights * corners).sum(axis=1))
    kept = share > 0.0
    counts = np.bincount(nodes[node[kept]] + 1, minlength=window.count + 1)
    return np.cumsum(counts).astype(np.int32), np.stack([face, friction, share], axis=1)[kept]


def faces_near(window: Window, surface: Surface, *, cutoff: float) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The start of the list of each cell among the faces of `surface` near cells, and these faces.

    cutoff: largest distance from the surface that is listed [cells]; a displacement of a step is at most a cell."""
    cell, half = window.cell, 0.5 * window.cell * math.sqrt(len(window.shape))
    wide = (1.0 + 2.0 * SLACK) * half
    if not len(surface.corners):
        return np.zeros(window.count + 1, np.int32), np.zeros(0, np.int32)
    limit = max(cutoff * cell + wide, cell + half)
    low, high = (bounds - np.array(window.low) for bounds in boxes_around(window, surface.corners, limit))
    around = np.zeros(window.shape, bool)
    for first, last in zip(np.maximum(low, 0), np.clip(high, 0, window.shape), strict=True):
        around[tuple(map(slice, first, last))] = True
    numbers = np.flatnonzero(around)
    centres = window.positions(numbers) + 0.5 * cell
    # Pairs of a cell, whose centre lies within the limit of a face, and this face; distance; by cell, then face.
    pairs = [(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))]
    for point, face in Search(surface).pairs(centres, np.full(len(centres), limit)):
        _, apart, _ = feet(surface.corners[face], centres[point])
        near = apart <= limit
        pairs.append((numbers[point[near]], face[near], apart[near]))
    cells, faces, distance = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    order = np.lexsort((faces, cells))
    cells, faces, distance = cells[order], faces[order], distance[order]
    groups = np.flatnonzero(np.diff(cells, prepend=-1))
    smallest = np.minimum.reduceat(distance, groups) if len(groups) else distance
    smallest = np.repeat(smallest, np.diff(groups, append=len(cells)))
    slack = 1.0e-9 * cell
    nearest_one = distance <= np.minimum(smallest + 2.0 * wide, cutoff * cell + wide) + slack
    kept = nearest_one | (distance <= half + cell + slack)
    listed = np.bincount(cells[kept] + 1, minlength=window.count + 1)
    return np.cumsum(listed).astype(np.int32), faces[kept].astype(np.int32)


def contact_delta(distance: Floats, width: float) -> Floats:
    """delta_h [1/m] of distances [m], as in `mpm.physics.boundary.contact_delta`."""
    q = np.clip(distance / width, 0.0, 1.0)
    return np.asarray(2.0 / width * (1.0 - q * q * (3.0 - 2.0 * q)))


def from_wall(scene: Scene, positions: Floats, side: int) -> Floats:
    """Distance of `positions` [m], [N, D], from a side of the box, 0 to 2 D - 1 for x-, x+, y-, ... [m], [N]."""
    x = positions[:, side // 2]
    return np.asarray(np.maximum(scene.domain.size[side // 2] - x if side % 2 else x, 0.0))


def near_walls(scene: Scene, positions: Floats) -> NDArray[np.bool_]:
    """Which of `positions` [m], [N, D], are near enough to a side of the box for water to press on it, [N]."""
    width = CONTACT_WIDTH * scene.domain.cell
    away = np.stack([from_wall(scene, positions, side) for side in range(2 * scene.dimension)])
    return np.asarray(away.min(axis=0) < width)


def initial_contacts(scene: Scene, positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Contact of particles at `positions` [m], shape [N, D], as in the kernel: the columns of `Contact`, [N, ...]."""
    count, dimension = positions.shape
    contacts = np.zeros((count, len(Contact) - 1 + 2 * dimension))
    contacts[:, Contact.DISTANCE] = np.inf
    solid = contact_surface_of(scene)
    if solid is None:
        return contacts
    width = CONTACT_WIDTH * scene.domain.cell
    cutoff, most = search_distance(scene) + scene.domain.cell, roughest(scene)
    surface, normals = solid.faces, slice(Contact.NORMAL, Contact.NORMAL + dimension)
    distance = np.full(count, np.inf)
    if len(surface.corners):
        near = nearest(surface, positions, cutoff)
        distance, contacts[:, Contact.FACE], contacts[:, normals] = near.distance, near.face, near.normal
        _, _, weights = feet(surface.corners[near.face], positions)
        contacts[:, Contact.FRICTION] = (weights * np.minimum(surface.friction, most)[near.face]).sum(axis=1)
    if solid.field is not None:
        bed = bed_of(solid.field, scene.domain)
        d, normal, friction = bed.contact(positions, frictions_of(bed, most))
        nearer = d < distance
        distance, contacts[nearer, Contact.FACE] = np.minimum(d, distance), len(surface.corners)
        contacts[nearer, Contact.FRICTION], contacts[nearer, normals] = friction[nearer], normal[nearer]
    contacts[:, Contact.DELTA] = contact_delta(distance, width)
    contacts[:, Contact.DISTANCE] = np.clip(distance, 0.0, cutoff)
    return contacts
