"""Invariants of every flow and of every deposit of cohesionless sand: each a number and its required range.

A check takes a trajectory with fields (`mpm.WITH_FIELDS`) and returns its finding, None if it does not apply.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter

from datasets.flow.trajectory import Trajectory
from datasets.scene import TOLERANCE
from datasets.scene.particles import initial_particles, initial_volumes
from validation.bench.stability.exact_solutions import total_energy

ROUNDING = 1.0e-4  # cells: rounding of a single-precision coordinate in a box of some hundred cells
MOMENTUM = {"f32": 1.0e-4, "f64": 1.0e-5}
"""Relative error: in f32 the rounding of 10,000 steps; in f64 that of the recorded impulses, which have six digits."""
ENERGY = 2.0e-4
"""Share of the initial energy: it would lift the flow by this share of its mean height. A row may allow more."""
REST = 1.0e-3  # kinetic energy over its largest value at which the solver's `until_rest` ends
BASE = 8  # cells over which a slope is measured
REPOSE_MARGIN_DEG = 4.0
"""The surface is known to a third of a cell (the topmost particle of each column): 2.6 degrees over 8 cells, and the
steepest of all places counts."""
CUBE = 2  # cells along an edge of the cubes (in 2D squares) in which particles are counted
MIN_CUBES = 10  # cubes from which a mean is taken: single ones scatter by a tenth
VOLUME = 0.05


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A number found in a flow, and its required range."""

    check: str
    value: float
    unit: str = ""
    minimum: float = -math.inf
    maximum: float = math.inf

    @property
    def ok(self) -> bool:
        """Whether the number lies in the range; NaN does not."""
        return self.minimum <= self.value <= self.maximum

    @property
    def range(self) -> str:
        """The range as text."""
        if math.isinf(self.maximum):
            return f"≥ {self.minimum:.4g}"
        return f"≤ {self.maximum:.4g}" if math.isinf(self.minimum) else f"{self.minimum:.4g} to {self.maximum:.4g}"

    def __str__(self) -> str:
        return f"{self.check} {self.value:.4g} {self.unit}".strip() + f" (required {self.range})"


def finite(flow: Trajectory) -> Finding:
    """Number of recorded values that are NaN or infinite."""
    recorded = [flow.positions, flow.velocities, flow.pressure, flow.plastic_strain, flow.solid_impulse]
    arrays = [array for array in recorded if array is not None] + [total_energy(flow), wall_impulse(flow)]
    return Finding(check="not finite", value=sum(int((~np.isfinite(array)).sum()) for array in arrays), maximum=0)


def inside_box(flow: Trajectory) -> Finding:
    """How far any particle in any frame is outside the box [cells]."""
    domain = flow.scene.domain
    beyond = np.maximum(-flow.positions, flow.positions - np.array(domain.size)).max()
    value = max(0.0, float(beyond)) / domain.cell
    return Finding(check="outside the box", value=value, unit="cells", maximum=ROUNDING)


def outside_baffles(flow: Trajectory) -> Finding | None:
    """How deep any particle in any frame is inside a baffle [cells]. A face on a wall of the box does not count: there
    is no outside below a baffle on the floor."""
    scene, deepest = flow.scene, 0.0
    if not scene.baffles:
        return None
    size = np.array(scene.domain.size)
    for baffle in scene.baffles:
        lower, upper = np.array(baffle.lower), np.add(baffle.lower, baffle.size)
        lower = np.where(lower <= TOLERANCE, -np.inf, lower)
        upper = np.where(upper >= size - TOLERANCE, np.inf, upper)
        depth = np.minimum(flow.positions - lower, upper - flow.positions).min(axis=2)
        deepest = max(deepest, float(depth.max()))
    return Finding(check="inside a baffle", value=deepest / scene.domain.cell, unit="cells", maximum=ROUNDING)


def mass(flow: Trajectory) -> Finding | None:
    """Relative error of the particles' volume, including lost ones, against the volume of the filled boxes."""
    if any(body.kind != "box" for body in flow.scene.masses):
        return None
    boxes = sum(math.prod(body.size) for body in flow.scene.masses)
    error = abs(initial_volumes(flow.scene).mean() * flow.positions.shape[1] / boxes - 1.0)
    return Finding(check="mass", value=float(error), maximum=1.0e-9)


def momentum(flow: Trajectory) -> Finding | None:
    """Error of the balance P(t) - P(0) - M g t + impulses on walls and solids, the worst frame.

    Relative to the larger of M g t and the largest momentum of the flow; in free space, where a body that spins or
    rings has none, to the sum of m |v| at the start. A damped flow has no such balance, nor one that leaves its box.
    """
    scene = flow.scene
    if scene.damping > 0.0:
        return None
    assert flow.velocities is not None
    weights = particle_masses(flow)
    total = np.einsum("n, tnd -> td", weights, flow.velocities.astype(np.float64))
    gravity = weights.sum() * np.array(scene.gravity_vector)
    # Frames after the end repeat the last computed one.
    end = flow.summary.get("end_time") or flow.summary.get("rest_time")
    time = flow.time if end is None else np.minimum(flow.time, end)
    given = wall_impulse(flow)
    if flow.solid_impulse is not None:
        given = given + flow.solid_impulse.sum(axis=1)
    error = np.linalg.norm(total - total[0] - time[:, None] * gravity + given, axis=1)
    scale = np.maximum(time * np.linalg.norm(gravity), np.linalg.norm(total, axis=1).max())
    if scene.gravity == 0.0:
        scale = np.full_like(scale, weights @ np.linalg.norm(flow.velocities[0].astype(np.float64), axis=1))
    ratio = np.divide(error, scale, out=np.zeros_like(error), where=error > 0.0)
    return Finding(check="momentum", value=float(ratio.max()), maximum=MOMENTUM[flow.summary["precision"]])


def energy(flow: Trajectory) -> Finding:
    """Largest rise of kinetic + potential + elastic energy above that of any earlier frame, relative. To the initial
    kinetic energy plus the potential energy that the flow could give up in its box, down to the lowest corner. Small
    rises add up, unlike under a bound from frame to frame."""
    series = total_energy(flow)
    gravity = np.array(flow.scene.gravity_vector)
    corners = np.array(list(itertools.product(*((0.0, length) for length in flow.scene.domain.size))))
    available = series[0] + particle_masses(flow).sum() * (corners @ gravity).max()
    rise = (series - np.minimum.accumulate(series)).max()
    return Finding(check="energy", value=float(rise / available), maximum=ENERGY)


def rest(flow: Trajectory) -> Finding:
    """Kinetic energy in the last frame over the largest of all frames."""
    kinetic = flow.summary["energy"]["kinetic"]
    return Finding(check="motion left", value=kinetic[-1] / max(kinetic), maximum=REST)


def slope(flow: Trajectory) -> Finding:
    """Steepest slope of the final surface [deg], of planes fitted to BASE columns of a cell, in 3D to BASE x BASE. The
    limit is the largest friction angle in the scene plus a margin."""
    angle = max(flow.scene.material_of(mass).phi_deg for mass in flow.scene.masses)
    surface, cell = topmost(flow), flow.scene.domain.cell
    level = surface.ndim
    windows = np.lib.stride_tricks.sliding_window_view(surface, (BASE,) * level)
    arm = np.arange(BASE) - (BASE - 1) / 2.0
    square = np.zeros(windows.shape[:level])
    for axis in range(level):
        lever = arm.reshape([-1 if other == axis else 1 for other in range(level)])
        moment = (windows * lever).sum(axis=tuple(range(level, 2 * level)))
        square += (moment / (cell * BASE ** (level - 1) * (arm**2).sum())) ** 2
    steepest = math.degrees(math.atan(math.sqrt(np.nanmax(square))))
    return Finding(check="slope", value=steepest, unit="deg", maximum=angle + REPOSE_MARGIN_DEG)


def volume(flow: Trajectory) -> Finding | None:
    """Volume of the core of the deposit over the initial volume of its particles, minus 1.

    It uses particles in cubes of two cells that, with their neighbours, lie at least a cube under the surface. Sand at
    psi = 0 flows at constant volume. None if there are fewer than ten such cubes.
    """
    scene, edge = flow.scene, CUBE * flow.scene.domain.cell
    counts = [round(length / scene.domain.cell) // CUBE for length in scene.domain.size]
    ranges = [(0.0, count * edge) for count in counts]
    positions, volumes = flow.positions[-1].astype(np.float64), initial_particles(scene).volume
    sand, _ = np.histogramdd(positions, bins=counts, range=ranges, weights=volumes)
    surface = np.nan_to_num(topmost(flow))
    for axis, count in enumerate([counts[0], *counts[2:]]):
        parts = np.split(np.take(surface, range(count * CUBE), axis=axis), count, axis=axis)
        surface = np.stack([part.min(axis=axis) for part in parts], axis=axis)
    level = np.expand_dims(minimum_filter(surface, 3, mode="constant"), 1)
    cover = (np.arange(counts[1]) + 2.0) * edge
    core = level >= cover.reshape(1, -1, *(1,) * (surface.ndim - 1))
    if core.sum() < MIN_CUBES:
        return None
    held = max(sand[core].sum(), scene.particle_volume)
    value = float(edge**scene.dimension * core.sum() / held - 1.0)
    return Finding(check="volume", value=value, minimum=-VOLUME, maximum=VOLUME)


def topmost(flow: Trajectory) -> NDArray[np.float64]:
    """Height of the final surface [m], the topmost particle of every column of one cell; shape [cells in x(, in z)].
    NaN where a baffle stands and beside it, 0 where there is no particle."""
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


def particle_masses(flow: Trajectory) -> NDArray[np.float64]:
    """Mass of each particle [kg, per metre of width in 2D], shape [N]."""
    particles = initial_particles(flow.scene)
    return np.asarray(particles.density * particles.volume)


def wall_impulse(flow: Trajectory) -> NDArray[np.float64]:
    """Momentum given to floor and walls since the start [N s, per metre of width in 2D], shape [T, D]."""
    return np.array(flow.summary["wall_impulse"], dtype=np.float64)


ALWAYS = (finite, inside_box, outside_baffles, mass, momentum, energy)
DEPOSIT = (rest, slope, volume)
