"""Particles have the volume of their own mass in the kernel: its weight, its energy, its stress."""

import dataclasses

import numpy as np
import pytest

from datasets.material import Material
from datasets.particles import initial_particles
from datasets.scene import Domain, Mass, Scene
from mpm import WITH_FIELDS, simulate

SAND = Material(friction_deg=30.0)
THIN = Mass(lower=(0.05, 0.3), size=(0.4, 0.003))
THICK = Mass(lower=(0.55, 0.3), size=(0.2, 0.1))
SCENE = Scene(
    domain=Domain(size=(0.8, 0.5), cell=0.02), material=SAND, masses=(THIN, THICK), duration=0.1, frame_dt=0.01
)
FALLING = pytest.mark.filterwarnings("ignore:masses:UserWarning")


@FALLING
@pytest.mark.parametrize("precision", ["f32", pytest.param("f64", marks=pytest.mark.slow)])
def test_a_thin_and_a_thick_mass_fall_with_their_own_weight(precision: str) -> None:
    flow = simulate(SCENE, precision=precision, threads=1)  # type: ignore[arg-type]
    mass = SAND.density * (0.4 * 0.003 + 0.2 * 0.1)
    kinetic = flow.summary["energy"]["kinetic"]
    assert kinetic[-1] == pytest.approx(0.5 * mass * (9.81 * 0.1) ** 2, rel=1e-4)
    fallen = flow.summary["energy"]["potential"][0] - flow.summary["energy"]["potential"][-1]
    assert fallen == pytest.approx(kinetic[-1], rel=0.02)


@pytest.mark.double
@FALLING
def test_the_floor_takes_the_weight_of_each() -> None:
    # Both lie on the floor: a layer of a seventh of a cell and a slab, which spreads.
    masses = tuple(dataclasses.replace(mass, lower=(mass.lower[0], 0.0)) for mass in (THIN, THICK))
    scene = dataclasses.replace(SCENE, masses=masses, duration=0.2, floor_friction=1.0)
    flow = simulate(scene, precision="f64", threads=1, record=WITH_FIELDS)
    assert flow.velocities is not None
    volume = initial_particles(scene).volume
    momentum = np.einsum("n, tnd -> td", SAND.density * volume, flow.velocities.astype(np.float64))
    weight = SAND.density * 9.81 * (0.4 * 0.003 + 0.2 * 0.1)
    impulse = momentum + np.array(flow.summary["wall_impulse"])
    np.testing.assert_allclose(-impulse[1:, 1] / flow.time[1:], weight, rtol=1e-5)
    np.testing.assert_allclose(impulse[:, 0], 0.0, atol=1e-5 * weight * 0.2)
