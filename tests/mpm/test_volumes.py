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


@pytest.mark.double
@pytest.mark.filterwarnings("ignore:masses:UserWarning")
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
