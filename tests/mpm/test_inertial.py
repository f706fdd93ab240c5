"""Friction that grows with the inertial number: the return of an element, and layers on rough inclines."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from datasets import Mass, Material, Scene
from mpm import LAST, runtime, simulate
from mpm.arrays.batch import Batch, put_vectors
from mpm.kernel import compute
from tests.mpm.element import XX, XY, YY, ZZ, follow_states
from tests.scenes import COLUMN, SAND, box, scene_of

Floats = NDArray[np.float64]

DEPTH = 0.2  # of the layer [m]
CELLS = 20  # over the depth
PERIOD = 10  # cells along the slope
STEPS = 12  # steps in a frame; in each a wave travels by 0.4 cells


class EndlessLayer:
    """A layer on a rough floor at `slope_deg`, in static equilibrium, that has no ends: three periods in a box.

    After every frame the middle one is wrapped and copied; what the ends of the box disturb does not reach it in one.
    """

    def __init__(self, material: Material, slope_deg: float, **settings: Any) -> None:
        cell = DEPTH / CELLS
        self.length = PERIOD * cell
        self.frame_dt = 0.999 * STEPS * 0.4 * cell / material.wave_speed
        size, body = (3.0 * self.length, 1.5 * DEPTH), Mass(lower=(0.0, 0.0), size=(3.0 * self.length, DEPTH))
        settings |= {"slope_deg": slope_deg, "floor_friction": "rough", "jitter": 0.0}
        settings |= {"frame_dt": self.frame_dt, "duration": 2.0 * self.frame_dt}
        self.scene = scene_of(body, size=size, cell=cell, material=material, **settings)
        runtime.start("f64", 1)
        self.batch = Batch([self.scene], precision="f64", record=LAST)
        features = self.batch.features
        numbers = self.batch.numbers(0, 0, features.state.size)
        self.copies = [np.flatnonzero(np.floor(numbers[0] / self.length) == k) for k in range(3)]
        self.state = numbers[:, self.copies[1]]
        along, down = self.scene.gravity_vector
        weight = material.density * (DEPTH - self.state[1])
        for k, gravity in enumerate((down, down, down, along)):
            self.state[features.state.stress + k] = gravity * weight

    def throw(self, velocity: Callable[[Floats], Floats]) -> None:
        """Let it move at `velocity` [m/s] of the height y [m]."""
        features, y, h = self.batch.features, self.state[1], 1.0e-6
        self.state[features.state.velocity] = velocity(y)
        self.state[features.state.affine + 1] = (velocity(y + h) - velocity(y - h)) / (2.0 * h)

    def run(self, seconds: float) -> tuple[Floats, Floats]:
        """Mean velocity [m/s] of each row of cells at the end, shape [CELLS], and of all particles in ten moments."""
        features, means = self.batch.features, []
        frames = 10 * max(1, round(seconds / self.frame_dt / 10.0))
        for frame in range(1, frames + 1):
            self.state[0] %= self.length
            numbers = self.batch.numbers(0, 0, features.state.size)
            for k, image in enumerate(self.copies):
                numbers[:, image] = self.state
                numbers[0, image] += k * self.length
            put_vectors(self.batch.state_of(0), 0, numbers.T)
            # The same frame again and again.
            self.batch.computed = 0
            compute(self.batch, 2, 1)
            self.state = self.batch.numbers(0, 0, features.state.size)[:, self.copies[1]]
            if frame % (frames // 10) == 0:
                means.append(float(self.state[features.state.velocity].mean()))
        rows = np.clip(self.state[1] / self.scene.domain.cell, 0, CELLS - 1).astype(int)
        return np.bincount(rows, self.state[features.state.velocity]) / np.bincount(rows), np.array(means)


def bagnold(scene: Scene, inertial: float) -> Callable[[Floats], Floats]:
    """u(y) = (2/3) (I / d) sqrt(rho g cos(theta) / rho_s) (h^1.5 - (h - y)^1.5) [m/s] (Bagnold 1954; GDR MiDi 2004)."""
    sand = scene.material
    weight = -scene.gravity_vector[1] * sand.density / sand.grain_density
    factor = 2.0 / 3.0 * inertial / sand.grain_diameter * math.sqrt(weight)
    return lambda y: factor * (DEPTH**1.5 - np.maximum(DEPTH - y, 0.0) ** 1.5)


# Jop's glass beads, but for their size: a law of a continuum does not mind.
GRAINS = {"grain_diameter": 0.04, "grain_density": 2450.0}
BEADS = Material(friction_deg=20.9, angle="slope", friction_limit_deg=32.8, density=1500.0, **GRAINS)


def mu(inertial: float) -> float:
    """mu(I) of `BEADS` (Jop, Forterre & Pouliquen 2006)."""
    slow, fast = math.tan(math.radians(20.9)), math.tan(math.radians(32.8))
    return slow + (fast - slow) / (1.0 + 0.279 / inertial)


@pytest.mark.double
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("cohesion", [0.0, 300.0])
def test_simple_shear_has_the_friction_of_its_rate(dimension: int, cohesion: float) -> None:
    """tau = c cos phi_s + mu(I) s_n on the plane that shears, to 1e-6, at any step; angles of a slope and triaxial."""
    slope = dataclasses.replace(BEADS, young=1.0e10, cohesion=cohesion, tension_cutoff=0.0)
    phi = [math.degrees(math.asin(math.tan(math.radians(angle)))) for angle in (20.9, 32.8)]
    triaxial = dataclasses.replace(slope, angle="triaxial", friction_deg=phi[0], friction_limit_deg=phi[1])
    pressure, start = 1.0e3, np.zeros(4 if dimension == 2 else 6)
    start[:3], start[XY] = -pressure, 0.3 * pressure
    for rate, dt, sand in ((0.02, 1e-5, slope), (2.0, 1e-5, triaxial), (2.0, 1e-3, slope), (200.0, 1e-3, slope)):
        path = np.zeros((4000 if rate * dt < 1e-4 else 50, dimension, dimension))
        path[:, 0, 1] = rate * dt
        stress = follow_states(sand, path, start, dt=dt)[0][-1]
        inertial = rate * 0.04 / math.sqrt(pressure / 2450.0)
        expected = mu(inertial) + cohesion * math.cos(math.radians(phi[0])) / pressure
        radius = math.hypot(stress[XY], 0.5 * (stress[XX] - stress[YY]))
        assert -0.5 * (stress[XX] + stress[YY]) == pytest.approx(pressure, rel=1e-7)
        assert radius / pressure == pytest.approx(expected, rel=1e-7)
        if sand is slope and rate < 10.0:
            # Axes of stress lag behind those of the strain by the elastic strain alone.
            assert stress[XY] / -stress[YY] == pytest.approx(expected, rel=1e-6)


@pytest.mark.double
@pytest.mark.parametrize("dilation_deg", [0.0, 6.0])
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_step_of_any_size_is_backward_eulers(dimension: int, dilation_deg: float) -> None:
    """One step: sin phi of the new stress is that of the plastic shear of this step, from slow to very fast shear."""
    dense = dataclasses.replace(BEADS, dilation_deg=dilation_deg, cohesion=100.0, tension_cutoff=0.0, young=1.0e7)
    slow, growth = math.sin(math.radians(dense.phi_deg)), dense.sin_phi_limit - math.sin(math.radians(dense.phi_deg))
    strength = 100.0 * math.cos(math.radians(dense.phi_deg))
    start = np.zeros(4 if dimension == 2 else 6)
    start[:3] = -1.0e3
    for strain, dt in ((2e-4, 1e-1), (2e-4, 1e-4), (1e-3, 1e-4), (1e-3, 1e-6)):
        path = np.zeros((1, dimension, dimension))
        path[0, 0, 0], path[0, 1, 1] = strain, -strain
        stress = follow_states(dense, path, start, dt=dt)[0][-1]
        trial = start[:2] + 2.0 * dense.shear_modulus * np.array([strain, -strain])
        radius, centre = 0.5 * (stress[XX] - stress[YY]), -0.5 * (stress[XX] + stress[YY])
        shear = (0.5 * (trial[0] - trial[1]) - radius) / dense.shear_modulus
        inertial = shear / dt * 0.04 / math.sqrt(centre / 2450.0)
        share = ((radius - strength) / centre - slow) / growth
        assert share == pytest.approx(1.0 / (1.0 + 0.279 / inertial), abs=1e-3 if dilation_deg == 0.0 else 0.02)


@pytest.mark.double
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_on_an_edge_the_rate_is_that_of_both_planes(sign: float) -> None:
    """Axisymmetric compression and extension at constant mean stress: e1 - e3 = 1.5 e; a step strains beyond P / G."""
    stiff, rate, dt = dataclasses.replace(BEADS, young=1.0e9), 2.0, 1.0e-4
    path = np.tile(sign * np.diag([0.5, -1.0, 0.5]) * rate * dt, (400, 1, 1))
    stress = follow_states(stiff, path, np.array([-1e3, -1e3, -1e3, 0, 0, 0]), dt=dt)[0][-1]
    centre = -0.5 * (stress[XX] + stress[YY])
    sine = 0.5 * sign * (stress[XX] - stress[YY]) / centre
    assert stress[XX] == pytest.approx(stress[ZZ], rel=1e-6)
    assert sine - mu(1e-9) == pytest.approx(mu(1.5 * rate * 0.04 / math.sqrt(centre / 2450.0)) - mu(1e-9), rel=0.03)


@pytest.mark.parametrize("limit_deg", [30.0, 50.0])
def test_without_growth_and_at_rest_it_is_mohr_coulomb_to_the_bit(limit_deg: float) -> None:
    """A limit at the angle itself; a block too strong to yield. Else the column goes less far."""
    strong = dataclasses.replace(SAND, cohesion=1.0e6, tension_cutoff=1.0e6)
    for sand in (SAND, strong):
        fast = dataclasses.replace(sand, friction_limit_deg=limit_deg, grain_diameter=5e-3)
        plain, flow = (simulate(box(COLUMN, material=material), record=LAST) for material in (sand, fast))
        if sand is SAND and limit_deg > 30.0:
            assert flow.summary["front"] < plain.summary["front"] - 1e-3
        else:
            np.testing.assert_array_equal(flow.positions, plain.positions)


@pytest.mark.slow
@pytest.mark.double
@pytest.mark.parametrize("inertial", [0.01, 0.05, 0.3])
def test_a_layer_on_an_incline_has_bagnolds_profile(inertial: float) -> None:
    """Thrown 10 % too fast it comes to u(y) = (2/3) (I / d) sqrt(...) (h^1.5 - (h - y)^1.5), within 3 % at 20 cells."""
    layer = EndlessLayer(BEADS, math.degrees(math.atan(mu(inertial))))
    exact = bagnold(layer.scene, inertial)
    layer.throw(lambda y: 1.1 * exact(y))
    rows, means = layer.run(1.0 if inertial < 0.1 else 3.0)
    y = (np.arange(CELLS) + 0.5) * DEPTH / CELLS
    assert means[0] > 1.03 * exact(y).mean()
    assert means[-1] == pytest.approx(exact(y).mean(), rel=0.03)
    apart = (rows - exact(y)) / exact(np.array(DEPTH))
    assert np.sqrt((apart**2).mean()) < 0.03
    # The lowest row of cells shows the rows of particles, not the mean over a cell.
    assert np.abs(apart[2:]).max() < 0.035


@pytest.mark.slow
@pytest.mark.double
@pytest.mark.parametrize("law", ["Mohr-Coulomb", "mu(I)"])
def test_the_critical_slope_is_the_angle(law: str) -> None:
    """0.3 degrees below its angle of a slope a thrown layer slows down, or stops; 0.3 above it goes on."""
    for sign in (-1.0, 1.0):
        if law == "mu(I)":
            inertial = 0.279 / ((mu(1e9) - mu(1e-9)) / (math.tan(math.radians(21.2)) - mu(1e-9)) - 1.0)
            # Elastic waves, which the transfer without losses keeps, make sand slip at lower slopes.
            layer = EndlessLayer(BEADS, 20.9 + 0.3 * sign, relaxation_time=0.0)
            layer.throw(bagnold(layer.scene, inertial))
            _, means = layer.run(0.6)
            assert means[-1] / means[0] == pytest.approx(0.0 if sign < 0.0 else 1.0, abs=0.1)
        else:
            layer = EndlessLayer(dataclasses.replace(BEADS, friction_limit_deg=None), 20.9 + 0.3 * sign)
            layer.throw(lambda y: 0.4 + 0.0 * y)
            _, means = layer.run(1.0)
            assert sign * (means[-1] - means[4]) > 0.0
