"""Expectations that are exact solutions: rigid motion, elastic waves, layers in equilibrium, strong soil.

Each takes a trajectory and returns what it found beside the closed form in its docstring; those with keywords are given
them in `validation.bench.stability.exact_cases`.
"""

import math

import numpy as np
from numpy.typing import NDArray

from datasets.trajectory import Trajectory
from validation.bench.stability.expectations import sunk
from validation.bench.stability.finding import Finding
from validation.bench.stability.invariants import point_masses

DAMPING_OF_SAND = 0.005
"""Damping ratio of dry sand at strains below 1e-5, resonant column: 0.5 to 1 % (Hardin & Drnevich 1972)."""


def slides(flow: Trajectory) -> Finding:
    """Way of the centre of a block down an incline, over g t^2 (sin a - mu cos a) / 2 of a rigid one."""
    scene, slope = flow.scene, math.radians(flow.scene.slope_deg)
    acceleration = scene.gravity * (math.sin(slope) - scene.floor_friction * math.cos(slope))
    exact = 0.5 * acceleration * flow.time[-1] ** 2
    return Finding(check="way over rigid block's", value=float(way(flow)[-1, 0] / exact), least=0.99, most=1.01)


def moves_on(flow: Trajectory) -> Finding:
    """Way of the centre of a body on which no force acts, over v t."""
    velocity = np.array(flow.scene.masses[0].velocity)
    value = float(way(flow)[-1] @ velocity / (velocity @ velocity * flow.time[-1]))
    return Finding(check="way over v t", value=value, least=0.99, most=1.01)


def spins_on(flow: Trajectory) -> Finding:
    """Kinetic energy at the end over that at the start, of a rigid body that turns freely: 1."""
    kinetic = flow.summary["energy"]["kinetic"]
    return Finding(check="energy of spin", value=kinetic[-1] / kinetic[0], least=0.99, most=1.0002)


def keeps_angular_momentum(flow: Trajectory) -> Finding:
    """Largest change of sum m (x - x_c) x v about the centre in any frame, relative: 0 where no moment acts."""
    assert flow.velocities is not None
    weights = point_masses(flow)
    x, v = flow.positions.astype(np.float64), flow.velocities.astype(np.float64)
    arm = x - np.einsum("n, tnd -> td", weights, x)[:, None] / weights.sum()
    moment = np.einsum("n, tn -> t", weights, arm[..., 0] * v[..., 1] - arm[..., 1] * v[..., 0])
    return Finding(check="angular momentum", value=float(np.abs(moment / moment[0] - 1.0).max()), most=1.0e-3)


def bar_decrement(flow: Trajectory, *, most: float) -> Finding:
    """Logarithmic decrement per period of a free bar's lowest longitudinal mode; 0 for an elastic bar.

    v(x, t) = V cos(pi x / L) cos(omega t), omega = pi / L sqrt(E / rho), nu = 0. It is 2 pi times the damping ratio.
    """
    masses, material = flow.scene.masses, flow.scene.material
    first, length = masses[0].lower[0], sum(mass.size[0] for mass in masses)
    shape = np.cos(math.pi * (flow.positions[0, :, 0].astype(np.float64) - first) / length)
    omega = math.pi / length * math.sqrt(material.young / material.density)
    return Finding(check="decrement", value=decrement(flow, shape, 0, omega), least=-1.0e-3, most=most)


def layer_decrement(flow: Trajectory, *, most: float) -> Finding:
    """Logarithmic decrement per period of a layer's lowest vertical mode between smooth walls; 0 for an elastic layer.

    v(y, t) = V sin(pi y / (2 H)) cos(omega t), omega = pi / (2 H) sqrt((lambda + 2 mu) / rho). It is 2 pi times the
    damping ratio.
    """
    return Finding(check="decrement", value=layer_mode(flow)[0], least=-1.0e-3, most=most)


def layer_viscosity(flow: Trajectory, *, most: float) -> Finding:
    """The viscosity eta [Pa s] of sigma = (lambda + 2 mu) eps + eta d(eps)/dt by which the layer's mode would decay so.

    Kelvin and Voigt: a damping ratio of eta omega / (2 (lambda + 2 mu)), which is the decrement over 2 pi.
    """
    decrement_of_mode, omega = layer_mode(flow)
    modulus = flow.scene.material.density * flow.scene.material.wave_speed**2
    value = decrement_of_mode * modulus / (math.pi * omega)
    return Finding(check="viscosity", value=value, unit="Pa s", most=most * modulus / (math.pi * omega))


def layer_mode(flow: Trajectory) -> tuple[float, float]:
    """Decrement per period [-] and angular frequency [1/s] of a layer's lowest vertical mode."""
    height = sum(mass.size[1] for mass in flow.scene.masses)
    shape = np.sin(0.5 * math.pi * flow.positions[0, :, 1].astype(np.float64) / height)
    omega = 0.5 * math.pi / height * flow.scene.material.wave_speed
    return decrement(flow, shape, 1, omega), omega


def decrement(flow: Trajectory, shape: NDArray[np.float64], axis: int, omega: float) -> float:
    """Decay per period 2 pi / omega of the amplitude of a mode of `shape`, shape [N], along `axis`: -d ln a / d(t / T).

    The amplitude a^2 = <v>^2 + omega^2 <u>^2 of velocity and displacement projected on the mode does not swing.
    """
    assert flow.velocities is not None
    x = flow.positions[:, :, axis].astype(np.float64)
    speed = flow.velocities[:, :, axis].astype(np.float64) @ shape
    amplitude = np.hypot(speed, omega * ((x - x[0]) @ shape))
    slope = np.polyfit(flow.time * omega / (2.0 * math.pi), np.log(amplitude), 1)[0]
    return -float(slope)


def stands(flow: Trajectory) -> Finding:
    """Mean height lost by soil far from failure [cells], of the second half of the frames: it stands.

    The elastic settlement is part of it: rho g H^2 / (3 E) in the mean of a free column.
    """
    height = flow.positions[:, :, 1].mean(axis=1, dtype=np.float64)
    lost = height[0] - height[len(height) // 2 :].mean()
    return Finding(check="height lost", value=float(lost) / flow.scene.domain.cell, unit="cells", most=0.05)


def stays_at_rest(flow: Trajectory) -> Finding:
    """Largest speed of any particle in any frame [m/s]: 0 in geostatic equilibrium.

    In f32 a stress of sigma = rho g H is known to eps sigma, eps = 6e-8, and so the force of a cell to eps sigma A, an
    acceleration of eps g H / dx, which acts until the cell's own elasticity balances it, for dx / c at the most:
    eps g H / c for a rounding, times the some ten that a node sums.
    """
    assert flow.velocities is not None
    scene = flow.scene
    height = scene.masses[0].size[1]
    rounding = 10.0 * 2.0**-24 * scene.gravity * height / scene.material.wave_speed
    most = 1.0e-6 if flow.summary["precision"] == "f64" else 1.0e-6 + rounding
    speed = np.linalg.norm(flow.velocities.astype(np.float64), axis=2).max()
    return Finding(check="speed", value=float(speed), unit="m/s", most=most)


def weighs_what_lies_above(flow: Trajectory) -> Finding:
    """Largest error of the mean stress of a layer of four cells at the end over (1 + 2 K0) / 3 rho g z, relative.

    z is the depth below the surface. Two cells at the floor and at the surface are left out, where recorded stress,
    sent through the grid, is that of half a neighbourhood; in a layer of a single cell jitter changes how many
    particles there are, and so their mean stress, by some percent.
    """
    assert flow.pressure is not None
    scene, mass = flow.scene, flow.scene.masses[0]
    k0 = mass.k0
    assert isinstance(k0, float)
    layers = (round(mass.size[1] / scene.domain.cell) - 4) // 4
    height = flow.positions[-1, :, 1].astype(np.float64)
    layer = np.floor((height / scene.domain.cell - 2.0) / 4.0)
    exact = (1.0 + 2.0 * k0) / 3.0 * scene.material.density * scene.gravity * (mass.size[1] - height)
    errors = [
        flow.pressure[-1, layer == each].mean(dtype=np.float64) / exact[layer == each].mean() - 1.0
        for each in range(layers)
    ]
    return Finding(check="stress over weight", value=float(np.abs(errors).max()), most=0.01)


def rests_after_landing(flow: Trajectory) -> Finding:
    """Time at which the solver calls a heap that was thrown up at rest, over that of its landing.

    t = (v + sqrt(v^2 + 2 g h)) / g for a throw at v from the height h; and it does rest before the end.
    """
    scene, mass = flow.scene, flow.scene.masses[0]
    assert mass.velocity is not None
    up = mass.velocity[1]
    landing = (up + math.sqrt(up**2 + 2.0 * scene.gravity * mass.lower[1])) / scene.gravity
    return Finding(check="rest over landing", value=rest_time(flow) / landing, least=1.0, most=scene.duration / landing)


def rests_settled(flow: Trajectory) -> Finding:
    """Settlement of a bed when the solver calls it at rest, over rho g H^2 / (2 M) of an elastic layer between walls.

    Under gravity that comes at once it swings between 0 and twice that, where nothing moves either.
    """
    scene = flow.scene
    material, height = scene.material, scene.masses[0].size[1]
    modulus = material.lame + 2.0 * material.shear_modulus
    exact = material.density * scene.gravity * height**2 / (2.0 * modulus)
    frame = int(np.argmin(np.abs(flow.time - rest_time(flow)))) if math.isfinite(rest_time(flow)) else 0
    return Finding(check="settlement at rest", value=float(sunk(flow)[frame]) / exact, least=0.9, most=1.1)


def rest_time(flow: Trajectory) -> float:
    """When the solver says that the flow came to rest [s]; inf where it does not."""
    time = flow.summary.get("rest_time")
    return math.inf if time is None else float(time)


def way(flow: Trajectory) -> NDArray[np.float64]:
    """Way of the centre [m], shape [T, D]; the mean of the ways, which rounds less than the difference of the means."""
    return np.asarray((flow.positions.astype(np.float64) - flow.positions[0].astype(np.float64)).mean(axis=1))
