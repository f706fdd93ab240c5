"""Strength that falls with slip: element bands of any thickness, and whole runs."""

import dataclasses
from functools import partial

import numpy as np
import pytest

from datasets.scene.material import Material
from mpm.arrays.properties import properties_at, properties_row
from mpm.laws.mohr_coulomb import Column
from tests.mpm.element import XX, XY, YY, ZZ, follow, follow_states

stiff = partial(Material, young=1.0e9)
CLAY = stiff(friction_deg=0.0, cohesion=2.0e4, tension_cutoff=1.0e9, residual_cohesion=5.0e3, softening_length=0.02)


def sheared(slip: float, cell: float, steps: int, dimension: int = 2) -> np.ndarray:
    """Displacement-gradient increments [steps, D, D] of a band `cell` thick whose sides slip by `slip` [m]."""
    path = np.zeros((steps, dimension, dimension))
    path[:, 0, 1] = slip / cell / steps
    return path


@pytest.mark.double
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("cell", [0.01, 0.1, 1.0])
def test_the_work_of_a_band_does_not_depend_on_the_cell(cell: float, dimension: int) -> None:
    """Undrained clay in simple shear: c_r d + (c - c_r) L / 2 per area, at every thickness of the band."""
    slip, steps = 0.05, 4000
    history, strain, _ = follow_states(CLAY, sheared(slip, cell, steps, dimension), cell=cell)
    # The shear strength, not sigma_xy: a band that is sheared by 5 turns its stress, as Jaumann's rate does.
    tau = np.hypot(history[:, XY], 0.5 * (history[:, XX] - history[:, YY]))
    gamma = np.sqrt(3.0) * strain
    elastic = 2.0e4 / CLAY.shear_modulus
    np.testing.assert_allclose(gamma[-1], slip / cell, rtol=1e-3, atol=2 * elastic)
    work = np.sum(tau * np.diff(gamma, prepend=0.0)) * cell
    assert work == pytest.approx(5.0e3 * gamma[-1] * cell + 0.5 * 1.5e4 * 0.02, rel=2e-3)
    np.testing.assert_allclose(tau[-1], 5.0e3, rtol=1e-6)
    # Linear in the slip, by the plastic strain at the step's start.
    before = np.concatenate([[0.0], gamma[:-1]]) * cell
    soft = 5.0e3 + 1.5e4 * np.maximum(0.0, 1.0 - before / 0.02)
    yielding = np.diff(gamma, prepend=0.0) > 0.0
    np.testing.assert_allclose(tau[yielding], soft[yielding], rtol=1e-6)


@pytest.mark.double
def test_friction_and_cohesion_soften_linearly_in_shear() -> None:
    """psi = 0: the radius of Mohr's circle is c cos phi + p sin phi, whose two parts are interpolated in the slip."""
    soil = stiff(
        friction_deg=35.0, cohesion=1.0e4, residual_friction_deg=25.0, residual_cohesion=0.0, softening_length=0.03
    )
    history, strain, _ = follow_states(soil, sheared(0.05, 0.2, 3000), np.array([-1e5, -1e5, -1e5, 0.0]), cell=0.2)
    slip = np.sqrt(3.0) * strain * 0.2
    before = np.concatenate([[0.0], slip[:-1]])
    w = np.maximum(0.0, 1.0 - before / 0.03)
    radius = np.hypot(history[:, XY], 0.5 * (history[:, XX] - history[:, YY]))
    centre = -0.5 * (history[:, XX] + history[:, YY])
    peak = np.sin(np.radians(35.0)), 1.0e4 * np.cos(np.radians(35.0))
    residual = np.sin(np.radians(25.0))
    expected = (residual + w * (peak[0] - residual)) * centre + w * peak[1]
    yielding = (slip > before) & (np.abs(history[:, ZZ] + centre) < 0.5 * radius)
    assert yielding.sum() > 1000
    np.testing.assert_allclose(radius[yielding], expected[yielding], rtol=1e-6)


@pytest.mark.double
def test_dilation_ends_at_the_critical_state() -> None:
    """A dense sand sheared at constant volume presses outwards until the softening length is used up, then no more."""
    dense = Material(
        friction_deg=42.0, dilation_deg=12.0, residual_friction_deg=33.0, softening_length=0.01, young=1.0e7
    )
    start, path = np.array([-1e5, -1e5, -1e5, 0.0]), sheared(0.03, 0.1, 6000)
    history, strain, _ = follow_states(dense, path, start, cell=0.1)
    mean, slip = -history[:, :3].mean(axis=1), np.sqrt(3.0) * strain * 0.1
    used = slip > 0.01
    assert mean[used][0] > 1.5e5
    np.testing.assert_allclose(mean[used], mean[used][0], rtol=2e-3)
    endless = follow(dataclasses.replace(dense, softening_length=None, residual_friction_deg=None), path, start)
    assert -endless[-1, :3].mean() > 2.0 * mean[-1]


@pytest.mark.double
def test_the_apex_limits_the_cutoff_on_the_way() -> None:
    """Where phi falls and c stays, c cot phi rises, but more slowly at first than the line between its ends."""
    soil = stiff(
        friction_deg=40.0, residual_friction_deg=10.0, cohesion=1.0e4, tension_cutoff=1.0e6, softening_length=0.1
    )
    path = np.concatenate([sheared(0.05, 1.0, 500, 3), np.tile(1e-5 * np.eye(3), (300, 1, 1))])
    history, strain, _ = follow_states(soil, path)
    w = 1.0 - np.sqrt(3.0) * strain[-1] / 0.1
    assert 0.2 < w < 0.8
    peak, residual = np.radians(40.0), np.radians(10.0)
    sine = w * np.sin(peak) + (1 - w) * np.sin(residual)
    apex = 1.0e4 * (w * np.cos(peak) + (1 - w) * np.cos(residual)) / sine
    assert apex < 0.9 * (w / np.tan(peak) + (1 - w) / np.tan(residual)) * 1.0e4
    np.testing.assert_allclose(history[-1], [apex, apex, apex, 0.0, 0.0, 0.0], rtol=1e-6, atol=1e-6 * apex)


@pytest.mark.double
@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_an_open_crack_does_not_soften_by_being_there(angle: float) -> None:
    """With volume correction what has opened is taken back every step; that is not plastic strain, even as it turns."""
    soil = Material(
        friction_deg=30.0, cohesion=1e5, tension_cutoff=0.0, residual_cohesion=0.0, softening_length=1.0, young=1e7
    )
    squeeze, stretch = np.zeros((2, 10, 2, 2))
    squeeze[:, 1, 1], stretch[:, 0, 0] = -1e-5, 5e-4
    turn = np.tile(np.array([[0.0, -1.0], [1.0, 0.0]]) * angle / 400, (400, 1, 1))
    _, strain, opened = follow_states(soil, np.concatenate([squeeze, stretch, turn]), corrected=True)
    assert opened[-1] > 1e3
    # Opening by e in one direction: 2/3 e.
    opening = 5e-3 - soil.poisson / (1 - soil.poisson) * 1e-4
    assert strain[19] == pytest.approx(2.0 / 3.0 * opening, rel=1e-3)
    np.testing.assert_allclose(strain[20:], strain[19], rtol=1e-6)


def test_strength_that_grows_with_depth() -> None:
    """c(z) = c + k z, the tension limit below its apex, and the residual cohesion at the same sensitivity."""
    soil = Material(
        friction_deg=20.0,
        cohesion=5.0e3,
        strength_gradient=2.0e3,
        tension_cutoff=2.0e4,
        residual_cohesion=1.0e3,
        softening_length=0.1,
    )
    depth = np.array([0.0, 1.0, 4.0])
    rows, phi = properties_at(soil, depth), np.radians(20.0)
    cohesion = np.array([5.0e3, 7.0e3, 13.0e3])
    np.testing.assert_allclose(soil.cohesion_at(depth), cohesion)
    np.testing.assert_allclose(rows[:, Column.STRENGTH], 2.0 * cohesion * np.cos(phi))
    np.testing.assert_allclose(rows[:, Column.LIMIT], np.minimum(cohesion / np.tan(phi), 2.0e4))
    np.testing.assert_allclose(rows[:, Column.RESIDUAL_STRENGTH], 0.2 * 2.0 * cohesion * np.cos(phi))
    np.testing.assert_array_equal(rows[0], properties_row(soil, 1.0))
    unchanged = [c for c in Column if "STRENGTH" not in c.name and "LIMIT" not in c.name]
    np.testing.assert_array_equal(rows[:, unchanged], np.tile(rows[0, unchanged], (3, 1)))
    default = dataclasses.replace(soil, tension_cutoff=None)
    np.testing.assert_allclose(properties_at(default, depth)[:, Column.LIMIT], 0.003 * cohesion)
    np.testing.assert_allclose(properties_at(default, depth)[:, Column.RESIDUAL_LIMIT], 0.003 * cohesion)
    np.testing.assert_array_equal(properties_at(default, depth)[0], properties_row(default, 1.0))
