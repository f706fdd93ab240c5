"""The rows: their scenes are what they say; each expectation passes what it should and finds what differs from it."""

import dataclasses
import inspect
import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from datasets.material import Material
from datasets.particles import initial_particles
from datasets.scene import Domain, Mass, Scene
from datasets.trajectory import Trajectory
from mpm import exact_solutions
from tests.validation.bench.sand_at_rest import BAFFLE, BED, at_rest, scene_of
from validation.bench.stability import expectations as expect
from validation.bench.stability.deposit import MIN_CUBES, core_volumes
from validation.bench.stability.invariants import INVARIANTS
from validation.bench.stability.rows import ROWS, SCENES, Row

SCENE = {row.name: row.scene for row in ROWS}
WITH_BAFFLE = scene_of(baffles=(BAFFLE,))
COLUMN = scene_of(Mass(lower=(0.0, 0.0), size=(0.1, 0.4)), domain=Domain(size=(2.0, 0.5), cell=0.02))
SOFT = scene_of(material=Material(friction_deg=30.0, young=2.0e4))
SETTLED = exact_solutions.settlement(SOFT)
CUBE = scene_of(Mass(lower=(0.1, 0.0, 0.1), size=(0.1, 0.1, 0.1)), domain=Domain(size=(0.4, 0.2, 0.4), cell=0.02))
FALLING = scene_of(Mass(lower=(0.0, 0.6), size=(0.4, 0.2)), domain=Domain(size=(0.4, 0.8), cell=0.02))


def moved(flow: Trajectory, way: Any, velocities: np.ndarray | None = None) -> Trajectory:
    """The flow with `way` [m] added to its positions, shape that of [T, N, D] or such as fills it."""
    positions = (flow.positions + np.asarray(way)).astype(np.float32)
    velocities = flow.velocities if velocities is None else velocities.astype(np.float32)
    return dataclasses.replace(flow, positions=positions, velocities=velocities)


def later(scene: Scene, *way: float) -> Trajectory:
    """All particles displaced by `way` [m] from the second frame on."""
    flow = at_rest(scene)
    return moved(flow, np.where(np.arange(len(flow.time))[:, None, None] > 0, way, 0.0))


def with_summary(flow: Trajectory, **changes: object) -> Trajectory:
    """The flow with other entries of its summary."""
    return dataclasses.replace(flow, summary=flow.summary | changes)


def test_every_scene_file_is_a_row_and_every_row_has_one() -> None:
    assert sorted(SCENE) == sorted(path.stem for path in SCENES.glob("*.toml"))
    assert len(SCENE) == len(ROWS)
    for row in ROWS:
        assert bool(row.beside) == bool(row.comparisons)
        assert not row.beside or row.beside in SCENE


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_a_row_starts_as_it_should(row: Row) -> None:
    """Sand that stays where a scene puts it passes all that a flow keeps: mass, place, sizes of arrays."""
    flow = at_rest(row.scene)
    assert all(finding.ok for check in INVARIANTS if (finding := check(flow)) is not None)
    assert len(flow.positions[0]) <= 10_000
    if flow.scene.dimension == 2 and not row.name.startswith("far-"):
        assert 0.01 <= flow.scene.domain.cell <= 0.02


def test_the_scenes_are_what_their_rows_say() -> None:
    assert SCENE["friction-12"].material.friction_deg == 12.0
    assert SCENE["friction-48"].material.friction_deg == 48.0
    for name in ("impact-wall", "impact-baffle", "impact-baffle-3d"):
        velocity = SCENE[name].masses[0].velocity
        assert velocity is not None
        assert velocity[0] == 10.0
    width, height = SCENE["tall-column"].masses[0].size
    assert height == pytest.approx(8.0 * width)
    assert len(np.unique(initial_particles(dataclasses.replace(SCENE["thin-layer"], jitter=0.0)).positions[:, 1])) == 3
    assert SCENE["rest"].duration >= 12.0
    assert SCENE["long-step"] == dataclasses.replace(SCENE["column"], step_fraction=0.9)
    filled = SCENE["filled-domain"]
    assert filled.masses[0].size == filled.domain.size
    assert len(initial_particles(SCENE["one-point"]).positions) == 1
    for name in ("layers-settle", "layers-collapse"):
        soft, stiff = (SCENE[name].material_of(mass) for mass in SCENE[name].masses)
        assert stiff.young == 100.0 * soft.young
    for name in ("impact-baffle", "thin-layer", "impact-baffle-3d"):
        baffle, cell = SCENE[name].baffles[0], SCENE[name].domain.cell
        faces = [baffle.lower[0], baffle.lower[0] + baffle.size[0], baffle.lower[1] + baffle.size[1]]
        off_grid = [abs(face / cell - round(face / cell)) for face in faces if face > 0.0]
        assert min(off_grid) > 0.1, "faces between the nodes of the grid"


@pytest.mark.parametrize("name", ["dropped-bed", "slope-holds-3d"])
def test_a_row_that_asks_for_volume_has_a_core(name: str) -> None:
    flow = at_rest(SCENE[name])
    fallen = moved(flow, np.array([0.0, -flow.positions[:, :, 1].min() + 0.005, 0.0][: flow.scene.dimension]))
    assert core_volumes(fallen)[1].sum() >= MIN_CUBES


def test_the_cuts_are_at_their_fractions_of_the_critical_height() -> None:
    for name, ratio in (
        ("cut-holds", 0.6),
        ("cut-fails", 1.6),
        ("cut-critical-holds", 0.9),
        ("cut-critical-fails", 1.1),
        ("undrained-cut-holds", 0.8),
        ("undrained-cut-fails", 1.2),
    ):
        assert expect.over_critical_height(at_rest(SCENE[name]), ratio=ratio).ok
        assert not expect.over_critical_height(at_rest(SCENE[name]), ratio=1.0).ok


def test_critical_height_by_hand() -> None:
    """c = 1 kPa, gamma = 17.658 kN/m^3, phi = 30: 4 / 17.658 * tan 60 = 0.3924 m, half of that without tension."""
    soil = Material(friction_deg=30.0, cohesion=1000.0, tension_cutoff=1e6)
    found = expect.over_critical_height(at_rest(scene_of(material=soil)), ratio=1.0)
    assert found.value == pytest.approx(0.2 / 0.39236, rel=1e-4)
    cracked = dataclasses.replace(soil, tension_cutoff=0.0)
    assert exact_solutions.critical_height(scene_of(material=cracked)) == pytest.approx(0.39236 / 2.0, rel=1e-4)
    for little in (None, 99.0):
        default = dataclasses.replace(soil, tension_cutoff=little)
        assert exact_solutions.critical_height(scene_of(material=default)) == exact_solutions.critical_height(
            scene_of(material=cracked)
        )
    clay = dataclasses.replace(cracked, friction_deg=0.0)
    assert exact_solutions.critical_height(scene_of(material=clay)) == pytest.approx(2000.0 / 17658.0)


@pytest.mark.parametrize(
    ("check", "scene", "way", "ok"),
    [
        (expect.spreads, scene_of(), (0.0, 0.0), False),
        (expect.spreads, scene_of(), (0.18, 0.0), True),
        (expect.runs_out, scene_of(), (0.0, 0.0), False),
        (expect.runs_out, scene_of(), (0.05, 0.0), True),
        (partial(expect.creeps, since=0.2, cells=0.05), scene_of(), (0.1, 0.0), True),
        (partial(expect.creeps, since=0.0, cells=0.05), scene_of(), (0.002, 0.0), False),
        (lambda flow: expect.as_far_as(flow, at_rest(), within=0.05), scene_of(), (0.0, 0.0), True),
        (lambda flow: expect.as_far_as(flow, at_rest(), within=0.05), scene_of(), (0.03, 0.0), False),
        (expect.runout_of_collapse, COLUMN, (0.35, 0.0), False),
        (expect.runout_of_collapse, COLUMN, (0.7, 0.0), True),
        (expect.runout_of_collapse, COLUMN, (1.1, 0.0), False),
        (expect.lands, FALLING, (0.0, 0.0), False),
        (expect.lands, FALLING, (0.0, -0.79), True),
        (expect.passes_baffle, WITH_BAFFLE, (0.0, 0.0), False),
        (expect.passes_baffle, WITH_BAFFLE, (0.7, 0.0), True),
        (expect.stands, scene_of(), (0.0, -0.0005), True),
        (expect.stands, scene_of(), (0.0, -0.002), False),
        (expect.stands_as_before, scene_of(), (0.0, 0.004), True),
        (expect.stands_as_before, scene_of(), (0.0, 0.01), False),
        (expect.stands_as_before, scene_of(), (0.0, -0.01), False),
        (expect.settles, SOFT, (0.0, -SETTLED), True),
        (expect.settles, SOFT, (0.0, -1.5 * SETTLED), False),
        (expect.settles_at_most_twice, SOFT, (0.0, -1.5 * SETTLED), True),
        (expect.settles_at_most_twice, SOFT, (0.0, -2.2 * SETTLED), False),
        *(
            (check, CUBE, (0.0, 0.0, shift), shift == 0.0)
            for check in (expect.is_round, expect.stays_centred, expect.is_symmetric)
            for shift in (0.0, 0.03)
        ),
    ],
)
def test_a_displacement_passes_within_its_range_only(
    check: Callable[[Trajectory], Any], scene: Scene, way: tuple[float, ...], ok: bool
) -> None:
    assert check(later(scene, *way)).ok is ok


@pytest.mark.parametrize(
    ("check", "scene", "motion", "shares"),
    [
        # a = g (sin - mu cos): 0.466 m/s^2 at 29 degrees, 1.609 at 35, mu = 0.5.
        (expect.slides, SCENE["block-29"], lambda t: (0.2331 * t**2, 0.0 * t), {1.0: True, 0.98: False, 1.02: False}),
        (expect.slides, SCENE["block-35"], lambda t: (0.8045 * t**2, 0.0 * t), {1.0: True, 0.98: False, 1.02: False}),
        (expect.moves_on, SCENE["far-slow"], lambda t: (0.01 * t, -0.01 * t), {1.0: True, 0.98: False, 0.0: False}),
        # A thousand steps of 0.4 ms: positions after a step hold the velocity at its end.
        (expect.falls_freely, FALLING, lambda t: (0.0 * t, -4.905 * t * (t + 0.0004)), {1.0: True, 0.989: False}),
    ],
)
def test_a_motion_is_compared_with_the_exact_one(
    check: Callable[[Trajectory], Any],
    scene: Scene,
    motion: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    shares: dict[float, bool],
) -> None:
    flow = at_rest(scene)
    way = np.stack(motion(flow.time), axis=1)[:, None]
    assert {share: check(moved(flow, share * way)).ok for share in shares} == shares


def test_spread_by_hand() -> None:
    """0.4 x 0.2 m at 30 degrees: 0.4 + 0.2 / (2 tan 30) = 0.573 m; a high one comes to sqrt(2 A / tan)."""
    assert expect.spreads(at_rest()).minimum == pytest.approx(0.4 + 0.1 * math.sqrt(3.0))
    assert expect.spreads(at_rest(COLUMN)).minimum == pytest.approx(math.sqrt(0.08 * math.sqrt(3.0)))


@pytest.mark.parametrize(("share", "ok"), [(1.0, True), (0.95, True), (0.85, False), (1.01, False)])
def test_what_is_thrown_up_has_to_rise(share: float, ok: bool) -> None:
    """The upper of two beds thrown up at 4 m/s makes a share of its free flight."""
    flow = at_rest(scene_of(BED, Mass(lower=(0.0, 0.2), size=(0.4, 0.2), velocity=(0.0, 4.0))))
    way = np.zeros_like(flow.positions)
    way[:, flow.positions[0, :, 1] > 0.2, 1] = share * (4.0 * flow.time - 0.5 * 9.81 * flow.time**2)[:, None]
    assert expect.parts_freely(moved(flow, way)).ok is ok


def test_tension_in_sand_is_found() -> None:
    flow = at_rest()
    assert expect.never_pulls(flow).ok
    assert flow.pressure is not None
    pressure = flow.pressure.copy()
    pressure[1, 3] = -1.0
    assert not expect.never_pulls(dataclasses.replace(flow, pressure=pressure)).ok


@pytest.mark.parametrize(("share", "ok"), [(0.4, False), (0.9, False), (1.2, True), (2.1, False)])
def test_a_wall_and_a_baffle_stop_what_is_thrown_at_them(share: float, ok: bool) -> None:
    """3 m/s in the first frame, at rest from the second: between once and twice its momentum goes to a wall."""
    flow = at_rest(scene_of(dataclasses.replace(BED, velocity=(3.0, 0.0)), baffles=(BAFFLE,)))
    velocities = np.zeros_like(flow.positions)
    velocities[0] = 3.0, 0.0
    impulse = np.zeros((len(flow.time), 1, 2))
    impulse[2:, 0, 0] = share * 3.0 * 1800.0 * 0.08
    on_baffle = dataclasses.replace(moved(flow, 0.0, velocities), solid_impulse=impulse)
    assert expect.baffle_stops(on_baffle, minimum=0.5).ok is (0.5 < share < 2.0)
    on_wall = with_summary(on_baffle, wall_impulse=impulse[:, 0].tolist())
    assert expect.wall_stops(on_wall).value == pytest.approx(share)
    assert expect.wall_stops(on_wall).ok is ok


@pytest.mark.parametrize(("kept", "ok"), [(1.0, True), (0.95, False), (1.01, False)])
def test_a_layer_keeps_its_speed_until_it_lands(kept: float, ok: bool) -> None:
    flow = at_rest(scene_of(Mass(lower=(0.0, 0.2), size=(0.4, 0.06), velocity=(2.0, 0.0))))
    fall = np.zeros_like(flow.positions)
    fall[3:, :, 1] = -0.19
    velocities = np.zeros_like(flow.positions)
    velocities[:, :, 0] = np.array([2.0, 2.0, 2.0 * kept, 0.5, 0.0])[:, None]
    assert expect.keeps_speed(moved(flow, fall, velocities)).ok is ok


def test_creep_counts_from_its_start_and_in_cells() -> None:
    flow = at_rest()
    way = np.zeros_like(flow.positions)
    way[1:, 5, 0] = 0.1
    way[-1, 5, 0] += 0.002
    found = expect.creeps(moved(flow, way), since=0.2, cells=0.05)
    assert found.value == pytest.approx(0.1, rel=1e-3)


def test_settlement_by_hand() -> None:
    """One layer: rho g H^2 / (2 M); soft under stiff adds (rho g h) h / M below."""
    one = scene_of()
    modulus = one.material.lame + 2.0 * one.material.shear_modulus
    assert exact_solutions.settlement(one) == pytest.approx(1800.0 * 9.81 * 0.2**2 / (2.0 * modulus))
    stiff = dataclasses.replace(one.material, young=2.0e8)
    two = scene_of(BED, Mass(lower=(0.0, 0.2), size=(0.4, 0.2), material=stiff))
    below = 1800.0 * 9.81 * 0.2**2 * 1.5 / modulus
    assert exact_solutions.settlement(two) == pytest.approx(below + 0.01 * exact_solutions.settlement(one))


def test_a_step_that_is_not_used_is_found() -> None:
    flow = at_rest()
    used = flow.scene.duration * flow.scene.material.wave_speed / flow.scene.domain.cell
    for fraction, ok in ((0.89, True), (0.4, False), (0.95, False)):
        assert expect.step_used(with_summary(flow, steps=math.ceil(used / fraction))).ok is ok


def test_particles_apart_in_the_two_precisions_are_found() -> None:
    flow = at_rest()
    way = np.zeros_like(flow.positions)
    way[1, 7, 0] = 0.003
    assert expect.every_particle_agrees(flow, flow).ok
    assert not expect.every_particle_agrees(moved(flow, way), flow).ok


def test_every_expectation_is_of_a_row() -> None:
    """What no row has is not checked."""
    checks = [check for row in ROWS for check in (*row.checks, *row.precisions, *row.comparisons)]
    used = {getattr(check, "func", check).__name__ for check in checks}
    made = {
        name
        for name, value in vars(expect).items()
        if inspect.isfunction(value) and value.__module__ == expect.__name__ and "flow" in str(inspect.signature(value))
    }
    measured = {"moved_share", "surface_settlement", "mass_height", "rest_time", "share_of_throw", "in_cells"}
    assert made - measured <= used


@pytest.mark.parametrize(("share", "ok"), [(1.0, True), (0.99, False)])
def test_a_spin_keeps_its_angular_momentum_and_energy(share: float, ok: bool) -> None:
    mass = Mass(lower=(0.2, 0.1), size=(0.2, 0.2), angular_velocity=3.0)
    flow = at_rest(scene_of(mass, gravity=0.0))
    arm = flow.positions[0] - np.array([0.3, 0.2])
    omega = np.where(np.arange(len(flow.time)) > 2, share, 1.0)[:, None, None] * 3.0
    flow = moved(flow, np.zeros(2), omega * np.stack([-arm[:, 1], arm[:, 0]], axis=1))
    assert expect.keeps_angular_momentum(flow).ok is ok
    energy = flow.summary["energy"] | {"kinetic": [1.0, 1.0, 1.0, 1.0, 1.0 if ok else 0.98]}
    assert expect.spins_on(with_summary(flow, energy=energy)).ok is ok


@pytest.mark.parametrize("decay", [0.0, 0.02])
def test_the_decrement_of_a_bar_is_measured(decay: float) -> None:
    """u = A e^(-d t / T) sin(w t) cos(pi x / L) has the decrement d per period T, of L = 0.8 m and c = 33.3 m/s."""
    flow = at_rest(SCENE["bar-mode"])
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
    flow = at_rest(SCENE["layer-mode"])
    omega = 0.5 * math.pi / 0.4 * flow.scene.material.wave_speed
    shape = np.sin(0.5 * math.pi * flow.positions[0, :, 1] / 0.4)
    way, velocities = np.zeros((*flow.positions.shape,)), np.zeros((*flow.positions.shape,))
    way[..., 1] = 1.0e-3 * np.sin(omega * flow.time)[:, None] * shape
    velocities[..., 1] = 1.0e-3 * omega * np.cos(omega * flow.time)[:, None] * shape
    assert expect.layer_decrement(moved(flow, way, velocities), maximum=0.03).value == pytest.approx(0.0, abs=3e-4)


def test_a_layer_that_rings_stays_in_compression() -> None:
    """Its stress M u' = M (v / omega) (pi / 2H) cos(pi y / 2H) is less than rho g (H - y) below the topmost cell."""
    scene = SCENE["layer-mode"]
    velocity = scene.masses[-1].velocity
    assert velocity is not None
    omega = 0.5 * math.pi / 0.4 * scene.material.wave_speed
    y = np.linspace(0.0, 0.4 - scene.domain.cell, 50)
    modulus = scene.material.density * scene.material.wave_speed**2
    wave = modulus * velocity[1] / omega * (0.5 * math.pi / 0.4) * np.cos(0.5 * math.pi * y / 0.4)
    assert np.all(wave < scene.material.density * scene.gravity * (0.4 - y))


def test_a_bed_in_geostatic_stress() -> None:
    """At rest under its weight, K0 = 0.5, and under a fiftieth more."""
    flow = at_rest(SCENE["bed-k0"])
    weight = 2.0 / 3.0 * 1800.0 * 9.81 * (0.4 - flow.positions[..., 1])
    for factor, ok in ((1.0, True), (1.02, False)):
        loaded = dataclasses.replace(flow, pressure=(factor * weight).astype(np.float32))
        assert expect.weighs_what_lies_above(loaded).ok is ok
    assert expect.stays_at_rest(flow).ok
    assert not expect.stays_at_rest(moved(flow, 0.0, np.full_like(flow.positions, 1.0e-5))).ok


@pytest.mark.parametrize(("time", "ok"), [(0.2, False), (1.0, True), (None, False)])
def test_thrown_sand_rests_after_it_has_landed(time: float | None, ok: bool) -> None:
    """2 m/s from 0.02 m: it lands after 0.4175 s."""
    flow = at_rest(SCENE["thrown-rest"])
    found = expect.rests_after_landing(with_summary(flow, rest_time=time))
    assert found.ok is ok
    assert found.maximum == pytest.approx(3.0 / 0.4175, rel=1e-3)


@pytest.mark.parametrize(("share", "ok"), [(1.0, True), (2.0, False), (0.0, False)])
def test_a_bed_rests_settled(share: float, ok: bool) -> None:
    scene = SCENE["bed-ringing"]
    modulus = scene.material.lame + 2.0 * scene.material.shear_modulus
    flow = later(scene, 0.0, -share * 1800.0 * 9.81 * 0.16 / (2.0 * modulus))
    assert expect.rests_settled(with_summary(flow, rest_time=1.0)).ok is ok
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
