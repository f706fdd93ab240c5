"""What a flow leaves and was, seen from above: thickness of the deposit, largest depth and velocity, cell by cell.

The volume V_p of a particle is shared linearly between the cells around it, by the weights w of `datasets.field` at
their middles; with A_c the area of a cell,

    h_c = 1 / A_c  sum_p w_c(x_p) V_p,    v_c = | sum_p w_c(x_p) V_p v_p | / sum_p w_c(x_p) V_p

So sum_c h_c A_c = sum_p V_p exactly. A layer whose particles lie a spacing apart is even where a cell is a whole number
of spacings long. Thickness is measured along y, which is vertical on a terrain and normal to
the floor of a box that is tilted (`slope_deg`), and of the volume at its initial density: what loosening adds is not
counted. The velocity v_c is the mean over the depth.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from datasets.errors import InputError
from datasets.exchange.vtk import Meshes
from datasets.field import Grid
from datasets.geometry.ground import plan_axes
from datasets.geometry.placement import tops_beneath
from datasets.geometry.surface import surface_of
from datasets.scene import Scene
from datasets.trajectory import Trajectory

Floats = NDArray[np.float64]

OUTSIDE = 1.0e-6
"""Share of the box by which rounding may put a particle beyond a wall."""


@dataclass(frozen=True, kw_only=True)
class PlanMaps:
    """What a flow came to, over the cells of a map: X along x and Z along z."""

    grid: Grid
    """Of the middles of the cells along x and z [m]."""
    thickness: Floats
    """Of the deposit in the last frame [m], shape [X, Z]."""
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
    """Of the particles in the last frame [m^3]."""
    left: float
    """Volume of those that are no longer in the box then."""

    @property
    def cell(self) -> float:
        """Edge of a cell [m]."""
        return self.grid.spacing[0]


def map_grid(scene: Scene, cell: float) -> Grid:
    """Square cells of this edge [m] over the plan of a scene; the last may go beyond the box.

    Raises InputError for a scene in 2D, and for cells that are finer than the particles, or longer than a side of the
    box.
    """
    if scene.dimension == 2:
        raise InputError("expected a trajectory in 3D, a flow in 2D has no plan")
    sides, least = [scene.domain.size[axis] for axis in plan_axes(scene.dimension)], scene.particle_spacing
    if not least * (1.0 - 1.0e-9) <= cell <= min(sides):
        expected = f"from {least:g} m, the spacing of the particles, to {min(sides):g} m, the box"
        raise InputError(f"expected a length {expected}, got {cell:g} m", key="--cell")
    nodes = tuple(math.ceil(side / cell - 1.0e-6) for side in sides)
    return Grid((0.5 * cell,) * 2, (cell,) * 2, nodes)


def maps_of(trajectory: Trajectory, cell: float, *, threshold: float | None = None, progress: bool = False) -> PlanMaps:
    """The maps of `trajectory` over cells of an edge [m].

    threshold: [m], above which a cell counts as covered; a particle's spacing at the start where absent, for thinner
    layers the simulation does not resolve. Raises InputError for one that is not positive,
    and as `map_grid`.
    """
    if threshold is not None and not threshold > 0.0:
        raise InputError(f"expected a thickness above 0 m, got {threshold:g}", key="--threshold")
    scene, meshes, volumes = trajectory.scene, Meshes(trajectory), trajectory.volumes
    if threshold is None:
        threshold = float(np.mean(volumes) ** (1.0 / scene.dimension))
    grid = map_grid(scene, cell)
    depth, fastest, start = np.zeros(grid.nodes), None, None
    for frame in tqdm(range(len(trajectory.time)), desc="maps", unit="frame", disable=not progress):
        positions, velocity = trajectory.positions[frame], meshes.velocity(frame)
        share = positions / np.array(scene.domain.size)
        inside = ((share >= -OUTSIDE) & (share <= 1.0 + OUTSIDE)).all(axis=1)
        spread = grid.weights(positions[inside][:, plan_axes(scene.dimension)].astype(np.float64)).T
        volume = (spread @ volumes[inside]).reshape(grid.nodes)
        thickness = volume / cell**2
        depth = np.maximum(depth, thickness)
        if frame == 0 and trajectory.time[0] == 0.0:
            start = thickness
        if velocity is not None:
            momentum = np.linalg.norm(spread @ (volumes[inside, None] * velocity[inside]), axis=1).reshape(grid.nodes)
            speed = np.divide(momentum, volume, out=np.zeros_like(volume), where=thickness > threshold)
            fastest = speed if fastest is None else np.maximum(fastest, speed)
    return PlanMaps(
        grid=grid,
        thickness=thickness,
        start=start,
        depth=depth,
        velocity=fastest,
        ground=ground(scene, grid),
        threshold=threshold,
        volume=float(volumes[inside].sum()),
        left=float(volumes[~inside].sum()),
    )


def ground(scene: Scene, grid: Grid) -> Floats:
    """Elevation of the highest solid at the place of each cell [m], the floor's, 0, where there is none; as the maps.

    Of cells that go beyond the box that at the nearest place in it.
    """
    surface = surface_of(scene)
    if surface is None:
        return np.zeros(grid.nodes)
    plan = np.minimum(grid.positions, np.array(scene.domain.size)[plan_axes(scene.dimension)])
    return tops_beneath(surface, np.insert(plan, 1, np.inf, axis=1), 0.0).reshape(grid.nodes)
