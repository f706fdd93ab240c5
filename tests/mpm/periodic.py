"""A layer on an incline that has no ends, for tests: three periods in a box, the outer two copies of the middle one.

After every frame the middle period is wrapped and copied; what the ends of the box disturb does not reach it within one.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from datasets.material import Material
from datasets.scene import Domain, Mass, Scene
from mpm import LAST, runtime
from mpm.arrays.batch import Batch
from mpm.kernel import Phase, kernel

Floats = NDArray[np.float64]

CELLS = 20
"""Over the depth."""
PERIOD = 10
"""Cells along the slope, as far as a wave travels in more than 20 steps."""
STEPS = 12
"""Steps in a frame."""


class EndlessLayer:
    """A layer of `depth` [m] at rest on a rough floor at `slope_deg`, in static equilibrium, that moves along x."""

    def __init__(self, material, slope_deg, depth=0.2, step_fraction=0.4, **more):
        cell = depth / CELLS
        self.length = PERIOD * cell
        self.frame_dt = 0.999 * STEPS * step_fraction * cell / material.wave_speed
        self.scene = Scene(
            domain=Domain(size=(3.0 * self.length, 1.5 * depth), cell=cell),
            material=material,
            masses=(Mass(lower=(0.0, 0.0), size=(3.0 * self.length, depth)),),
            slope_deg=slope_deg,
            floor_friction=1.0e4,
            frame_dt=self.frame_dt,
            duration=2.0 * self.frame_dt,
            step_fraction=step_fraction,
            **({"jitter": 0.0} | more),
        )
        runtime.start("f64", 1)
        self.batch = Batch([self.scene], precision="f64", record=LAST)
        features = self.batch.features
        blocks = self.batch.state_of(0)
        numbers = np.moveaxis(blocks, 1, 0).reshape(features.block, -1)
        periods = np.floor(numbers[0] / self.length)
        self.copies = [np.flatnonzero(periods == k) for k in range(3)]
        self.state = numbers[:, self.copies[1]]
        along, down = self.scene.gravity_vector
        weight = material.density * (depth - self.state[1])
        for k, stress in enumerate((down, down, down, along)):
            self.state[features.stress + k] = stress * weight

    def throw(self, velocity: Callable[[Floats], Floats]) -> None:
        """Let it move at `velocity` [m/s] of the height y [m]."""
        features, y, h = self.batch.features, self.state[1], 1.0e-6
        self.state[features.velocity] = velocity(y)
        self.state[features.affine + 1] = (velocity(y + h) - velocity(y - h)) / (2.0 * h)

    def run(self, seconds: float) -> tuple[Floats, Floats]:
        """Mean velocity of the rows of cells [m/s], shape [CELLS], and of all particles at the ends of 10 parts of it."""
        features, means = self.batch.features, []
        blocks, step = self.batch.state_of(0), kernel(self.batch.features)
        frames = 10 * max(1, round(seconds / self.frame_dt / 10.0))
        for frame in range(frames):
            self.state[0] %= self.length
            numbers = np.moveaxis(blocks, 1, 0).reshape(features.block, -1).copy()
            for k, own in enumerate(self.copies):
                numbers[:, own] = self.state
                numbers[0, own] += k * self.length
            blocks[:] = np.moveaxis(numbers.reshape(features.block, -1, features.lanes), 0, 1)
            step(*self.batch.arguments.values(), 1, 2, Phase.FRAMES)
            numbers = np.moveaxis(blocks, 1, 0).reshape(features.block, -1)
            self.state = numbers[:, self.copies[1]]
            if (frame + 1) % (frames // 10) == 0:
                means.append(float(self.state[features.velocity].mean()))
        rows = np.clip(self.state[1] / self.scene.domain.cell, 0, CELLS - 1).astype(int)
        speeds = self.state[features.velocity]
        return np.bincount(rows, speeds, CELLS) / np.bincount(rows, minlength=CELLS), np.array(means)


def bagnold(inertial: float, diameter: float, grain_density: float, scene: Scene, depth: float) -> Callable[[Floats], Floats]:
    """u(y) = (2/3) (I / d) sqrt(rho g cos(theta) / rho_s) (h^1.5 - (h - y)^1.5) [m/s] (Bagnold 1954; GDR MiDi 2004)."""
    pressure = -scene.gravity_vector[1] * scene.material.density / grain_density
    factor = 2.0 / 3.0 * inertial / diameter * math.sqrt(pressure)
    return lambda y: factor * (depth**1.5 - np.maximum(depth - y, 0.0) ** 1.5)
