"""A layer on an incline that has no ends, for tests: three periods in a box, the outer two copies of the middle one.

After every frame the middle period is wrapped and copied; what the ends of the box disturb does not reach it in one.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.material import Material
from datasets.scene import Domain, Mass, Scene
from mpm import LAST, runtime
from mpm.arrays.batch import Batch
from mpm.kernel import Phase, kernel

Floats = NDArray[np.float64]

DEPTH = 0.2
"""Of the layer [m]."""
CELLS = 20
"""Over the depth."""
PERIOD = 10
"""Cells along the slope."""
STEPS = 12
"""Steps in a frame; in each a wave travels by 0.4 cells."""


class EndlessLayer:
    """A layer on a rough floor at `slope_deg`, in static equilibrium."""

    def __init__(self, material: Material, slope_deg: float, **settings: Any) -> None:
        cell = DEPTH / CELLS
        self.length = PERIOD * cell
        self.frame_dt = 0.999 * STEPS * 0.4 * cell / material.wave_speed
        self.scene = Scene(
            domain=Domain(size=(3.0 * self.length, 1.5 * DEPTH), cell=cell),
            material=material,
            masses=(Mass(lower=(0.0, 0.0), size=(3.0 * self.length, DEPTH)),),
            slope_deg=slope_deg,
            floor_friction="rough",
            frame_dt=self.frame_dt,
            duration=2.0 * self.frame_dt,
            jitter=0.0,
            **settings,
        )
        runtime.start("f64", 1)
        self.batch = Batch([self.scene], precision="f64", record=LAST)
        features, numbers = self.batch.features, self.numbers()
        self.copies = [np.flatnonzero(np.floor(numbers[0] / self.length) == k) for k in range(3)]
        self.state = numbers[:, self.copies[1]]
        along, down = self.scene.gravity_vector
        weight = material.density * (DEPTH - self.state[1])
        for k, gravity in enumerate((down, down, down, along)):
            self.state[features.stress + k] = gravity * weight

    def numbers(self) -> Floats:
        """The state of all particles, shape [vectors, N], a copy."""
        return np.moveaxis(self.batch.state_of(0), 1, 0).reshape(self.batch.features.block, -1).copy()

    def throw(self, velocity: Callable[[Floats], Floats]) -> None:
        """Let it move at `velocity` [m/s] of the height y [m]."""
        features, y, h = self.batch.features, self.state[1], 1.0e-6
        self.state[features.velocity] = velocity(y)
        self.state[features.affine + 1] = (velocity(y + h) - velocity(y - h)) / (2.0 * h)

    def run(self, seconds: float) -> tuple[Floats, Floats]:
        """Mean velocity [m/s] of each row of cells at the end, shape [CELLS], and of all particles in ten moments."""
        features, step, means = self.batch.features, kernel(self.batch.features), []
        frames = 10 * max(1, round(seconds / self.frame_dt / 10.0))
        for frame in range(1, frames + 1):
            self.state[0] %= self.length
            numbers = self.numbers()
            for k, own in enumerate(self.copies):
                numbers[:, own] = self.state
                numbers[0, own] += k * self.length
            self.batch.state_of(0)[:] = np.moveaxis(numbers.reshape(features.block, -1, features.lanes), 0, 1)
            step(*self.batch.arguments.values(), 1, 2, Phase.FRAMES)
            self.state = self.numbers()[:, self.copies[1]]
            if frame % (frames // 10) == 0:
                means.append(float(self.state[features.velocity].mean()))
        rows = np.clip(self.state[1] / self.scene.domain.cell, 0, CELLS - 1).astype(int)
        return np.bincount(rows, self.state[features.velocity]) / np.bincount(rows), np.array(means)


def bagnold(scene: Scene, inertial: float) -> Callable[[Floats], Floats]:
    """u(y) = (2/3) (I / d) sqrt(rho g cos(theta) / rho_s) (h^1.5 - (h - y)^1.5) [m/s] (Bagnold 1954; GDR MiDi 2004)."""
    sand = scene.material
    assert sand.grain_diameter is not None
    weight = -scene.gravity_vector[1] * sand.density / sand.grain_density
    factor = 2.0 / 3.0 * inertial / sand.grain_diameter * math.sqrt(weight)
    return lambda y: factor * (DEPTH**1.5 - np.maximum(DEPTH - y, 0.0) ** 1.5)
