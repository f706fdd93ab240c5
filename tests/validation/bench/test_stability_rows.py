"""The rows: their scenes are what they say, and what single rows expect fails where it should."""

import dataclasses
import inspect
import math
from functools import partial

import numpy as np
import pytest

from datasets.material import Material
from datasets.particles import initial_particles
from datasets.scene import Baffle, Domain, Mass
from datasets.trajectory import Trajectory
from mpm import exact_solutions
from tests.validation.bench.sand_at_rest import BED, at_rest, scene_of
from validation.bench.stability import expectations as expect
from validation.bench.stability.deposit import MIN_CUBES, core_volumes
from validation.bench.stability.invariants import INVARIANTS
from validation.bench.stability.rows import ROWS, SCENES

BY_NAME = {row.name: row for row in ROWS}


def lifted(flow: Trajectory, change: np.ndarray) -> Trajectory:
    """The flow with `change` [m] added to its places, shape that of [T, N, D] or such as fills it."""
    return dataclasses.replace(flow, positions=(flow.positions + change).astype(np.float32))


def test_every_scene_file_is_a_row_and_every_row_has_one() -> None:
    assert sorted(BY_NAME) == sorted(path.stem for path in SCENES.glob("*.toml"))
    assert len(BY_NAME) == len(ROWS)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_a_row_starts_as_it_should(row: object) -> None:
    """Sand that stays where a scene puts it passes all that a flow keeps: mass, place, sizes of arrays."""
    flow = at_rest(row.scene)  # type: ignore[attr-defined]
    assert all(finding.ok for check in INVARIANTS if (finding := check(flow)) is not None)
    assert len(flow.positions[0]) <= 10_000
    if flow.scene.dimension == 2 and not row.name.startswith("far-"):  # type: ignore[attr-defined]
        assert 0.01 <= flow.scene.domain.cell <= 0.02


def test_rows_are_compared_with_rows() -> None:
    for row in ROWS:
        assert bool(row.beside) == bool(row.comparisons)
        assert not row.beside or row.beside in BY_NAME


def test_the_scenes_are_what_their_rows_say() -> None:
    scene = {name: row.scene for name, row in BY_NAME.items()}
    assert scene["friction-12"].material.friction_deg == 12.0
    assert scene["friction-48"].material.friction_deg == 48.0
    for name in ("impact-wall", "impact-baffle", "impact-baffle-3d"):
        velocity = scene[name].masses[0].velocity
        assert velocity is not None
        assert velocity[0] == 10.0
    width, height = scene["tall-column"].masses[0].size
    assert height == pytest.approx(8.0 * width)
    assert len(np.unique(initial_particles(dataclasses.replace(scene["thin-layer"], jitter=0.0)).positions[:, 1])) == 3
    assert scene["rest"].duration >= 12.0
    assert scene["long-step"] == dataclasses.replace(scene["column"], step_fraction=0.9)
    filled = scene["filled-domain"]
    assert filled.masses[0].size == filled.domain.size
    assert len(initial_particles(scene["one-point"]).positions) == 1
    for name in ("layers-settle", "layers-collapse"):
        soft, stiff = (scene[name].material_of(mass) for mass in scene[name].masses)
        assert stiff.young == 100.0 * soft.young
    for name in ("impact-baffle", "thin-layer", "impact-baffle-3d"):
        baffle, cell = scene[name].baffles[0], scene[name].domain.cell
        faces = [baffle.lower[0], baffle.lower[0] + baffle.size[0], baffle.lower[1] + baffle.size[1]]
        off_grid = [abs(face / cell - round(face / cell)) for face in faces if face > 0.0]
        assert min(off_grid) > 0.1, "faces between the nodes of the grid"


@pytest.mark.parametrize("name", ["dropped-bed", "slope-holds-3d"])
def test_a_row_that_asks_for_volume_has_a_core(name: str) -> None:
    flow = at_rest(BY_NAME[name].scene)
    fallen = lifted(flow, np.array([0.0, -flow.positions[:, :, 1].min() + 0.005, 0.0][: flow.scene.dimension]))
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
        assert expect.over_critical_height(at_rest(BY_NAME[name].scene), ratio=ratio).ok
        assert not expect.over_critical_height(at_rest(BY_NAME[name].scene), ratio=1.0).ok


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


def test_spread_needs_a_pile_no_steeper_than_friction() -> None:
    """0.4 x 0.2 m at 30 degrees: 0.4 + 0.2 / (2 tan 30) = 0.573 m."""
    flow = at_rest()
    assert expect.spreads(flow).minimum == pytest.approx(0.4 + 0.1 * math.sqrt(3.0))
    assert not expect.spreads(flow).ok
    assert expect.spreads(lifted(flow, np.array([0.18, 0.0]))).ok
    tall = at_rest(scene_of(Mass(lower=(0.0, 0.0), size=(0.1, 0.4))))
    assert expect.spreads(tall).minimum == pytest.approx(math.sqrt(0.08 * math.sqrt(3.0)))


def thrown(share: float, since: float = 0.1) -> Trajectory:
    """The upper of two beds thrown up at 4 m/s, of whose free flight it makes a share."""
    scene = scene_of(BED, Mass(lower=(0.0, 0.2), size=(0.4, 0.2), velocity=(0.0, 4.0)))
    flow = at_rest(scene)
    way = np.zeros_like(flow.positions)
    upper = flow.positions[0, :, 1] > 0.2
    way[:, upper, 1] = share * (4.0 * flow.time - 0.5 * 9.81 * flow.time**2)[:, None]
    return lifted(flow, way)


@pytest.mark.parametrize(("share", "ok"), [(1.0, True), (0.95, True), (0.85, False), (1.01, False)])
def test_what_is_thrown_up_has_to_rise(share: float, ok: bool) -> None:
    assert expect.parts_freely(thrown(share)).ok is ok


def test_tension_in_sand_is_found() -> None:
    flow = at_rest()
    assert expect.never_pulls(flow).ok
    assert flow.pressure is not None
    pressure = flow.pressure.copy()
    pressure[1, 3] = -1.0
    assert not expect.never_pulls(dataclasses.replace(flow, pressure=pressure)).ok


@pytest.mark.parametrize(("share", "ok"), [(0.9, False), (1.2, True), (2.1, False)])
def test_a_wall_takes_between_once_and_twice_the_momentum(share: float, ok: bool) -> None:
    flow = stopped(at_rest(scene_of(dataclasses.replace(BED, velocity=(3.0, 0.0)))))
    taken = np.array(flow.summary["wall_impulse"])
    taken[2, 0] = share * 3.0 * 1800.0 * 0.08
    spoilt = dataclasses.replace(flow, summary=flow.summary | {"wall_impulse": taken.tolist()})
    assert expect.wall_stops(spoilt).value == pytest.approx(share)
    assert expect.wall_stops(spoilt).ok is ok


@pytest.mark.parametrize(("share", "ok"), [(0.4, False), (0.6, True)])
def test_a_baffle_takes_its_share(share: float, ok: bool) -> None:
    baffle = Baffle(lower=(0.5, 0.0), size=(0.1, 0.2))
    flow = stopped(at_rest(scene_of(dataclasses.replace(BED, velocity=(3.0, 0.0)), baffles=(baffle,))))
    impulse = np.zeros((len(flow.time), 1, 2))
    impulse[2:, 0, 0] = share * 3.0 * 1800.0 * 0.08
    assert expect.baffle_stops(dataclasses.replace(flow, solid_impulse=impulse), minimum=0.5).ok is ok


def stopped(flow: Trajectory) -> Trajectory:
    """At its initial velocity in the first frame, at rest from the second."""
    velocities = np.zeros_like(flow.positions)
    velocities[0] = flow.scene.masses[0].velocity
    return dataclasses.replace(flow, velocities=velocities)


def test_a_collapse_stays_between_flume_and_discs() -> None:
    column = at_rest(scene_of(Mass(lower=(0.0, 0.0), size=(0.1, 0.4)), domain=Domain(size=(2.0, 0.5), cell=0.02)))
    for reach, ok in ((0.45, False), (0.8, True), (1.2, False)):
        assert expect.runout_of_collapse(lifted(column, np.array([reach - 0.1, 0.0]))).ok is ok


@pytest.mark.parametrize(("kept", "ok"), [(1.0, True), (0.95, False), (1.01, False)])
def test_a_layer_keeps_its_speed_until_it_lands(kept: float, ok: bool) -> None:
    flow = at_rest(scene_of(Mass(lower=(0.0, 0.2), size=(0.4, 0.06), velocity=(2.0, 0.0))))
    fall = np.zeros_like(flow.positions)
    fall[3:, :, 1] = -0.19
    velocities = np.zeros_like(flow.positions)
    velocities[:, :, 0] = np.array([2.0, 2.0, 2.0 * kept, 0.5, 0.0])[:, None]
    assert expect.keeps_speed(dataclasses.replace(lifted(flow, fall), velocities=velocities)).ok is ok


def test_points_left_behind_a_baffle_are_found() -> None:
    flow = at_rest(scene_of(baffles=(Baffle(lower=(0.5, 0.0), size=(0.1, 0.2)),)))
    assert not expect.passes_baffle(flow).ok
    past = np.zeros_like(flow.positions)
    past[-1, :, 0] = 0.7
    assert expect.passes_baffle(lifted(flow, past)).ok


@pytest.mark.parametrize(("gravity", "ok"), [(9.81, True), (9.7, False)])
def test_a_fall_off_the_parabola_is_found(gravity: float, ok: bool) -> None:
    scene = scene_of(Mass(lower=(0.0, 0.6), size=(0.4, 0.2)), domain=Domain(size=(0.4, 0.8), cell=0.02))
    flow = at_rest(scene)
    step = flow.time[-1] / flow.summary["steps"]
    way = np.zeros_like(flow.positions)
    way[:, :, 1] = -0.5 * gravity * (flow.time * (flow.time + step))[:, None]
    assert expect.falls_freely(lifted(flow, way)).ok is ok


@pytest.mark.parametrize(("growth", "ok"), [(1.0, True), (1.04, True), (1.1, False), (0.9, False)])
def test_a_loose_bed_stands_too_high(growth: float, ok: bool) -> None:
    flow = at_rest(scene_of(Mass(lower=(0.0, 0.1), size=(0.4, 0.2))))
    positions = flow.positions.copy()
    positions[-1, :, 1] = growth * (positions[-1, :, 1] - 0.1)
    assert expect.stands_as_before(dataclasses.replace(flow, positions=positions)).ok is ok


def test_a_point_in_the_air_has_not_landed() -> None:
    flow = at_rest(scene_of(Mass(lower=(0.2, 0.2), size=(0.01, 0.01))))
    assert not expect.lands(flow).ok
    assert expect.lands(lifted(flow, np.array([0.0, -0.2]))).ok


def test_creep_counts_from_its_start_and_in_cells() -> None:
    flow = at_rest()
    way = np.zeros_like(flow.positions)
    way[1:, 5, 0] = 0.1
    way[-1, 5, 0] += 0.002
    found = expect.creeps(lifted(flow, way), since=0.2, cells=0.05)
    assert found.value == pytest.approx(0.1, rel=1e-3)
    assert not found.ok
    assert expect.creeps(flow, since=0.2, cells=0.05).ok


def test_a_front_that_has_not_moved_is_found() -> None:
    way = np.zeros_like(at_rest().positions)
    way[-1, :, 0] = 0.05
    assert expect.runs_out(lifted(at_rest(), way)).ok
    assert not expect.runs_out(at_rest()).ok


def test_settlement_by_hand() -> None:
    """One layer: rho g H^2 / (2 M); soft under stiff adds (rho g h) h / M below."""
    one = scene_of()
    modulus = one.material.lame + 2.0 * one.material.shear_modulus
    assert exact_solutions.settlement(one) == pytest.approx(1800.0 * 9.81 * 0.2**2 / (2.0 * modulus))
    stiff = dataclasses.replace(one.material, young=2.0e8)
    two = scene_of(BED, Mass(lower=(0.0, 0.2), size=(0.4, 0.2), material=stiff))
    below = 1800.0 * 9.81 * 0.2**2 * 1.5 / modulus
    assert exact_solutions.settlement(two) == pytest.approx(below + 0.01 * exact_solutions.settlement(one))


@pytest.mark.parametrize(("share", "settled", "bounded"), [(1.0, True, True), (1.5, False, True), (2.2, False, False)])
def test_settlement_is_compared_with_that(share: float, settled: bool, bounded: bool) -> None:
    soft = scene_of(material=Material(friction_deg=30.0, young=2.0e4))
    flow = at_rest(soft)
    way = np.zeros_like(flow.positions)
    way[2:, :, 1] = -share * exact_solutions.settlement(soft)
    assert expect.settles(lifted(flow, way)).ok is settled
    assert expect.settles_at_most_twice(lifted(flow, way)).ok is bounded


def test_a_step_that_is_not_used_is_found() -> None:
    flow = at_rest()
    used = flow.scene.duration * flow.scene.material.wave_speed / flow.scene.domain.cell
    for fraction, ok in ((0.89, True), (0.4, False), (0.95, False)):
        summary = flow.summary | {"steps": math.ceil(used / fraction)}
        assert expect.step_used(dataclasses.replace(flow, summary=summary)).ok is ok


def test_another_front_is_found() -> None:
    flow = at_rest()
    assert expect.as_far_as(flow, flow, within=0.05).ok
    assert not expect.as_far_as(lifted(flow, np.array([0.03, 0.0])), flow, within=0.05).ok


ROOM = Domain(size=(0.4, 0.2, 0.4), cell=0.02)
CUBE = Mass(lower=(0.1, 0.0, 0.1), size=(0.1, 0.1, 0.1))


@pytest.mark.parametrize("check", [expect.is_round, expect.stays_centred, expect.is_symmetric])
def test_symmetry_lost_is_found(check: object) -> None:
    flow = at_rest(scene_of(CUBE, domain=ROOM))
    assert check(flow).ok  # type: ignore[operator]
    way = np.zeros_like(flow.positions)
    way[-1, :, 2] = 0.03
    assert not check(lifted(flow, way)).ok  # type: ignore[operator]


def test_points_apart_in_the_two_precisions_are_found() -> None:
    flow = at_rest()
    way = np.zeros_like(flow.positions)
    way[1, 7, 0] = 0.003
    assert expect.every_particle_agrees(flow, flow).ok
    assert not expect.every_particle_agrees(lifted(flow, way), flow).ok


def test_every_expectation_is_of_a_row() -> None:
    """What no row has is not checked."""
    checks = [check for row in ROWS for check in (*row.checks, *row.precisions, *row.comparisons)]
    used = {(check.func if isinstance(check, partial) else check).__name__ for check in checks}
    made = {
        name
        for name, value in vars(expect).items()
        if inspect.isfunction(value) and value.__module__ == expect.__name__ and "flow" in str(inspect.signature(value))
    }
    measured = {"moved_share", "surface_settlement", "mass_height", "rest_time", "share_of_throw", "in_cells"}
    assert made - measured <= used
