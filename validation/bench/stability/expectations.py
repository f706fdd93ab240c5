"""What single rows have to show besides what every flow keeps: closed forms, bounds of experiments, other rows.

Each takes a trajectory, some another one beside it, and returns a finding; `minimum` and `maximum` replace its range.
"""

import math
from collections.abc import Callable
from functools import wraps

import numpy as np
from numpy.typing import NDArray

from datasets.measures import front, toe
from datasets.trajectory import Trajectory
from mpm import exact_solutions as exact
from validation.bench.stability.finding import Finding
from validation.bench.stability.invariants import particle_masses, wall_impulse

FAILED = 0.05
"""Share of the particles of a cut that moved by a cell, from which on it has failed: a slice of a cell off its face,
which has hardly any tension to hold it, is less, and Rankine's wedge behind a cut as wide as it is high a quarter."""
DAMPING_OF_SAND = 0.005
"""Damping ratio of dry sand at strains below 1e-5, resonant column: 0.5 to 1 % (Hardin & Drnevich 1972)."""


def check(
    name: str, unit: str = "", *, minimum: float = -math.inf, maximum: float = math.inf
) -> Callable[[Callable[..., float]], Callable[..., Finding]]:
    """Make a function that measures a number one that finds it, with its range."""

    def found(measure: Callable[..., float]) -> Callable[..., Finding]:
        @wraps(measure)
        def checked(*flows: Trajectory, minimum: float = minimum, maximum: float = maximum) -> Finding:
            return Finding(check=name, value=float(measure(*flows)), unit=unit, minimum=minimum, maximum=maximum)

        return checked

    return found


def in_cells(length: float, flow: Trajectory) -> float:
    """A length [m] in cells."""
    return float(length) / flow.scene.domain.cell


@check("displacement over rigid block's", minimum=0.99, maximum=1.01)
def slides(flow: Trajectory) -> float:
    """Displacement of the centre of a block down an incline, over that of a rigid one."""
    block = exact.SlidingBlock.of_scene(flow.scene)
    return float(exact.centre_displacement(flow)[-1, 0]) / block.displacement(flow.time[-1])


@check("displacement over v t", minimum=0.99, maximum=1.01)
def moves_on(flow: Trajectory) -> float:
    """Displacement of the centre of a body on which no force along its motion acts, over v t."""
    free = np.array(flow.scene.masses[0].velocity) * flow.time[-1]
    return float(exact.centre_displacement(flow)[-1] @ free / (free @ free))


@check("energy of spin", minimum=0.99, maximum=1.0002)
def spins_on(flow: Trajectory) -> float:
    """Kinetic energy at the end over that at the start, of a rigid body that turns freely: 1."""
    kinetic = flow.summary["energy"]["kinetic"]
    return float(kinetic[-1] / kinetic[0])


@check("angular momentum", maximum=1.0e-3)
def keeps_angular_momentum(flow: Trajectory) -> float:
    """Largest change of sum m (x - x_c) x v about the centre in any frame, relative: 0 where no moment acts."""
    assert flow.velocities is not None
    masses = particle_masses(flow)
    x, v = flow.positions.astype(np.float64), flow.velocities.astype(np.float64)
    arm = x - np.einsum("n, tnd -> td", masses, x)[:, None] / masses.sum()
    moment = np.einsum("n, tn -> t", masses, arm[..., 0] * v[..., 1] - arm[..., 1] * v[..., 0])
    return float(np.abs(moment / moment[0] - 1.0).max())


def falls_freely(flow: Trajectory) -> Finding:
    """Error of the height of the mass's centre against free fall, up to the frame before it lands, over the fall."""
    scene = flow.scene
    drop = scene.masses[0].lower[1] - scene.domain.cell
    last = int(math.sqrt(2.0 * drop / scene.gravity) / scene.frame_dt)
    fall = exact.FreeFlight.of_flow(flow).displacement(flow.time[: last + 1])[:, 1]
    height = mass_height(flow, 0)[: last + 1]
    error = float(np.abs(height - height[0] - fall).max())
    return Finding(check="fall off parabola", value=error / drop, maximum=1.0e-3)


@check("rise over free throw", minimum=0.9, maximum=1.001)
def parts_freely(flow: Trajectory) -> float:
    """How high the upper mass has risen at the end, over v t - g t^2 / 2 of a free throw.

    Where the masses part, one row of nodes is common to both and shares its velocity; that may cost the thrown one
    a tenth of its rise. More than a free throw would be energy from nowhere.
    """
    upper, scene = flow.scene.masses[1], flow.scene
    assert upper.velocity is not None
    thrown = upper.velocity[1] * scene.duration - 0.5 * scene.gravity * scene.duration**2
    moved = mass_height(flow, 1)
    return float((moved[-1] - moved[0]) / thrown)


@check("decrement", minimum=-1.0e-3, maximum=2.0 * math.pi * DAMPING_OF_SAND)
def bar_decrement(flow: Trajectory) -> float:
    """Logarithmic decrement per period of a free bar's lowest longitudinal mode; 0 for an elastic bar."""
    return exact.StandingWave.of_bar(flow).decrement(flow)


@check("decrement", minimum=-1.0e-3, maximum=2.0 * math.pi * DAMPING_OF_SAND)
def layer_decrement(flow: Trajectory) -> float:
    """Logarithmic decrement per period of a layer's lowest vertical mode; 0 for an elastic layer."""
    return exact.StandingWave.of_layer(flow).decrement(flow)


def layer_viscosity(flow: Trajectory) -> Finding:
    """The viscosity eta [Pa s] of sigma = (lambda + 2 mu) eps + eta d(eps)/dt by which the layer's mode would decay so.

    Kelvin and Voigt: a damping ratio of eta omega / (2 (lambda + 2 mu)), which is the decrement over 2 pi.
    """
    wave, material = exact.StandingWave.of_layer(flow), flow.scene.material
    scale = material.density * material.wave_speed**2 / (math.pi * wave.omega)
    maximum = 2.0 * math.pi * DAMPING_OF_SAND * scale
    return Finding(check="viscosity", value=wave.decrement(flow) * scale, unit="Pa s", maximum=maximum)


def stays_at_rest(flow: Trajectory) -> Finding:
    """Largest speed of any particle in any frame [m/s]: 0 in geostatic equilibrium.

    In f32 a stress of sigma = rho g H is known to eps sigma, eps = 6e-8, and so the force of a cell to eps sigma A, an
    acceleration of eps g H / dx, which acts until the cell's own elasticity balances it, for dx / c at the most:
    eps g H / c for a rounding, times the some ten that a node sums.
    """
    assert flow.velocities is not None
    scene = flow.scene
    rounding = 10.0 * 2.0**-24 * scene.gravity * scene.masses[0].size[1] / scene.material.wave_speed
    maximum = 1.0e-6 if flow.summary["precision"] == "f64" else 1.0e-6 + rounding
    speed = np.linalg.norm(flow.velocities.astype(np.float64), axis=2).max()
    return Finding(check="speed", value=float(speed), unit="m/s", maximum=maximum)


@check("stress over weight", maximum=0.01)
def weighs_what_lies_above(flow: Trajectory) -> float:
    """Largest error of the mean stress of a layer of four cells at the end over that of the weight above, relative.

    Two cells at the floor and at the surface are left out, where recorded stress, sent through the grid, is that of
    half a neighbourhood; in a layer of a single cell jitter changes how many particles there are by some percent.
    """
    assert flow.pressure is not None
    scene, mass = flow.scene, flow.scene.masses[0]
    height = flow.positions[-1, :, 1].astype(np.float64)
    layer = np.floor((height / scene.domain.cell - 2.0) / 4.0)
    pressure = exact.geostatic_pressure(scene, mass.size[1] - height)
    errors = [
        flow.pressure[-1, layer == each].mean(dtype=np.float64) / pressure[layer == each].mean() - 1.0
        for each in range((round(mass.size[1] / scene.domain.cell) - 4) // 4)
    ]
    return float(np.abs(errors).max())


@check("settlement", minimum=0.95, maximum=1.05)
def settles(flow: Trajectory) -> float:
    """Settlement of the surface at the end, over that of elastic layers that cannot bulge."""
    return float(surface_settlement(flow)[-1]) / exact.settlement(flow.scene)


@check("deepest settlement", maximum=2.1)
def settles_at_most_twice(flow: Trajectory) -> float:
    """Largest settlement of the surface in any frame, over that of elastic layers.

    Without damping the layer swings: it may sink twice as far as under a load that comes slowly, and no further.
    """
    return float(surface_settlement(flow).max()) / exact.settlement(flow.scene)


@check("settlement at rest", minimum=0.9, maximum=1.1)
def rests_settled(flow: Trajectory) -> float:
    """Settlement of a bed when the solver calls it at rest, over that of an elastic layer.

    Under gravity that comes at once it swings between 0 and twice that, where nothing moves either.
    """
    rest = rest_time(flow)
    frame = int(np.argmin(np.abs(flow.time - rest))) if math.isfinite(rest) else 0
    return float(surface_settlement(flow)[frame]) / exact.settlement(flow.scene)


def rests_after_landing(flow: Trajectory) -> Finding:
    """Time at which the solver calls thrown sand at rest, over that of its landing; it does rest before the end."""
    landing = exact.landing_time(flow.scene)
    value, maximum = rest_time(flow) / landing, flow.scene.duration / landing
    return Finding(check="rest over landing", value=value, minimum=1.0, maximum=maximum)


@check("height lost", "cells", maximum=0.05)
def stands(flow: Trajectory) -> float:
    """Mean height lost by soil far from failure [cells], of the second half of the frames: it stands.

    The elastic settlement is part of it: rho g H^2 / (3 E) in the mean of a free column.
    """
    height = flow.positions[:, :, 1].mean(axis=1, dtype=np.float64)
    return in_cells(height[0] - height[len(height) // 2 :].mean(), flow)


@check("height of the centre", minimum=0.95, maximum=1.05)
def stands_as_before(flow: Trajectory) -> float:
    """Height of the centre of a bed at rest between walls, over half the bed's: neither loose nor above the floor."""
    return float(flow.positions[-1, :, 1].mean(dtype=np.float64)) / (0.5 * flow.scene.masses[0].size[1])


def spreads(flow: Trajectory) -> Finding:
    """The front lies at least where that of a pile of the same area at the angle of friction would [m]."""
    return Finding(check="front [m]", value=front(flow.positions[-1]), minimum=exact.repose_front(flow.scene))


def runout_of_collapse(flow: Trajectory) -> Finding:
    """(d - L) / L of a tall column of aspect a, d the front.

    Between 1.9 a^(2/3), sand in a flume (Lube et al. 2005, a > 2.8), and 3.25 a^0.7, discs (Staron & Hinch 2005).
    """
    length, height = flow.scene.masses[0].size
    aspect = height / length
    value = (front(flow.positions[-1]) - length) / length
    return Finding(check="(d - L) / L", value=value, minimum=1.9 * aspect ** (2.0 / 3.0), maximum=3.25 * aspect**0.7)


def creeps(flow: Trajectory, *, since: float, cells: float) -> Finding:
    """Largest displacement of any particle from the time `since` [s] to the end [cells]."""
    start = int(np.argmin(np.abs(flow.time - since)))
    moved = np.linalg.norm((flow.positions[start:] - flow.positions[start]).astype(np.float64), axis=2)
    value = in_cells(moved.max(), flow)
    return Finding(check=f"creep from {since:g} s", value=value, unit="cells", maximum=cells)


@check("front moved", "cells", minimum=2.0)
def runs_out(flow: Trajectory) -> float:
    """How far the front has moved [cells]."""
    return in_cells(front(flow.positions[-1]) - front(flow.positions[0]), flow)


@check("moved a cell", maximum=FAILED)
def stands_but_for_spall(flow: Trajectory) -> float:
    """Share of the particles that moved by a cell or more: what spalls off a face with hardly any tension is less."""
    return moved_share(flow)


@check("moved a cell", minimum=FAILED)
def falls(flow: Trajectory) -> float:
    """Share of the particles that moved by a cell or more: from FAILED on a cut has failed."""
    return moved_share(flow)


def over_critical_height(flow: Trajectory, *, ratio: float) -> Finding:
    """Height of the cut over its critical height (`mpm.exact_solutions`): that the scene is what it says."""
    value = flow.scene.masses[0].size[1] / exact.critical_height(flow.scene)
    return Finding(check="H over critical H", value=value, minimum=ratio - 0.001, maximum=ratio + 0.001)


@check("tension over weight", maximum=1.0e-6)
def never_pulls(flow: Trajectory) -> float:
    """Largest tension of any particle in any frame, over the weight rho g H of the sand: cohesionless, it has none."""
    assert flow.pressure is not None
    height = max(mass.lower[1] + mass.size[1] for mass in flow.scene.masses)
    weight = flow.scene.material.density * flow.scene.gravity * height
    return max(0.0, -float(flow.pressure.min())) / weight


@check("wall impulse / M v", minimum=1.0, maximum=2.0)
def wall_stops(flow: Trajectory) -> float:
    """Largest momentum given to the walls along x, over that of the thrown mass.

    1 where the mass only stops, 2 where it bounces off without loss.
    """
    return share_of_throw(flow, wall_impulse(flow))


@check("baffle impulse / M v", maximum=2.0)
def baffle_stops(flow: Trajectory) -> float:
    """Largest momentum given to the baffles along x, over that of the thrown mass."""
    assert flow.solid_impulse is not None
    return share_of_throw(flow, flow.solid_impulse.sum(axis=1))


@check("speed kept", minimum=0.98, maximum=1.001)
def keeps_speed(flow: Trajectory) -> float:
    """Mean speed along x just before the first particle is near the floor, over that at the start.

    Baffle and air are smooth: nothing may hold the layer, neither while it slides nor at the corner.
    """
    assert flow.velocities is not None
    near = flow.positions[:, :, 1].min(axis=1) < 2.0 * flow.scene.domain.cell
    speed = flow.velocities[:, :, 0].mean(axis=1, dtype=np.float64)
    return float(speed[int(np.argmax(near)) - 1] / speed[0])


@check("past the baffle", minimum=0.99)
def passes_baffle(flow: Trajectory) -> float:
    """Share of the particles that are beyond the baffle at the end."""
    baffle = flow.scene.baffles[0]
    return float((flow.positions[-1, :, 0] > baffle.lower[0] + baffle.size[0]).mean())


@check("height at the end", "cells", maximum=0.5)
def lands(flow: Trajectory) -> float:
    """Height of the highest particle at the end [cells]: a single one lies on the floor."""
    return in_cells(flow.positions[-1, :, 1].max(), flow)


@check("out of round", "cells", maximum=1.0)
def is_round(flow: Trajectory) -> float:
    """Largest difference between the extents of the deposit along +x, -x, +z and -z from where it started [cells]."""
    start, end = flow.positions[0].mean(axis=0, dtype=np.float64), flow.positions[-1]
    extents = [np.quantile(sign * (end[:, axis] - start[axis]), 0.995) for axis in (0, 2) for sign in (-1, 1)]
    return in_cells(max(extents) - min(extents), flow)


@check("toe along x against z", "cells", maximum=0.1)
def is_symmetric(flow: Trajectory) -> float:
    """Difference between the toes along x and z, the mean of the furthest tenth, where both are alike [cells].

    The fronts rest on half a per cent of the particles, and where these lie another jitter decides.
    """
    end = flow.positions[-1]
    return in_cells(abs(toe(end)[0] - toe(end[:, ::-1])[0]), flow)


@check("centre moved", "cells", maximum=0.1)
def stays_centred(flow: Trajectory) -> float:
    """How far the centre has moved along the floor [cells]."""
    moved = exact.centre_displacement(flow)[-1]
    return in_cells(math.hypot(moved[0], moved[2]), flow)


@check("step", minimum=0.85, maximum=0.9)
def step_used(flow: Trajectory) -> float:
    """Fraction of cell / wave speed that the steps took on average: that the row tests what it says."""
    scene = flow.scene
    fastest = max(scene.material_of(mass).wave_speed for mass in scene.masses)
    return float(scene.duration / flow.summary["steps"] * fastest / scene.domain.cell)


@check("particles, f32 to f64", "cells", maximum=0.1)
def every_particle_agrees(single: Trajectory, double: Trajectory) -> float:
    """Largest distance between the same particle in f32 and f64 in any frame [cells]; the runout d among them."""
    apart = np.linalg.norm(single.positions.astype(np.float64) - double.positions, axis=2)
    return in_cells(apart.max(), single)


def as_far_as(flow: Trajectory, other: Trajectory, *, within: float) -> Finding:
    """Front over that of the same scene at another step or stiffness, of which the front is independent."""
    value = front(flow.positions[-1]) / front(other.positions[-1])
    return Finding(check="front over the other's", value=value, minimum=1.0 - within, maximum=1.0 + within)


def moved_share(flow: Trajectory) -> float:
    """Share of the particles that lie a cell or more from where they began."""
    moved = np.linalg.norm((flow.positions[-1] - flow.positions[0]).astype(np.float64), axis=1)
    return float((moved >= flow.scene.domain.cell).mean())


def surface_settlement(flow: Trajectory) -> NDArray[np.float64]:
    """How far the topmost cell of particles has settled [m], shape [T]."""
    start = flow.positions[0, :, 1]
    top = start > start.max() - flow.scene.domain.cell
    return np.asarray((start[top] - flow.positions[:, top, 1]).mean(axis=1, dtype=np.float64))


def mass_height(flow: Trajectory, index: int) -> NDArray[np.float64]:
    """Height of the centre of what was one of the scene's masses [m], shape [T]."""
    box = flow.scene.masses[index]
    start = flow.positions[0, :, 1]
    mass = (start > box.lower[1]) & (start < box.lower[1] + box.size[1])
    return np.asarray(flow.positions[:, mass, 1].mean(axis=1, dtype=np.float64))


def rest_time(flow: Trajectory) -> float:
    """When the solver says that the flow came to rest [s]; inf where it does not."""
    time = flow.summary.get("rest_time")
    return math.inf if time is None else float(time)


def share_of_throw(flow: Trajectory, impulse: NDArray[np.float64]) -> float:
    """Largest x of an impulse [N s], shape [T, D], over the momentum that the flow had along x at the start."""
    assert flow.velocities is not None
    thrown = float(particle_masses(flow) @ flow.velocities[0, :, 0].astype(np.float64))
    return float(impulse[:, 0].max()) / thrown
