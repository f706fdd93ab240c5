"""The quantities that experiments measure, of a computed deposit."""

import numpy as np
from numpy.typing import NDArray

from datasets.measures import FRONT_QUANTILE, Positions, front, height_profile, profile_stations
from datasets.particles import particle_volumes
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from validation.experiments.experiment import Measured, Quantity

Floats = NDArray[np.float64]

STATION = 2.0
"""Distance of a profile's stations in cells."""
SURFACE_QUANTILE = 0.99
"""Of the particles' heights in a strip: the surface without the fate of single particles."""


def quantity(measured: Measured, flow: Trajectory) -> float:
    """The quantity of `measured` [m] in the deposit of a flow, its last frame; of radii in all of its frames."""
    scene, positions = flow.scene, flow.positions[-1]
    if measured.quantity is Quantity.RADIUS:
        return radius(positions)
    if measured.quantity is Quantity.RADII:
        computed = np.interp(measured.times, flow.time, [radius(each) for each in flow.positions])
        return float(np.sqrt(np.mean((computed - measured.radii) ** 2)))
    if measured.quantity is Quantity.HEIGHT:
        assert measured.within is not None, "a measured height has been checked"
        return surface_at_wall(scene, positions, measured.within)
    if measured.quantity is Quantity.PROFILE:
        return profile_difference(np.array(measured.x), np.array(measured.heights), scene, positions)
    if measured.thicker_than is None:
        return front(positions)
    stations = profile_stations(scene, STATION * scene.domain.cell)
    return edge(stations, mean_profile(scene, positions, stations, measured.beside_walls), measured.thicker_than)


def radius(positions: Positions) -> float:
    """Distance from the vertical axis [m] that FRONT_QUANTILE of the particles are within; positions: shape [N, D]."""
    x = positions.astype(np.float64)
    return float(np.quantile(np.hypot(x[:, 0], x[:, -1]), FRONT_QUANTILE))


def mean_profile(scene: Scene, positions: Positions, stations: Floats, beside_walls: float | None = None) -> Floats:
    """Height of the deposit at its initial density [m] at `stations` [m], shape [S]; in 3D the mean over z.

    beside_walls: width [m] of the strips along the walls z = 0 and z = width that the mean is over; all of it if None.
    """
    volumes = particle_volumes(scene, len(positions))
    if scene.dimension == 2:
        return height_profile(positions, volumes, stations)
    width = scene.domain.size[2]
    strip = 0.5 * width if beside_walls is None else beside_walls
    z = positions[:, 2]
    beside = (z <= strip) | (z >= width - strip)
    return height_profile(positions[beside], volumes[beside] / (2.0 * strip), stations)


def edge(stations: Floats, heights: Floats, thickness: float) -> float:
    """The x [m] beyond the highest station where a profile first falls below `thickness` [m], linear in between.

    stations, heights: [m], shape [S] each; the last station where it never does.
    """
    top = int(np.argmax(heights))
    below = np.flatnonzero(heights[top:] < thickness)
    if len(below) == 0:
        return float(stations[-1])
    right = top + int(below[0])
    if right == top:
        return float(stations[top])
    share = (heights[right - 1] - thickness) / (heights[right - 1] - heights[right])
    return float(stations[right - 1] + share * (stations[right] - stations[right - 1]))


def surface_at_wall(scene: Scene, positions: Positions, within: float) -> float:
    """Height of the deposit's surface [m] over the strip x < `within` [m]."""
    strip = positions[positions[:, 0] < within, 1].astype(np.float64)
    half = 0.5 * scene.particle_spacing
    return float(np.quantile(strip, SURFACE_QUANTILE)) + half


def profile_difference(x: Floats, heights: Floats, scene: Scene, positions: Positions) -> float:
    """Root mean square difference [m] of the deposit's heights from measured `heights` at `x` [m], shape [R] each."""
    stations = profile_stations(scene, STATION * scene.domain.cell)
    computed = np.interp(x, stations, mean_profile(scene, positions, stations))
    return float(np.sqrt(np.mean((computed - heights) ** 2)))
