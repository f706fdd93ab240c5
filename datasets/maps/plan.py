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
from datasets.geometry.ground import elevation
from datasets.geometry.surface import solids_of, surface_of
from datasets.measures import profile_stations
from datasets.scene import Scene
from datasets.trajectory import Trajectory

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Floats = NDArray[np.float64]

WIDTH = 2.0
"""Of a particle's pyramid to each side, in its own spacing: neighbours a spacing apart then make an even layer."""
UPRIGHT = 1.0e-12
"""Area in plan of a face over that of the square around it, below which it stands upright."""
ON_EDGE = 1.0e-9
"""Share of a face, and length [m], by which rounding may put a place on its edge beside it."""
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

    @property
    def areas(self) -> Floats:
        """Area of each cell [m^2, in 2D m], shape as the maps."""
        return areas_of(self.edges)

    @property
    def coordinates(self) -> tuple[Floats, ...]:
        """Of the cells along x and z [m], shapes [X] and [Z] (`coordinates_in`)."""
        return coordinates_in(self.edges)


def areas_of(edges: tuple[Floats, ...]) -> Floats:
    """Area of each cell [m^2, in 2D m], shape of the map."""
    lengths = [np.diff(along) for along in edges]
    return lengths[0] if len(lengths) == 1 else np.outer(*lengths)


def coordinates_in(edges: tuple[Floats, ...]) -> tuple[Floats, ...]:
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
    sides = [scene.domain.size[axis] for axis in plan_axes(scene)]
    if not 0.0 < length <= min(sides):
        raise InputError(f"expected a length of at most {min(sides):g} m, the box, got {length:g} m", key="--cell")
    if scene.dimension == 2:
        stations = profile_stations(scene, length)
        return (np.concatenate([stations[:1], 0.5 * (stations[1:] + stations[:-1]), stations[-1:]]),)
    return tuple(np.arange(math.ceil(side / length - 1e-6) + 1, dtype=np.float64) * length for side in sides)


def plan_axes(scene: Scene) -> tuple[int, ...]:
    """The axes of a map: x and, in 3D, z."""
    return (0,) if scene.dimension == 2 else (0, 2)


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


class Mapper:
    """Spreads the frames of a trajectory over the cells of one map."""

    def __init__(self, trajectory: Trajectory, edges: tuple[Floats, ...]) -> None:
        scene = trajectory.scene
        self.trajectory, self.edges, self.axes = trajectory, edges, plan_axes(scene)
        self.meshes, self.volumes = Meshes(trajectory), trajectory.volumes
        self.walls = tuple(scene.domain.size[axis] for axis in self.axes)
        self.shape = tuple(len(along) - 1 for along in edges)
        self.spacing = float(np.mean(self.volumes) ** (1.0 / scene.dimension))
        """Mean distance of neighbouring particles at the start [m]."""
        self.sizes = np.minimum(WIDTH * self.volumes ** (1.0 / scene.dimension), min(self.walls))
        """Half-width of the pyramid of each particle [m], shape [N]; no wider than the box."""

    def inside(self, frame: int) -> NDArray[np.bool_]:
        """Which particles are in the box at `frame`, shape [N]."""
        share = self.trajectory.positions[frame] / np.array(self.trajectory.scene.domain.size)
        return np.asarray(((share >= -OUTSIDE) & (share <= 1.0 + OUTSIDE)).all(axis=1))

    def at(self, frame: int) -> tuple[Floats, Floats | None]:
        """Thickness [m] at `frame`, and velocity [m/s] where known; shapes of the map."""
        velocity, positions = self.meshes.velocity(frame), self.trajectory.positions[frame]
        inside = self.inside(frame)
        places, sizes = np.clip(positions[inside][:, self.axes], 0.0, self.walls), self.sizes[inside]
        shares = [
            axis_shares(places[:, axis].astype(np.float64), sizes, *each)
            for axis, each in enumerate(zip(self.edges, self.walls, strict=True))
        ]

        def total(carried: Floats) -> Floats:
            """The sum in each cell of what the particles carry, shape [N]."""
            if len(shares) == 1:
                return np.asarray(shares[0].T @ carried)
            return np.asarray((shares[0].T @ shares[1].multiply(carried[:, None])).toarray())

        volume, carried = total(self.volumes[inside]), self.volumes[inside]
        if velocity is None:
            return volume / areas_of(self.edges), None
        speed = np.linalg.norm([total(carried * each) for each in velocity[inside].T], axis=0)
        fast = np.divide(speed, volume, out=np.zeros_like(speed), where=volume > 0.0)
        return volume / areas_of(self.edges), fast


def maps_of(
    trajectory: Trajectory, edges: tuple[Floats, ...], *, threshold: float | None = None, progress: bool = False
) -> PlanMaps:
    """The maps of `trajectory` over cells with these `edges` (`cell_edges`).

    threshold: [m], above which a cell counts as covered; a particle's spacing at the start where absent, for thinner
    layers the simulation does not resolve. Raises InputError for one that is not positive.
    """
    if threshold is not None and not threshold > 0.0:
        raise InputError(f"expected a thickness above 0 m, got {threshold:g}", key="--threshold")
    mapper = Mapper(trajectory, edges)
    smallest = mapper.spacing if threshold is None else threshold
    last = len(trajectory.time) - 1
    thickness, depth = np.zeros(mapper.shape), np.zeros(mapper.shape)
    fastest, known, start = np.zeros(mapper.shape), False, None
    for frame in tqdm(range(last + 1), desc="maps", unit="frame", disable=not progress):
        thickness, speed = mapper.at(frame)
        depth = np.maximum(depth, thickness)
        if speed is not None:
            known, fastest = True, np.where(thickness > smallest, np.maximum(fastest, speed), fastest)
        if frame == 0 and trajectory.time[0] == 0.0:
            start = thickness
    inside = mapper.inside(last)
    return PlanMaps(
        edges=edges,
        thickness=thickness,
        start=start,
        depth=depth,
        velocity=fastest if known else None,
        ground=ground(trajectory.scene, edges),
        threshold=smallest,
        volume=float(mapper.volumes[inside].sum()),
        left=float(mapper.volumes[~inside].sum()),
    )


def ground(scene: Scene, edges: tuple[Floats, ...]) -> Floats:
    """Elevation of the highest solid at the place of each cell [m], the floor's, 0, where there is none; [X] or [X, Z].

    Of cells that go beyond the box that at the nearest place in it.
    """
    axes = plan_axes(scene)
    lines = [np.clip(c, 0.0, scene.domain.size[axis]) for c, axis in zip(coordinates_in(edges), axes, strict=True)]
    plan = np.stack([each.ravel() for each in np.meshgrid(*lines, indexing="ij")], axis=1)
    height = elevation(scene.solids, scene.domain, plan)
    surface = surface_of(scene)
    if surface is not None:
        others = [number for number, solid in enumerate(solids_of(scene)[0]) if solid.kind != "terrain"]
        for corners in surface.corners[np.isin(surface.solid, others)]:
            low, high = corners[:, axes].min(axis=0), corners[:, axes].max(axis=0)
            # Barycentric coordinates of the places in plan; faces that stand upright cover nothing.
            matrix = np.vstack([corners[:, axes].T, np.ones(len(corners))])
            if abs(np.linalg.det(matrix)) <= UPRIGHT * float((high - low).max()) ** len(axes):
                continue
            near = np.flatnonzero(((plan >= low - ON_EDGE) & (plan <= high + ON_EDGE)).all(axis=1))
            share = np.linalg.solve(matrix, np.vstack([plan[near].T, np.ones(len(near))]))
            over = (share >= -ON_EDGE).all(axis=0)
            height[near[over]] = np.maximum(height[near[over]], (corners[:, 1] @ share)[over])
    return height.reshape([len(each) for each in lines])
