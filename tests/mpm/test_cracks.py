"""Cracks at the tension cutoff, one element at a time: elastic coupling beside them, closing, and memory."""

import numpy as np
import pytest

from datasets.material import Material
from tests.mpm.element import XX, XY, YY, ZZ, follow, follow_states

pytestmark = pytest.mark.double

ROCK = Material(friction_deg=35.0, cohesion=1.0e6, tension_cutoff=2.0e3, young=5.0e7, poisson=0.3)
LOOSE = Material(friction_deg=35.0, cohesion=1.0e6, tension_cutoff=0.0, young=5.0e7, poisson=0.25)


def strained(material: Material, strain: dict[int, float]) -> np.ndarray:
    """Elastic stress [Pa] xx, yy, zz, xy of a plane strain."""
    stress = np.full(4, material.lame * sum(strain.values()))
    stress[XY] = 0.0
    for axis, value in strain.items():
        stress[axis] += 2.0 * material.shear_modulus * value
    return stress


def along(axis: int, total: float, steps: int, dimension: int = 2) -> np.ndarray:
    """Displacement-gradient increments [steps, D, D] that stretch one axis by `total` [-] altogether."""
    path = np.zeros((steps, dimension, dimension))
    path[:, axis, axis] = total / steps
    return path


@pytest.mark.parametrize("material", [ROCK, LOOSE], ids=["cutoff", "none"])
@pytest.mark.parametrize("angle_deg", [0.0, 27.0])
def test_a_crack_opens_beside_compression(material: Material, angle_deg: float) -> None:
    """Squeezed along y, then stretched along x: sigma_x stops at T, sigma_y and sigma_z relax by what x gave up."""
    turn = np.radians(angle_deg)
    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    further = along(YY, -1e-4, 10) + along(XX, 1e-4, 10)
    path = np.concatenate([along(YY, -1e-3, 20), along(XX, 2e-3, 50), further])
    history = follow(material, axes @ path @ axes.T)
    full = np.zeros((len(history), 2, 2))
    full[:, 0, 0], full[:, 1, 1], full[:, 0, 1], full[:, 1, 0] = history[:, [XX, YY, XY, XY]].T
    turned = axes.T @ full @ axes
    size, limit = 1e-3 * material.young, material.tension_limit
    modulus = material.lame + 2 * material.shear_modulus
    squeezed = strained(material, {YY: -1e-3})
    opening = (limit - squeezed[XX]) / modulus
    beside = squeezed + strained(material, {XX: opening})
    assert opening < 2e-3
    np.testing.assert_allclose(turned[69, 0, 0], limit, atol=1e-10 * size)
    np.testing.assert_allclose(turned[69, 1, 1], beside[YY], rtol=1e-10)
    np.testing.assert_allclose(history[69, ZZ], beside[ZZ], rtol=1e-10)
    np.testing.assert_allclose(turned[:, 0, 1], 0.0, atol=1e-10 * size)
    # Uniaxial compression in plane strain beside the open crack.
    plane = material.young / (1.0 - material.poisson**2)
    np.testing.assert_allclose(turned[79, 1, 1] - turned[69, 1, 1], -1e-4 * plane, rtol=1e-9)
    np.testing.assert_allclose(turned[79, 0, 0], limit, atol=1e-10 * size)


def test_a_free_side_carries_the_uniaxial_modulus() -> None:
    """Cohesion 1 MPa without tension: a strut with cracks beside it has E / (1 - nu^2) in 2D and E in 3D."""
    flat = along(YY, -1e-3, 40) + along(XX, 3e-3, 40)
    history = follow(LOOSE, flat)
    sigma = -1e-3 * LOOSE.young / (1.0 - LOOSE.poisson**2)
    np.testing.assert_allclose(history[-1], [0.0, sigma, LOOSE.poisson * sigma, 0.0], rtol=1e-10, atol=1e-10 * -sigma)
    solid = along(1, -1e-3, 40, 3) + along(0, 3e-3, 40, 3) + along(2, 2e-3, 40, 3)
    history = follow(LOOSE, solid)
    expected = np.array([0.0, -1e-3 * LOOSE.young, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(history[-1], expected, rtol=1e-10, atol=1e-10 * 1e-3 * LOOSE.young)


@pytest.mark.parametrize("material", [ROCK, LOOSE], ids=["cutoff", "none"])
@pytest.mark.parametrize("dimension", [2, 3])
def test_volume_correction_closes_a_crack_before_it_bears(material: Material, dimension: int) -> None:
    """Open and close by the same strain: sigma_x stays T until the crack is shut, and all is as it was before."""
    squeeze, opening = along(YY, -1e-3, 20, dimension), along(XX, 2e-3, 50, dimension)
    hold = np.zeros((200, dimension, dimension))
    history, _, opened = follow_states(material, np.concatenate([squeeze, opening, hold, -opening]), corrected=True)
    size = 1e-3 * material.young
    # An open crack at rest changes nothing, however many steps pass.
    np.testing.assert_allclose(history[269], history[69], atol=1e-9 * size)
    bulk = material.lame + 2.0 / 3.0 * material.shear_modulus
    first = (material.tension_limit - history[19, XX]) / (material.lame + 2 * material.shear_modulus)
    np.testing.assert_allclose(opened[[69, 269]], bulk * (2e-3 - first), rtol=1e-9)
    shut = opened[270:] == 0.0
    assert np.flatnonzero(shut)[0] == pytest.approx((2e-3 - first) / 4e-5, abs=1.0)
    np.testing.assert_allclose(history[270:][~shut, XX], material.tension_limit, atol=1e-9 * size)
    np.testing.assert_allclose(history[270:][~shut, YY], history[69, YY], atol=1e-9 * size)
    np.testing.assert_allclose(history[-1], history[19], atol=1e-9 * size)


def test_cohesionless_sand_remembers_as_the_general_law_does() -> None:
    """Without cohesion the opening is that beyond the apex, isotropic; the general form with c = T = 0 agrees."""
    sand = Material(friction_deg=33.0)
    random = np.random.default_rng(0)
    for dimension in (2, 3):
        path = random.normal(0.0, 3e-5, (300, dimension, dimension))
        path -= path.mean(axis=0)
        path += 1e-4 * np.cos(np.arange(300) / 10.0)[:, None, None] * np.eye(dimension)
        cheap, _, opened = follow_states(sand, path, corrected=True, cohesive=False)
        assert (opened > 0.0).sum() > 50
        assert ((opened == 0.0) & (cheap[:, YY] < 0.0)).sum() > 50
        general, _, remembered = follow_states(sand, path, corrected=True)
        np.testing.assert_allclose(general, cheap, atol=1e-6 * np.abs(cheap).max())
        np.testing.assert_allclose(remembered, opened, atol=1e-6 * opened.max())
