"""What every flow keeps: finite numbers, positions in the box and outside baffles, mass, momentum, energy.

Every check takes a trajectory with fields (`mpm.WITH_FIELDS`) and returns what it found, or None where it does not
apply.
"""

import itertools

import numpy as np
from numpy.typing import NDArray

from datasets.particles import particle_volumes
from datasets.scene import TOLERANCE
from datasets.trajectory import Trajectory
from mpm.exact_solutions import total_energy
from validation.bench.stability.finding import Finding

ROUNDING = 1.0e-4
"""Cells: what single precision makes of a coordinate in a box of some hundred cells."""
EXACT_MASS = 1.0e-9
"""Relative: rounding of the lengths in a scene file."""
MOMENTUM = {"f32": 1.0e-4, "f64": 1.0e-5}
"""Relative: in f32 the rounding of 10,000 steps; in f64 that of the recorded impulses, which have six digits."""
ENERGY = 2.0e-4
"""Of the initial energy: what lifts the whole flow by this part of its initial mean height."""


def finite(flow: Trajectory) -> Finding:
    """How many of all recorded numbers are NaN or infinite."""
    recorded = [flow.positions, flow.velocities, flow.pressure, flow.plastic_strain, flow.solid_impulse]
    arrays = [array for array in recorded if array is not None] + [total_energy(flow), wall_impulse(flow)]
    return Finding(check="not finite", value=sum(int((~np.isfinite(array)).sum()) for array in arrays), maximum=0)


def inside_box(flow: Trajectory) -> Finding:
    """How far any particle in any frame is outside the box [cells]."""
    domain = flow.scene.domain
    beyond = np.maximum(-flow.positions, flow.positions - np.array(domain.size))
    return Finding(
        check="outside the box", value=max(0.0, float(beyond.max())) / domain.cell, unit="cells", maximum=ROUNDING
    )


def outside_baffles(flow: Trajectory) -> Finding | None:
    """How deep any particle in any frame is inside a baffle [cells].

    A face on a wall of the box does not count: below a baffle on the floor is no outside.
    """
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


def mass(flow: Trajectory) -> Finding:
    """Relative error of the volume of the particles of a mass, the worst; share of particles in no mass."""
    scene = flow.scene
    inside = in_masses(flow)
    boxes = np.array([np.prod(mass.size) for mass in scene.masses])
    worst = np.abs(inside @ particle_volumes(scene, inside.shape[1]) / boxes - 1.0).max()
    error = np.abs(inside.sum(axis=0) - 1).mean()
    return Finding(check="mass", value=float(max(worst, error)), maximum=EXACT_MASS)


def momentum(flow: Trajectory) -> Finding | None:
    """Error of the balance P(t) - P(0) - M g t + impulses on walls and baffles, the worst frame.

    Relative to the larger of M g t and the largest momentum of the flow; in free space, where a body that spins or
    rings has none, to the sum of m |v| at the start. A damped flow has no such balance.
    """
    if flow.scene.damping > 0.0:
        return None
    assert flow.velocities is not None
    weights = particle_masses(flow)
    total = np.einsum("n, tnd -> td", weights, flow.velocities.astype(np.float64))
    gravity = weights.sum() * np.array(flow.scene.gravity_vector)
    # Frames after the end repeat the last one that was computed.
    end = flow.summary.get("end_time") or flow.summary.get("rest_time")
    time = flow.time if end is None else np.minimum(flow.time, end)
    given = wall_impulse(flow)
    if flow.solid_impulse is not None:
        given = given + flow.solid_impulse.sum(axis=1)
    error = np.linalg.norm(total - total[0] - time[:, None] * gravity + given, axis=1)
    scale = np.maximum(time * np.linalg.norm(gravity), np.linalg.norm(total, axis=1).max())
    if flow.scene.gravity == 0.0:
        scale = np.full_like(scale, weights @ np.linalg.norm(flow.velocities[0].astype(np.float64), axis=1))
    worst = np.max(np.divide(error, scale, out=np.zeros_like(error), where=error > 0.0))
    return Finding(check="momentum", value=float(worst), maximum=MOMENTUM[flow.summary["precision"]])


def energy(flow: Trajectory) -> Finding:
    """Largest rise of kinetic + potential + elastic energy above that of any earlier frame, relative.

    To the initial kinetic energy plus the potential energy that the flow could give up in its box, down to the lowest
    corner. Small rises add up, unlike under a bound from frame to frame. Stress is half a step ahead of the
    velocity, so that where sand is thrown at solids half a step of their power, force times the throw's speed, shows
    before the motion has lost it.
    """
    series = total_energy(flow)
    gravity = np.array(flow.scene.gravity_vector)
    corners = np.array(list(itertools.product(*((0.0, length) for length in flow.scene.domain.size))))
    bottom = -particle_masses(flow).sum() * (corners @ gravity).max()
    rise = (series - np.minimum.accumulate(series)).max()
    most = ENERGY + half_step_work(flow) / (series[0] - bottom)
    return Finding(check="energy", value=float(rise / (series[0] - bottom)), maximum=float(most))


def half_step_work(flow: Trajectory) -> float:
    """dt F v / 2 [J, per metre of width in 2D]: F the largest mean force of a frame on the solids, v of the throw."""
    thrown = max((float(np.linalg.norm(mass.velocity)) for mass in flow.scene.masses if mass.velocity), default=0.0)
    steps = flow.summary.get("steps", 0)
    if flow.solid_impulse is None or len(flow.time) < 2 or not (thrown and steps):
        return 0.0
    force = np.linalg.norm(np.diff(flow.solid_impulse.sum(axis=1), axis=0), axis=1) / np.diff(flow.time)
    return float(0.5 * flow.time[-1] / steps * force.max() * thrown)


INVARIANTS = (finite, inside_box, outside_baffles, mass, momentum, energy)


def in_masses(flow: Trajectory) -> NDArray[np.bool_]:
    """Which particles start in which mass's box, shape [masses, N]."""
    start = flow.positions[0].astype(np.float64)
    slack = ROUNDING * flow.scene.domain.cell
    return np.array(
        [
            (np.all(start > np.array(box.lower) - slack, 1)) & (np.all(start < np.add(box.lower, box.size) + slack, 1))
            for box in flow.scene.masses
        ]
    )


def particle_masses(flow: Trajectory) -> NDArray[np.float64]:
    """Mass of each particle [kg, per metre of width in 2D], shape [N]: its box's density times its volume."""
    scene = flow.scene
    density = np.array([scene.material_of(box).density for box in scene.masses])
    inside = in_masses(flow)
    return np.asarray(particle_volumes(scene, inside.shape[1]) * density[inside.argmax(axis=0)])


def wall_impulse(flow: Trajectory) -> NDArray[np.float64]:
    """Momentum given to floor and walls since the start [N s, per metre of width in 2D], shape [T, D]."""
    return np.array(flow.summary["wall_impulse"], dtype=np.float64)
