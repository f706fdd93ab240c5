"""The return map against closed forms, one element at a time; cracks, closing and memory; strength that falls."""

import dataclasses
from functools import partial

import numpy as np
import pytest

from datasets.scene.material import Material
from mpm.arrays.properties import properties_at, properties_row
from mpm.laws.mohr_coulomb import Column
from tests.mpm.element import XX, XY, YY, ZZ, follow, follow_controlled, follow_states, returned, tensor

pytestmark = pytest.mark.double


@pytest.mark.parametrize(("friction_deg", "dilation_deg"), [(30.0, 0.0), (30.0, 10.0), (42.0, 42.0)])
def test_simple_shear_attains_davis(friction_deg: float, dilation_deg: float) -> None:
    """tau / s_n = sin phi cos psi / (1 - sin phi sin psi) under constant normal stress (Davis 1968)."""
    sand = Material(friction_deg=friction_deg, dilation_deg=dilation_deg, young=2.0e8)
    shear = {"steps": 30, "gradient": lambda free: np.array([[0.0, 3e-5], [0.0, free[0]]]), "held": {YY: -1e4}}
    history = follow_controlled(sand, start=np.array([-1e4, -1e4, -1e4, 0.0]), **shear)
    phi, psi = np.radians(friction_deg), np.radians(dilation_deg)
    davis = np.sin(phi) * np.cos(psi) / (1 - np.sin(phi) * np.sin(psi))
    assert history[-1, XY] / 1e4 == pytest.approx(davis, rel=2e-3)


def components(matrix: np.ndarray) -> np.ndarray:
    """What `tensor` undoes."""
    return np.array([matrix[0, 0], matrix[1, 1], matrix[2, 2], matrix[0, 1], matrix[1, 2], matrix[2, 0]])


@pytest.mark.parametrize("dilation_deg", [0.0, 15.0])
def test_the_return_does_not_know_the_axes(dilation_deg: float) -> None:
    """A trial stress turned by any rotation returns to the turned result; its principal values are returned as such."""
    sand = Material(friction_deg=30.0, cohesion=1.0e4, tension_cutoff=5.0e3, dilation_deg=dilation_deg)
    principal = -np.sort(-np.random.default_rng(3).normal(-1.5e5, 1.5e5, (60, 3)), axis=1)
    principal[:6, 1] = principal[:6, 0]
    principal[6:12, 1] = principal[6:12, 2]
    principal[12:14] = principal[12:14, :1]
    turns, _ = np.linalg.qr(np.random.default_rng(11).normal(size=(60, 3, 3)))
    turns *= np.linalg.det(turns)[:, None, None]
    expected, _ = returned(sand, principal)
    for values, after, turn in zip(principal, expected, turns, strict=True):
        start = components(turn @ np.diag(values) @ turn.T)
        result = follow(sand, np.zeros((1, 3, 3)), start)[0]
        np.testing.assert_allclose(tensor(result), turn @ np.diag(after) @ turn.T, atol=2e-3 * np.abs(values).max())


def test_plane_strain_in_three_dimensions_is_the_two_dimensional_law() -> None:
    gradients = np.random.default_rng(5).normal(0.0, 2e-4, (300, 2, 2)) - 2e-5 * np.eye(2)
    deep = np.zeros((300, 3, 3))
    deep[:, :2, :2] = gradients
    for dilation_deg in (0.0, 10.0):
        sand = Material(friction_deg=35.0, cohesion=100.0, tension_cutoff=50.0, dilation_deg=dilation_deg)
        (flat, flat_strain, _), (solid, solid_strain, _) = (follow_states(sand, path) for path in (gradients, deep))
        np.testing.assert_allclose(solid[:, :4], flat, atol=1e-6 * np.abs(flat).max())
        np.testing.assert_allclose(solid[:, 4:], 0.0, atol=1e-6)
        np.testing.assert_allclose(solid_strain, flat_strain, atol=1e-9)


def invariants(stress: np.ndarray) -> np.ndarray:
    """Trace, trace of the square and determinant of stresses [S, 4 or 6] [Pa, Pa^2, Pa^3], shape [S, 3]."""
    full = tensor(stress)
    square = np.einsum("sij,sji->s", full, full)
    return np.stack([np.trace(full, axis1=1, axis2=2), square, np.linalg.det(full)], axis=1)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_thousand_turns_keep_the_invariants(dimension: int) -> None:
    """A rigid spin: invariants to 1e-9, and an angle of 2 atan(w / 2) a step (Hughes & Winget 1980)."""
    firm = Material(friction_deg=45.0, cohesion=1e9, tension_cutoff=1e9)
    axis = np.array([0.0, 0.0, 1.0]) if dimension == 2 else np.array([2.0, -1.0, 0.5]) / np.sqrt(5.25)
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    start = np.array([3e4, -1e4, 2e3, 5e3, -4e3, 1e3][: 4 if dimension == 2 else 6])
    per_turn = 40
    step = 2.0 * np.tan(np.pi / per_turn)
    spin = np.tile(step * cross[:dimension, :dimension], (1000 * per_turn, 1, 1))
    history = follow(firm, spin, start)
    expected = invariants(start[None])
    np.testing.assert_allclose(invariants(history), np.tile(expected, (len(history), 1)), rtol=1e-9)
    np.testing.assert_allclose(history[-1], start, atol=1e-7 * 3e4)
    # The angle of a step that the velocity gradient means is w: 2 atan(w / 2) = w - w^3 / 12.
    errors = []
    for steps in (50, 100):
        coarse = np.tile(np.pi / 2 / steps * cross[:dimension, :dimension], (steps, 1, 1))
        turn = np.eye(3) + cross + cross @ cross
        rotated_result = components(turn @ tensor(start) @ turn.T)[: len(start)]
        errors.append(np.abs(follow(firm, coarse, start)[-1] - rotated_result).max())
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.01)
    assert errors[1] < 2e-4 * 3e4


@pytest.mark.parametrize("dimension", [2, 3])
def test_simple_shear_is_jaumanns(dimension: int) -> None:
    """tau = G sin gamma, sigma_xx = -sigma_yy = G (1 - cos gamma) in the limit of small steps."""
    firm = Material(friction_deg=45.0, cohesion=1e9, tension_cutoff=1e9)
    errors = []
    for steps in (2000, 4000):
        path = np.zeros((steps, dimension, dimension))
        path[:, 0, 1] = 2.0 / steps
        gamma = 2.0 * np.arange(1, steps + 1) / steps
        history = follow(firm, path)
        g = firm.shear_modulus
        np.testing.assert_allclose(history[:, XX] + history[:, YY], 0.0, atol=1e-9 * g)
        miss = np.abs(history[:, XY] - g * np.sin(gamma)), np.abs(history[:, XX] - g * (1 - np.cos(gamma)))
        errors.append(max(miss[0].max(), miss[1].max()) / g)
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.02)
    assert errors[1] < 5e-4


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
    turned = axes.T @ tensor(history)[:, :2, :2] @ axes
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


stiff = partial(Material, young=1.0e9)
CLAY = stiff(friction_deg=0.0, cohesion=2.0e4, tension_cutoff=1.0e9, residual_cohesion=5.0e3, softening_length=0.02)


def sheared(slip: float, cell: float, steps: int, dimension: int = 2) -> np.ndarray:
    """Displacement-gradient increments [steps, D, D] of a band `cell` thick whose sides slip by `slip` [m]."""
    path = np.zeros((steps, dimension, dimension))
    path[:, 0, 1] = slip / cell / steps
    return path


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
    soft = 5.0e3 + 1.5e4 * np.maximum(0.0, 1.0 - np.append(0.0, gamma[:-1]) * cell / 0.02)
    yielding = np.diff(gamma, prepend=0.0) > 0.0
    np.testing.assert_allclose(tau[yielding], soft[yielding], rtol=1e-6)


def test_friction_and_cohesion_soften_linearly_in_shear() -> None:
    """psi = 0: the radius of Mohr's circle is c cos phi + p sin phi, whose two parts are interpolated in the slip."""
    soil = stiff(
        friction_deg=35.0, cohesion=1.0e4, residual_friction_deg=25.0, residual_cohesion=0.0, softening_length=0.03
    )
    history, strain, _ = follow_states(soil, sheared(0.05, 0.2, 3000), np.array([-1e5, -1e5, -1e5, 0.0]), cell=0.2)
    slip = np.sqrt(3.0) * strain * 0.2
    before = np.append(0.0, slip[:-1])
    w = np.maximum(0.0, 1.0 - before / 0.03)
    radius = np.hypot(history[:, XY], 0.5 * (history[:, XX] - history[:, YY]))
    centre = -0.5 * (history[:, XX] + history[:, YY])
    peak, residual = np.sin(np.radians(35.0)), np.sin(np.radians(25.0))
    expected = (residual + w * (peak - residual)) * centre + w * 1.0e4 * np.cos(np.radians(35.0))
    yielding = (slip > before) & (np.abs(history[:, ZZ] + centre) < 0.5 * radius)
    assert yielding.sum() > 1000
    np.testing.assert_allclose(radius[yielding], expected[yielding], rtol=1e-6)


def test_dilation_ends_at_the_critical_state() -> None:
    """A dense sand sheared at constant volume presses outwards until the softening length is used up, then no more."""
    dense = Material(friction_deg=42.0, dilation_deg=12.0, residual_friction_deg=33.0, softening_length=0.01, young=1e7)
    start, path = np.array([-1e5, -1e5, -1e5, 0.0]), sheared(0.03, 0.1, 6000)
    history, strain, _ = follow_states(dense, path, start, cell=0.1)
    mean, slip = -history[:, :3].mean(axis=1), np.sqrt(3.0) * strain * 0.1
    used = slip > 0.01
    assert mean[used][0] > 1.5e5
    np.testing.assert_allclose(mean[used], mean[used][0], rtol=2e-3)
    endless = follow(dataclasses.replace(dense, softening_length=None, residual_friction_deg=None), path, start)
    assert -endless[-1, :3].mean() > 2.0 * mean[-1]


def test_the_apex_limits_the_cutoff_on_the_way() -> None:
    """Where phi falls and c stays, c cot phi rises, but more slowly at first than the line between its ends."""
    soil = stiff(friction_deg=40.0, residual_friction_deg=10.0, cohesion=1e4, tension_cutoff=1e6, softening_length=0.1)
    path = np.concatenate([sheared(0.05, 1.0, 500, 3), np.tile(1e-5 * np.eye(3), (300, 1, 1))])
    history, strain, _ = follow_states(soil, path)
    w = 1.0 - np.sqrt(3.0) * strain[-1] / 0.1
    assert 0.2 < w < 0.8
    peak, residual = np.radians(40.0), np.radians(10.0)
    sine = w * np.sin(peak) + (1 - w) * np.sin(residual)
    apex = 1.0e4 * (w * np.cos(peak) + (1 - w) * np.cos(residual)) / sine
    assert apex < 0.9 * (w / np.tan(peak) + (1 - w) / np.tan(residual)) * 1.0e4
    np.testing.assert_allclose(history[-1], [apex, apex, apex, 0.0, 0.0, 0.0], rtol=1e-6, atol=1e-6 * apex)


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
    peak = {"cohesion": 5.0e3, "strength_gradient": 2.0e3, "tension_cutoff": 2.0e4}
    soil = Material(friction_deg=20.0, **peak, residual_cohesion=1.0e3, softening_length=0.1)
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
