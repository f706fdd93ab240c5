"""What a flow leaves and was, seen from above: thickness of the deposit, largest depth and velocity, cell by cell.

The volume V_p of a particle is spread over the cells of the map by its own size, as a pyramid two spacings wide to each
side; the thickness of a cell c is the volume in it over its area A_c:

    h_c = 1 / A_c  sum_p V_p prod_a int_c w_p(xi - x_pa) dxi
    w_p(r) = max(0, 1 - |r| / s_p) / s_p,    s_p = 2 V_p^(1/D)

a runs over x and, in 3D, z; what a wall cuts off a pyramid is mirrored back. So sum_c h_c A_c = sum_p V_p exactly, a
layer whose particles lie a spacing apart is even whatever the cells of the map, and holes are where particles lie more
than two spacings apart. Thickness is measured along y, which is vertical on a terrain and normal to the floor of a box
that is tilted (`slope_deg`), and of the volume at its initial density: what loosening adds is not counted. The velocity
of a cell is the mean over its depth,

    v_c = | sum_p V_p w_pc v_p | / sum_p V_p w_pc
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from datasets.errors import InputError
from datasets.exchange.vtk import Meshes
from datasets.geometry.ground import plan_axes
from datasets.geometry.placement import tops_beneath
from datasets.geometry.surface import surface_of
from datasets.measures import profile_stations
from datasets.scene import Scene
from datasets.trajectory import Trajectory

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Floats = NDArray[np.float64]

WIDTH = 2.0
"""Of a particle's pyramid to each side, in its own spacing: neighbours a spacing apart then make an even layer."""
OUTSIDE = 1.0e-6
"""Share of the box by which rounding may put a particle beyond a wall."""


@dataclass(frozen=True, kw_only=True)
class PlanMaps:
    """What a flow came to, over the cells of a map: C cells along x in 2D, X along x and Z along z in 3D."""

    edges: tuple[Floats, ...]
    """Edges of the cells along x and, in 3D, along z [m], shapes [X + 1] and [Z + 1]."""
    thickness: Floats
    """Of the deposit in the last frame [m], shape [X] or [X, Z]."""
    start: Floats | None
    """The same at the start; None where that was not kept."""
    depth: Floats
    """Largest thickness in any frame that was kept [m]."""
    velocity: Floats | None
    """Largest velocity [m/s] in any frame where there was more than the threshold; None where none is known."""
    ground: Floats
    """Elevation of what is highest of all that is solid, in the middle of a cell [m]; 0 is the floor of the box."""
    threshold: float
    """Thickness [m] above which a cell counts as covered."""
    volume: float
    """Of the particles in the last frame [m^3, in 2D m^2]."""
    left: float
    """Volume of those that are no longer in the box then."""


def areas_of(edges: tuple[Floats, ...]) -> Floats:
    """Area of each cell [m^2, in 2D m], shape of the map."""
    lengths = [np.diff(along) for along in edges]
    return lengths[0] if len(lengths) == 1 else np.outer(*lengths)


def coordinates_of(edges: tuple[Floats, ...]) -> tuple[Floats, ...]:
    """What the cells stand for along x and z [m], shapes [X] and [Z]: their middles, in 2D the stations."""
    middles = tuple(0.5 * (along[1:] + along[:-1]) for along in edges)
    if len(middles) == 1:
        middles[0][[0, -1]] = edges[0][[0, -1]]
    return middles


def cell_edges(scene: Scene, length: float) -> tuple[Floats, ...]:
    """Edges of square cells of this length [m] over the plan of a scene in 3D, the last may go beyond the box.

    In 2D those around the stations of a profile, about `length` apart; those at the walls stand for a half. Raises
    InputError for a length that is not positive or longer than a side of the box.
    """
    sides = [scene.domain.size[axis] for axis in plan_axes(scene.dimension)]
    if not 0.0 < length <= min(sides):
        raise InputError(f"expected a length of at most {min(sides):g} m, the box, got {length:g} m", key="--cell")
    if scene.dimension == 2:
        stations = profile_stations(scene, length)
        return (np.concatenate([stations[:1], 0.5 * (stations[1:] + stations[:-1]), stations[-1:]]),)
    return tuple(np.arange(math.ceil(side / length - 1e-6) + 1, dtype=np.float64) * length for side in sides)


def axis_shares(coordinates: Floats, sizes: Floats, edges: Floats, wall: float) -> "csr_array":
    """Shares of the cells along an axis, C of them, of tents around `coordinates` [m], shape [N, C]; rows add up to 1.

    sizes: half-widths [m], shape [N], at most the distance between the walls at 0 and `wall` [m].
    """
    from scipy.sparse import csr_array

    cells = len(edges) - 1
    first = np.clip(np.searchsorted(edges, coordinates - sizes, side="right") - 1, 0, cells - 1)
    last = np.clip(np.searchsorted(edges, coordinates + sizes, side="left"), first + 1, cells)
    count = int((last - first).max(initial=1))
    cell = first[:, None] + np.arange(count + 1)
    # Beyond the walls there is nothing: what would be there is that of the tent's mirror images within.
    bounds = np.minimum(edges[np.minimum(cell, cells)], wall)
    share = np.zeros((len(coordinates), count))
    for image in (coordinates, -coordinates, 2.0 * wall - coordinates):
        share += np.diff(tent_below((bounds - image[:, None]) / sizes[:, None]), axis=1)
    column = np.minimum(cell[:, :-1], cells - 1)
    rows = count * np.arange(len(coordinates) + 1)
    return csr_array((share.ravel(), column.ravel(), rows), shape=(len(coordinates), cells))


def tent_below(r: Floats) -> Floats:
    """The part of the tent max(0, 1 - |r|) that lies below r [-]."""
    r = np.clip(r, -1.0, 1.0)
    return 0.5 + r - 0.5 * r * np.abs(r)


def in_box(scene: Scene, positions: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Which particles are in the box, shape [N]."""
    share = positions / np.array(scene.domain.size)
    return np.asarray(((share >= -OUTSIDE) & (share <= 1.0 + OUTSIDE)).all(axis=1))


def summed(shares: "list[csr_array]", carried: Floats) -> Floats:
    """The sum in each cell of what the particles carry, shape [N], by their shares along each axis of the map."""
    if len(shares) == 1:
        return np.asarray(shares[0].T @ carried)
    return np.asarray((shares[0].T @ shares[1].multiply(carried[:, None])).toarray())


def maps_of(
    trajectory: Trajectory, edges: tuple[Floats, ...], *, threshold: float | None = None, progress: bool = False
) -> PlanMaps:
    """The maps of `trajectory` over cells with these `edges` (`cell_edges`).

    threshold: [m], above which a cell counts as covered; a particle's spacing at the start where absent, for thinner
    layers the simulation does not resolve. Raises InputError for one that is not positive.
    """
    if threshold is not None and not threshold > 0.0:
        raise InputError(f"expected a thickness above 0 m, got {threshold:g}", key="--threshold")
    scene, meshes, volumes, areas = trajectory.scene, Meshes(trajectory), trajectory.volumes, areas_of(edges)
    if threshold is None:
        threshold = float(np.mean(volumes) ** (1.0 / scene.dimension))
    axes = plan_axes(scene.dimension)
    walls = [scene.domain.size[axis] for axis in axes]
    sizes = np.minimum(WIDTH * volumes ** (1.0 / scene.dimension), min(walls))
    thickness, depth, fastest, start = np.zeros_like(areas), np.zeros_like(areas), None, None
    for frame in tqdm(range(len(trajectory.time)), desc="maps", unit="frame", disable=not progress):
        positions, velocity = trajectory.positions[frame], meshes.velocity(frame)
        inside = in_box(scene, positions)
        places = np.clip(positions[inside][:, axes], 0.0, walls).astype(np.float64)
        lines = zip(places.T, edges, walls, strict=True)
        shares = [axis_shares(along, sizes[inside], cuts, wall) for along, cuts, wall in lines]
        volume = summed(shares, volumes[inside])
        thickness = volume / areas
        depth = np.maximum(depth, thickness)
        if frame == 0 and trajectory.time[0] == 0.0:
            start = thickness
        if velocity is not None:
            momentum = [summed(shares, volumes[inside] * each) for each in velocity[inside].T]
            speed = np.divide(np.linalg.norm(momentum, axis=0), volume, out=np.zeros_like(volume), where=volume > 0.0)
            fastest = np.maximum(0.0 if fastest is None else fastest, np.where(thickness > threshold, speed, 0.0))
    return PlanMaps(
        edges=edges,
        thickness=thickness,
        start=start,
        depth=depth,
        velocity=fastest,
        ground=ground(scene, edges),
        threshold=threshold,
        volume=float(volumes[inside].sum()),
        left=float(volumes[~inside].sum()),
    )


def ground(scene: Scene, edges: tuple[Floats, ...]) -> Floats:
    """Elevation of the highest solid at the place of each cell [m], the floor's, 0, where there is none; [X] or [X, Z].

    Of cells that go beyond the box that at the nearest place in it.
    """
    size = np.array(scene.domain.size)[plan_axes(scene.dimension)]
    lines = [np.clip(along, 0.0, length) for along, length in zip(coordinates_of(edges), size, strict=True)]
    plan = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1)
    surface = surface_of(scene)
    if surface is None:
        return np.zeros(plan.shape[:-1])
    places = np.insert(plan.reshape(-1, len(lines)), 1, np.inf, axis=1)
    return tops_beneath(surface, places, 0.0).reshape(plan.shape[:-1])
