"""Expectations that are exact solutions pass the exact motion and find what differs from it."""

import dataclasses
import math

import numpy as np
import pytest

from datasets.material import Material
from datasets.scene import Mass, Scene
from datasets.trajectory import Trajectory
from mpm import exact_solutions
from tests.validation.bench.sand_at_rest import at_rest, scene_of
from validation.bench.stability import critical_height
from validation.bench.stability import expectations as expect
from validation.bench.stability.rows import EXACT

BY_NAME = {row.name: row for row in EXACT}
FREE = {"gravity": 0.0}


def moved(flow: Trajectory, way: np.ndarray, velocities: np.ndarray | None = None) -> Trajectory:
    """The flow with `way` [m] added to its places, shape that of [T, N, D] or such as fills it."""
    positions = (flow.positions + way).astype(np.float32)
    velocities = flow.velocities if velocities is None else velocities.astype(np.float32)
    return dataclasses.replace(flow, positions=positions, velocities=velocities)


@pytest.mark.parametrize(("share", "ok"), [(1.0, True), (0.98, False), (1.02, False)])
@pytest.mark.parametrize("name", ["block-29", "block-35"])
def test_a_block_slides_as_a_rigid_one(name: str, share: float, ok: bool) -> None:
    """a = g (sin - mu cos): 0.466 m/s^2 at 29 degrees, 1.609 at 35, mu = 0.5."""
    flow = at_rest(BY_NAME[name].scene)
    acceleration = {"block-29": 0.4661, "block-35": 1.6089}[name]
    way = np.zeros((len(flow.time), 1, 2))
    way[:, 0, 0] = share * 0.5 * acceleration * flow.time**2
    assert expect.slides(moved(flow, way)).ok is ok


@pytest.mark.parametrize(("share", "ok"), [(1.0, True), (0.98, False), (0.0, False)])
def test_a_body_without_force_moves_on(share: float, ok: bool) -> None:
    flow = at_rest(BY_NAME["far-slow"].scene)
    way = share * flow.time[:, None, None] * np.array([0.01, -0.01])
    assert expect.moves_on(moved(flow, way)).ok is ok


@pytest.mark.parametrize(("share", "ok"), [(1.0, True), (0.99, False)])
def test_a_spin_keeps_its_angular_momentum_and_energy(share: float, ok: bool) -> None:
    mass = Mass(lower=(0.2, 0.1), size=(0.2, 0.2), angular_velocity=3.0)
    flow = at_rest(scene_of(mass, **FREE))
    arm = flow.positions[0] - np.array([0.3, 0.2])
    omega = np.where(np.arange(len(flow.time)) > 2, share, 1.0)[:, None, None] * 3.0
    flow = moved(flow, np.zeros(2), omega * np.stack([-arm[:, 1], arm[:, 0]], axis=1))
    assert expect.keeps_angular_momentum(flow).ok is ok
    energy = flow.summary["energy"] | {"kinetic": [1.0, 1.0, 1.0, 1.0, 1.0 if ok else 0.98]}
    assert expect.spins_on(dataclasses.replace(flow, summary=flow.summary | {"energy": energy})).ok is ok


@pytest.mark.parametrize("decay", [0.0, 0.02])
def test_the_decrement_of_a_bar_is_measured(decay: float) -> None:
    """u = A e^(-d t / T) sin(w t) cos(pi x / L) has the decrement d per period T, of L = 0.8 m and c = 33.3 m/s."""
    flow = at_rest(BY_NAME["bar-mode"].scene)
    omega = math.pi / 0.8 * math.sqrt(2.0e6 / 1800.0)
    rate = decay * omega / (2.0 * math.pi)
    shape = np.cos(math.pi * (flow.positions[0, :, 0] - 0.1) / 0.8)
    swing = 1.0e-3 * np.exp(-rate * flow.time)
    way = np.zeros((*flow.positions.shape,))
    way[..., 0] = (swing * np.sin(omega * flow.time))[:, None] * shape
    velocities = np.zeros_like(way)
    speed = swing * (omega * np.cos(omega * flow.time) - rate * np.sin(omega * flow.time))
    velocities[..., 0] = speed[:, None] * shape
    found = expect.bar_decrement(moved(flow, way, velocities), maximum=1.0e-3)
    assert found.value == pytest.approx(decay, abs=3e-4)
    assert found.ok is (decay == 0.0)


def test_the_decrement_of_a_layer_is_measured() -> None:
    flow = at_rest(BY_NAME["layer-mode"].scene)
    omega = 0.5 * math.pi / 0.4 * flow.scene.material.wave_speed
    shape = np.sin(0.5 * math.pi * flow.positions[0, :, 1] / 0.4)
    way, velocities = np.zeros((*flow.positions.shape,)), np.zeros((*flow.positions.shape,))
    way[..., 1] = 1.0e-3 * np.sin(omega * flow.time)[:, None] * shape
    velocities[..., 1] = 1.0e-3 * omega * np.cos(omega * flow.time)[:, None] * shape
    assert expect.layer_decrement(moved(flow, way, velocities), maximum=0.03).value == pytest.approx(0.0, abs=3e-4)


def test_a_layer_that_rings_stays_in_compression() -> None:
    """Its stress M u' = M (v / omega) (pi / 2H) cos(pi y / 2H) is less than rho g (H - y) below the topmost cell."""
    scene = BY_NAME["layer-mode"].scene
    velocity = scene.masses[-1].velocity
    assert velocity is not None
    omega = 0.5 * math.pi / 0.4 * scene.material.wave_speed
    y = np.linspace(0.0, 0.4 - scene.domain.cell, 50)
    modulus = scene.material.density * scene.material.wave_speed**2
    wave = modulus * velocity[1] / omega * (0.5 * math.pi / 0.4) * np.cos(0.5 * math.pi * y / 0.4)
    assert np.all(wave < scene.material.density * scene.gravity * (0.4 - y))


def geostatic(scene: Scene, factor: float = 1.0) -> Trajectory:
    """A bed at rest under `factor` times its weight, K0 = 0.5."""
    flow = at_rest(scene)
    pressure = factor * 2.0 / 3.0 * 1800.0 * 9.81 * (0.4 - flow.positions[..., 1])
    return dataclasses.replace(flow, pressure=pressure.astype(np.float32))


def test_a_bed_in_geostatic_stress() -> None:
    scene = BY_NAME["bed-k0"].scene
    assert expect.weighs_what_lies_above(geostatic(scene)).ok
    assert not expect.weighs_what_lies_above(geostatic(scene, 1.02)).ok
    flow = geostatic(scene)
    assert expect.stays_at_rest(flow).ok
    assert flow.velocities is not None
    assert not expect.stays_at_rest(dataclasses.replace(flow, velocities=flow.velocities + np.float32(1.0e-5))).ok


@pytest.mark.parametrize(("lost", "ok"), [(0.0, True), (0.0005, True), (0.002, False)])
def test_a_column_that_stands(lost: float, ok: bool) -> None:
    flow = at_rest()
    way = np.zeros((len(flow.time), 1, 2))
    way[1:, 0, 1] = -lost
    assert expect.stands(moved(flow, way)).ok is ok


@pytest.mark.parametrize(("time", "ok"), [(0.2, False), (1.0, True), (None, False)])
def test_thrown_sand_rests_after_it_has_landed(time: float | None, ok: bool) -> None:
    """2 m/s from 0.02 m: it lands after 0.4175 s."""
    flow = at_rest(BY_NAME["thrown-rest"].scene)
    found = expect.rests_after_landing(dataclasses.replace(flow, summary=flow.summary | {"rest_time": time}))
    assert found.ok is ok
    assert found.maximum == pytest.approx(3.0 / 0.4175, rel=1e-3)


@pytest.mark.parametrize(("share", "ok"), [(1.0, True), (2.0, False), (0.0, False)])
def test_a_bed_rests_settled(share: float, ok: bool) -> None:
    flow = at_rest(BY_NAME["bed-ringing"].scene)
    material = flow.scene.material
    settled = 1800.0 * 9.81 * 0.16 / (2.0 * (material.lame + 2.0 * material.shear_modulus))
    way = np.zeros((len(flow.time), 1, 2))
    way[1:, 0, 1] = -share * settled
    flow = moved(flow, way)
    assert expect.rests_settled(dataclasses.replace(flow, summary=flow.summary | {"rest_time": 1.0})).ok is ok
    assert not expect.rests_settled(flow).ok


def test_a_cut_stands_or_falls() -> None:
    flow = at_rest()
    some = np.zeros((*flow.positions.shape,))
    some[-1, : len(some[0]) // 50] = 0.03
    assert expect.stands_but_for_spall(moved(flow, some)).ok
    assert not expect.falls(moved(flow, some)).ok
    some[-1, : len(some[0]) // 10] = 0.03
    assert not expect.stands_but_for_spall(moved(flow, some)).ok
    assert expect.falls(moved(flow, some)).ok


CUT = scene_of(Mass(lower=(0.0, 0.0), size=(0.4, 0.2)), material=Material(friction_deg=30.0, cohesion=1000.0))


@pytest.mark.parametrize("ratio", [0.5, 1.0, 1.3])
def test_a_cut_at_a_ratio(ratio: float) -> None:
    assert 0.2 / exact_solutions.critical_height(critical_height.at_ratio(CUT, ratio)) == pytest.approx(ratio)


@pytest.mark.parametrize("critical", [0.6, 0.95, 1.2])
def test_bisection_finds_what_fails(critical: float) -> None:
    found = critical_height.bracket(CUT, lambda scene: 0.2 / exact_solutions.critical_height(scene) > critical)
    assert found.holds <= critical <= found.fails <= critical_height.WITHIN * found.holds


@pytest.mark.parametrize(("friction_deg", "raised"), [(0.0, 0.0548), (30.0, 0.0720)])
def test_little_tension_raises_the_critical_height(friction_deg: float, raised: float) -> None:
    """The least over the width b of gamma H = 2 c t + gamma b t / 2 + T t (H / b - t)."""
    t = math.tan(math.radians(45.0 + 0.5 * friction_deg))
    found = exact_solutions.stability_number(friction_deg, 0.003)
    assert found == pytest.approx(2.0 * t * (1.0 + raised), rel=1e-4)
    widths = np.linspace(0.01, 0.2, 2000) * found
    slices = (2.0 * t + 0.5 * widths * t - 0.003 * t**2) / (1.0 - 0.003 * t / widths)
    assert found == pytest.approx(slices.min(), rel=1e-6)
    assert exact_solutions.stability_number(friction_deg, 0.0) == pytest.approx(2.0 * t)
    assert critical_height.bracket(CUT, lambda scene: True).tension == pytest.approx(0.003)


def test_bisection_says_where_there_is_nothing_to_find() -> None:
    assert math.isnan(critical_height.bracket(CUT, lambda scene: True).holds)
    assert math.isnan(critical_height.bracket(CUT, lambda scene: False).fails)
