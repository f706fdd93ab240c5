"""What a deposit of cohesionless sand has to be: at rest, no steeper than its angle of friction, as dense as it was."""

import numpy as np
from numpy.typing import NDArray

from datasets.measures import front
from datasets.particles import particle_volumes
from datasets.trajectory import Trajectory
from validation.bench.stability.finding import Finding

REST = 1.0e-3
"""Kinetic energy over its largest: what `until_rest` of the solver calls rest."""
BASE = 8
"""Cells over which a slope is measured."""
REPOSE_MARGIN_DEG = 4.0
"""The surface is known to a third of a cell (the topmost particle of each column): 2.6 degrees over 8 cells, and the
steepest of all places counts."""
CUBE = 2
"""Cells along an edge of the cubes (in 2D squares) in which particles are counted."""
MIN_CUBES = 10
"""Cubes from which a mean is taken: single ones scatter by a tenth."""
VOLUME = 0.05
AGREEMENT = 0.1
"""Cells between the fronts in f32 and f64: less than what another jitter of the particles does to a front."""
JITTERS = 4
"""Jitters whose fronts give the standard deviation of the front of a flow that sprays ..."""
DEVIATIONS = 3.0
"""... and how many of these may lie between its fronts in f32 and f64."""


def rest(flow: Trajectory) -> Finding:
    """Kinetic energy in the last frame over the largest of all frames."""
    kinetic = flow.summary["energy"]["kinetic"]
    return Finding(check="motion left", value=kinetic[-1] / max(kinetic), maximum=REST)


def repose(flow: Trajectory) -> Finding:
    """Steepest slope of the final surface [deg], against the largest angle of friction in the scene and a margin."""
    scene = flow.scene
    angle = max(scene.material_of(mass).friction_deg for mass in scene.masses)
    return Finding(check="slope", value=steepest(flow), unit="deg", maximum=angle + REPOSE_MARGIN_DEG)


def steepest(flow: Trajectory) -> float:
    """Steepest slope of the final surface [deg], of planes fitted to BASE columns, in 3D to BASE x BASE."""
    surface, cell = topmost(flow), flow.scene.domain.cell
    level = surface.ndim
    windows = np.lib.stride_tricks.sliding_window_view(surface, (BASE,) * level)
    arm = np.arange(BASE) - (BASE - 1) / 2.0
    square = np.zeros(windows.shape[:level])
    for axis in range(level):
        lever = arm.reshape([-1 if other == axis else 1 for other in range(level)])
        moment = (windows * lever).sum(axis=tuple(range(level, 2 * level)))
        square += (moment / (cell * BASE ** (level - 1) * (arm**2).sum())) ** 2
    return float(np.degrees(np.arctan(np.sqrt(np.nanmax(square)))))


def volume(flow: Trajectory) -> Finding | None:
    """Volume of the core of the deposit over what its particles had at the start, minus 1.

    From the particles in cubes of two cells that lie at least a cube under the surface, their own and their
    neighbours', and beside no wall. Sand at psi = 0 flows at constant volume. None where there are fewer than
    ten such cubes.
    """
    sand, core = core_volumes(flow)
    if core.sum() < MIN_CUBES:
        return None
    full = (CUBE * flow.scene.domain.cell) ** flow.scene.dimension
    held = max(sand[core].sum(), flow.scene.particle_volume)
    return Finding(check="volume", value=float(full * core.sum() / held - 1.0), minimum=-VOLUME, maximum=VOLUME)


def core_volumes(flow: Trajectory) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Initial volume of the particles in each cube of the last frame [m^D], and which cubes are deep in the deposit.

    Axes as in the box.
    """
    scene, edge = flow.scene, CUBE * flow.scene.domain.cell
    counts = [round(length / scene.domain.cell) // CUBE for length in scene.domain.size]
    ranges = [(0.0, count * edge) for count in counts]
    positions = flow.positions[-1].astype(np.float64)
    sand, _ = np.histogramdd(positions, bins=counts, range=ranges, weights=particle_volumes(scene, len(positions)))
    surface = np.nan_to_num(topmost(flow))
    for axis, count in enumerate([counts[0], *counts[2:]]):
        parts = np.split(np.take(surface, range(count * CUBE), axis=axis), count, axis=axis)
        surface = np.stack([part.min(axis=axis) for part in parts], axis=axis)
    around = np.lib.stride_tricks.sliding_window_view(np.pad(surface, 1), (3,) * surface.ndim)
    level = np.expand_dims(around.min(axis=tuple(range(surface.ndim, 2 * surface.ndim))), 1)
    cover = (np.arange(counts[1]) + 2.0) * edge
    return sand, np.asarray(level >= cover.reshape(1, -1, *(1,) * (surface.ndim - 1)))


def topmost(flow: Trajectory) -> NDArray[np.float64]:
    """Height of the final surface [m], the topmost particle of every column of one cell; shape [cells in x(, in z)].

    NaN where a baffle stands and beside it, 0 where there is no particle.
    """
    scene, cell = flow.scene, flow.scene.domain.cell
    level = [axis for axis in range(scene.dimension) if axis != 1]
    counts = [round(scene.domain.size[axis] / cell) for axis in level]
    column = np.clip((flow.positions[-1][:, level] / cell).astype(int), 0, np.array(counts) - 1)
    surface = np.zeros(counts)
    np.maximum.at(surface, tuple(column.T), flow.positions[-1, :, 1].astype(np.float64))
    for baffle in scene.baffles:
        first = [max(0, int(baffle.lower[axis] / cell) - 1) for axis in level]
        last = [int((baffle.lower[axis] + baffle.size[axis]) / cell) + 1 for axis in level]
        surface[tuple(slice(low, high + 1) for low, high in zip(first, last, strict=True))] = np.nan
    return surface


def agreement(single: Trajectory, double: Trajectory, *, within: float) -> Finding:
    """Distance between the fronts of a flow in f32 and in f64 [cells]."""
    apart = abs(front(single.positions[-1]) - front(double.positions[-1])) / single.scene.domain.cell
    return Finding(check="f32 to f64", value=apart, unit="cells", maximum=within)
