"""Closed-form solutions for tests of the solver, each an object made from its scene.

    slide = SlidingBlock.of_scene(scene)
    error = centre(trajectory)[-1, 0] - slide.displacement(scene.duration)

The stability page and the tests take them from here. Positions and lengths in m, times in s, angles in
radians; trajectories are read, never simulated.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datasets.flow.trajectory import Trajectory
from datasets.scene import Scene, coefficient

Floats = NDArray[np.float64]


def centre_displacement(flow: Trajectory) -> Floats:
    """Displacement of the centre [m], shape [T, D]: the mean displacement rounds less than a difference of means."""
    return np.asarray((flow.positions.astype(np.float64) - flow.positions[0].astype(np.float64)).mean(axis=1))


def total_energy(flow: Trajectory) -> Floats:
    """Kinetic + potential + elastic energy [J, per metre of width in 2D], shape [T]."""
    kinds = flow.summary["energy"]
    return np.asarray(np.sum([kinds[kind] for kind in ("kinetic", "potential", "elastic")], axis=0), np.float64)


@dataclass(frozen=True, kw_only=True)
class FreeFlight:
    """x = v t + g t (t + dt) / 2: a throw, in steps of symplectic Euler ahead of the parabola by g t dt / 2."""

    velocity: tuple[float, ...]  # initial [m/s], shape [D]
    gravity: tuple[float, ...]  # [m/s^2], shape [D]
    step: float  # time step [s]

    @staticmethod
    def of_flow(flow: Trajectory) -> "FreeFlight":
        """The flight of the first mass of a flow, with its mean time step."""
        scene, step = flow.scene, float(flow.time[-1] / flow.summary["steps"])
        velocity = scene.masses[0].velocity or (0.0,) * scene.dimension
        return FreeFlight(velocity=velocity, gravity=scene.gravity_vector, step=step)

    def displacement(self, time: Floats) -> Floats:
        """Displacement [m], shape [T, D], at `time` [s], shape [T]."""
        t = np.asarray(time, np.float64)[:, None]
        return np.asarray(t * np.array(self.velocity) + 0.5 * np.array(self.gravity) * t * (t + self.step))


@dataclass(frozen=True, kw_only=True)
class SlidingBlock:
    """A rigid block on an incline with Coulomb friction, let go at rest: a = g max(0, sin theta - mu cos theta)."""

    acceleration: float  # down the incline [m/s^2]

    @staticmethod
    def of_scene(scene: Scene) -> "SlidingBlock":
        """The block in a tilted box, with the friction of its floor and of the two walls of its channel. The stress on
        the walls is nu times the vertical one: together they act like a floor of 2 mu_w nu (h / 2) / W."""
        mu = coefficient(scene.floor_friction)
        if scene.channel is not None:
            mu += scene.channel.grip * scene.material.poisson * 0.5 * scene.masses[0].size[1]
        return SlidingBlock.on_incline(scene.slope_deg, mu, scene.gravity)

    @staticmethod
    def on_incline(slope_deg: float, friction: float, gravity: float = 9.81) -> "SlidingBlock":
        """The block on an incline with a friction coefficient, under gravity [m/s^2]."""
        slope = math.radians(slope_deg)
        return SlidingBlock(acceleration=gravity * max(0.0, math.sin(slope) - friction * math.cos(slope)))

    def displacement(self, time: float) -> float:
        """Displacement [m] after `time` [s]."""
        return 0.5 * self.acceleration * time**2


@dataclass(frozen=True, kw_only=True)
class StandingWave:
    """The lowest mode of an elastic body: velocity and displacement of one shape oscillate at omega without decay."""

    axis: int  # along which it moves
    omega: float  # angular frequency [1/s]
    shape: Floats  # of the particles at the start [-], shape [N]

    @staticmethod
    def of_bar(flow: Trajectory) -> "StandingWave":
        """Free bar of length L along x, nu = 0: cos(pi x / L), omega = pi / L sqrt(E / rho)."""
        masses, material = flow.scene.masses, flow.scene.material
        length = sum(mass.size[0] for mass in masses)
        x = flow.positions[0, :, 0].astype(np.float64) - masses[0].lower[0]
        omega = math.pi / length * math.sqrt(material.modulus / material.density)
        return StandingWave(axis=0, omega=omega, shape=np.cos(math.pi * x / length))

    @staticmethod
    def of_layer(flow: Trajectory) -> "StandingWave":
        """Layer of height H between smooth walls: sin(pi y / (2 H)), omega = pi / (2 H) sqrt((lambda + 2 mu) / rho)."""
        height = sum(mass.size[1] for mass in flow.scene.masses)
        shape = np.sin(0.5 * math.pi * flow.positions[0, :, 1].astype(np.float64) / height)
        return StandingWave(axis=1, omega=0.5 * math.pi / height * flow.scene.material.wave_speed, shape=shape)

    def decrement(self, flow: Trajectory) -> float:
        """Decay of the amplitude in `flow` per period [-], -d ln a / d(t / T): 2 pi times the damping ratio, exactly 0.

        The amplitude a^2 = <v>^2 + omega^2 <u>^2 of velocity and displacement projected on the shape is constant.
        """
        assert flow.velocities is not None
        x = flow.positions[:, :, self.axis].astype(np.float64)
        speed = flow.velocities[:, :, self.axis].astype(np.float64) @ self.shape
        amplitude = np.hypot(speed, self.omega * ((x - x[0]) @ self.shape))
        return -float(np.polyfit(flow.time * self.omega / (2.0 * math.pi), np.log(amplitude), 1)[0])


def settlement(scene: Scene) -> float:
    """Settlement of layers under their own weight [m], elastic and laterally confined.

    u = sum over the layers of (w + rho g h / 2) h / M, with w the weight above and M the modulus of one-dimensional
    compression. The lateral stress is nu / (1 - nu) of the vertical, less than Mohr-Coulomb requires: nothing yields.
    """
    load = total = 0.0
    for mass in sorted(scene.masses, key=lambda layer: -layer.lower[1]):
        material, height = scene.material_of(mass), mass.size[1]
        weight = material.density * scene.gravity * height
        total += (load + 0.5 * weight) * height / (material.lame + 2.0 * material.shear_modulus)
        load += weight
    return total
