"""The solver against exact solutions, and the invariants that every run keeps."""

import dataclasses
import math
import shutil
from functools import partial

import numpy as np
import pytest

from datasets.errors import InputError
from datasets.library import read_scene
from datasets.material import Material
from datasets.scene import Baffle, Domain, Mass
from datasets.trajectory import Trajectory
from mpm import WITH_FIELDS, Recording, runtime, simulate, simulate_many
from mpm.output.request import FIELDS
from tests.mpm import scenes
from tests.mpm.scenes import SAND
from validation.bench.stability.exact_solutions import (
    FreeFlight,
    SlidingBlock,
    centre_displacement,
    settlement,
    total_energy,
)

box, room = partial(scenes.box, duration=0.2), partial(scenes.room, duration=0.2)
DEPOSIT = dataclasses.replace(WITH_FIELDS, frames="last")
"""Compiles no other kernel than `WITH_FIELDS`."""
FIRM = Material(friction_deg=45.0, cohesion=1.0e9, tension_cutoff=1.0e9, poisson=0.0, young=1.0e6)
"""Too strong to yield: an elastic solid."""


@pytest.mark.double
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_body_in_the_air_falls_on_a_parabola(dimension: int) -> None:
    thrown = {
        2: box(Mass(lower=(0.2, 0.6), size=(0.2, 0.2), velocity=(1.0, 0.5)), volume_correction=False),
        3: room(
            Mass(lower=(0.2, 0.5, 0.3), size=(0.16, 0.16, 0.16), velocity=(1.0, 0.5, -0.4)), volume_correction=False
        ),
    }
    flow = simulate(thrown[dimension], precision="f64", record=WITH_FIELDS)
    exact = FreeFlight.of_flow(flow).displacement(flow.time)
    np.testing.assert_allclose(centre_displacement(flow), exact, atol=1e-6)


@pytest.mark.parametrize(
    ("dimension", "slope_deg", "friction"),
    [(2, 30.0, 0.2), (2, 20.0, 0.3), (2, 15.0, 0.0), (3, 30.0, 0.2), (3, 15.0, 0.0)],
)
def test_a_block_slides_down_an_incline(dimension: int, slope_deg: float, friction: float) -> None:
    """The displacement of a rigid block with Coulomb friction; ours is elastic and stiff."""
    incline = {
        "material": dataclasses.replace(FIRM, young=1.0e7),
        "slope_deg": slope_deg,
        "floor_friction": friction,
        "duration": 0.4,
        "jitter": 0.0,
    }
    blocks = {
        2: box(Mass(lower=(0.1, 0.0), size=(0.2, 0.1)), **incline),  # type: ignore[arg-type]
        3: room(Mass(lower=(0.08, 0.0, 0.3), size=(0.2, 0.12, 0.2)), **incline),  # type: ignore[arg-type]
    }
    scene = blocks[dimension]
    slid = centre_displacement(simulate(scene))[-1]
    # It bounces elastically on the floor: an impulse of its last bounce is still to come or to be given back.
    tolerance = {2: 0.005, 3: 0.01}[dimension] * 0.5 * 9.81 * 0.4**2
    assert slid[0] == pytest.approx(SlidingBlock.of_scene(scene).displacement(scene.duration), abs=tolerance)
    assert dimension == 2 or abs(slid[2]) < 1e-4


def test_a_block_stays_on_an_incline_that_friction_holds() -> None:
    block = Mass(lower=(0.4, 0.0), size=(0.2, 0.1))
    scene = box(block, material=FIRM, slope_deg=20.0, floor_friction=0.5, damping=0.1, duration=0.5)
    assert abs(centre_displacement(simulate(scene))[-1, 0]) < 0.05 * scene.domain.cell


@pytest.mark.double
def test_an_elastic_bar_rings_with_its_period() -> None:
    """First free-free mode of a bar, nu = 0: period 2 L / c; the bar starts with the mode's velocity in 40 slices."""
    length, slices = 0.8, 40
    wave_speed = math.sqrt(FIRM.young / FIRM.density)
    period = 2 * length / wave_speed
    masses = [
        Mass(
            lower=(0.1 + k * length / slices, 0.4),
            size=(length / slices, 0.06),
            velocity=(0.05 * math.cos(math.pi * (k + 0.5) / slices), 0.0),
        )
        for k in range(slices)
    ]
    scene = box(
        *masses,
        material=FIRM,
        gravity=0.0,
        domain=Domain(size=(1.0, 1.0), cell=0.01),
        duration=0.1,
        frame_dt=0.0005,
        jitter=0.0,
        step_fraction=0.1,
    )
    trajectory = simulate(scene, precision="f64")
    extent = trajectory.positions[:, :, 0].max(axis=1) - trajectory.positions[:, :, 0].min(axis=1)
    shortest = trajectory.time[np.argmin(extent[: round(0.7 * period / 0.0005)])]
    longest = trajectory.time[np.argmax(extent[: round(1.2 * period / 0.0005)])]
    # It starts at full speed and zero strain: shortest after a quarter, longest after three quarters.
    assert longest - shortest == pytest.approx(period / 2, rel=0.03)


def test_a_layer_settles_under_its_weight_by_one_dimensional_compression() -> None:
    """The surface by u = rho g H^2 / (2 M), what lies at y by u (2 y / H - y^2 / H^2)."""
    height, material = 0.4, Material(friction_deg=45.0, cohesion=1e9, tension_cutoff=0.0, young=1.0e5, poisson=0.2)
    scene = box(Mass(lower=(0.0, 0.0), size=(1.0, height)), material=material, damping=0.3, duration=1.5, jitter=0.0)
    trajectory = simulate(scene, record=Recording(frames=1000))
    y = trajectory.positions[0, :, 1] / height
    exact = settlement(scene) * (2.0 * y - y**2)
    settled = trajectory.positions[0, :, 1] - trajectory.positions[-1, :, 1]
    surface = y > 0.95
    assert settled[surface].mean() == pytest.approx(exact[surface].mean(), rel=0.05)
    np.testing.assert_allclose(settled, exact, atol=0.1 * exact.max())


@pytest.mark.parametrize("precision", ["f32", "f64"])
@pytest.mark.parametrize("friction_deg", [15.0, 45.0])
def test_a_collapse_never_gains_energy(friction_deg: float, precision: str) -> None:
    scene = box(
        Mass(lower=(0.0, 0.0), size=(0.2, 0.4)),
        material=Material(friction_deg=friction_deg),
        floor_friction=0.4,
        wall_friction=0.1,
        duration=1.0,
    )
    total = total_energy(simulate(scene, precision=precision, record=DEPOSIT))  # type: ignore[arg-type]
    assert np.diff(total).max() < 2e-4 * total[0]
    assert total[-1] < 0.8 * total[0]


@pytest.mark.parametrize("corrected", [False, True])
def test_a_thrown_block_bounces_off_walls_without_gaining_energy(corrected: bool) -> None:
    """It becomes a spray, whose particles cross each other's cells: their affine motion must not grow of that."""
    scene = box(Mass(lower=(0.4, 0.4), size=(0.2, 0.2), velocity=(6.0, 3.0)), duration=0.6)
    trajectory = simulate(dataclasses.replace(scene, volume_correction=corrected))
    total = total_energy(trajectory)
    assert (total - np.minimum.accumulate(total)).max() < 1e-4 * total[0]
    assert trajectory.positions.min() >= 0.0
    assert trajectory.positions.max() <= 1.0


def test_the_deposit_keeps_its_volume() -> None:
    """Deep inside the deposit a cell holds as many points as at the start: sand at psi = 0 flows at constant volume."""
    scene = dataclasses.replace(read_scene("column-tall-21"), duration=0.8)
    deposit = simulate(scene).positions[-1]
    count, _, _ = np.histogram2d(*deposit.T, bins=50, range=[[0, 1], [0, 1]])
    core = np.ones_like(count, dtype=bool)
    for axis in (0, 1):
        for shift in (-1, 1):
            core &= np.roll(count, shift, axis) > 0
    core &= count > 0
    core[:, 0] = core[0] = False
    per_cell = (0.02 / scene.domain.cell * scene.particles_per_axis) ** 2
    assert core.sum() > 20
    assert count[core].mean() == pytest.approx(per_cell, rel=0.06)


@pytest.mark.double
def test_momentum_changes_only_by_the_walls() -> None:
    """Two blocks of different materials collide in the air: the momentum of both together falls freely."""
    light, heavy = Material(friction_deg=30.0), Material(friction_deg=40.0, density=2600.0, young=4.0e6)
    scene = box(
        Mass(lower=(0.2, 0.4), size=(0.2, 0.2), velocity=(2.0, 0.0)),
        Mass(lower=(0.42, 0.42), size=(0.2, 0.2), velocity=(-1.0, 0.0), material=heavy),
        material=light,
        duration=0.1,
        gravity=0.0,
    )
    trajectory = simulate(scene, precision="f64")
    density = np.where(trajectory.friction > 0.7, 2600.0, 1800.0)[:, None]
    centre = (density * trajectory.positions).sum(axis=1) / density.sum()
    drift = (trajectory.velocity0 * density).sum(axis=0) / density.sum()
    np.testing.assert_allclose(centre - centre[0], trajectory.time[:, None] * drift, atol=1e-6)
    energy = total_energy(trajectory)
    assert energy.max() <= energy[0] * 1.005
    # They did collide: the light block alone has lost most of its speed.
    own = trajectory.positions[:, trajectory.friction < 0.7, 0].mean(axis=1)
    assert own[-1] - own[-2] < 0.6 * (own[1] - own[0])


@pytest.mark.double
def test_masses_of_equal_materials_are_one_material() -> None:
    """A column cut into two masses, one with its own copy of almost the same material, flows like the whole."""
    lower, upper = Mass(lower=(0.0, 0.0), size=(0.2, 0.2)), Mass(lower=(0.0, 0.2), size=(0.2, 0.2))
    twin = dataclasses.replace(upper, material=dataclasses.replace(SAND, density=SAND.density * (1 + 1e-12)))
    one = simulate(box(lower, upper), precision="f64")
    two = simulate(box(lower, twin), precision="f64")
    np.testing.assert_allclose(one.positions, two.positions, atol=1e-5)


@pytest.mark.double
def test_damping_off_and_zero_damping_are_the_same_flow() -> None:
    """The damped kernel with a coefficient of zero is the undamped one but for rounding."""
    still = box(Mass(lower=(0.0, 0.0), size=(0.2, 0.4)))
    damped = dataclasses.replace(still, damping=0.2)
    alone, beside = simulate(still, precision="f64"), simulate_many([still, damped], precision="f64")[0]
    np.testing.assert_allclose(alone.positions, beside.positions, atol=1e-5)


def test_a_fast_frame_takes_more_steps() -> None:
    slow = box(Mass(lower=(0.4, 0.4), size=(0.1, 0.1)), step_fraction=1.0, duration=0.01, gravity=0.0)
    fast = dataclasses.replace(slow, masses=(dataclasses.replace(slow.masses[0], velocity=(20.0, 0.0)),))
    crossing = 0.005 / 0.02
    assert simulate(slow).summary["steps"] == 2 * math.ceil(crossing * SAND.wave_speed)
    assert simulate(fast).summary["steps"] == 2 * math.ceil(crossing * (SAND.wave_speed + 20.0))


def test_a_run_too_large_to_count_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("datasets.memory.free", lambda: 2**50)
    endless = room(Mass(lower=(0.0, 0.0, 0.0), size=(0.8, 0.8, 0.8)), duration=100.0, frame_dt=0.001)
    with pytest.raises(InputError, match="expected a smaller run"):
        simulate(endless)


def test_a_slice_between_smooth_walls_flows_as_in_two_dimensions() -> None:
    """Plane strain, made in 3D by two smooth walls; means over jitters, which scatter fronts by a quarter of a cell."""
    sand, cell = Material(friction_deg=35.0), 0.02
    flat = box(Mass(lower=(0.0, 0.0), size=(0.2, 0.3)), material=sand, duration=0.5, floor_friction=0.4)
    deep = box(
        Mass(lower=(0.0, 0.0, 0.0), size=(0.2, 0.3, 4 * cell)),
        material=sand,
        duration=0.5,
        floor_friction=0.4,
        domain=Domain(size=(1.0, 1.0, 4 * cell), cell=cell),
    )
    alone, slices = (
        simulate_many([dataclasses.replace(scene, seed=seed) for seed in range(3)], record=DEPOSIT)
        for scene in (flat, deep)
    )
    fronts = [np.mean([flow.summary["front"] for flow in flows]) for flows in (alone, slices)]
    assert fronts[1] == pytest.approx(fronts[0], abs=0.5 * cell)
    heights = [np.mean([flow.positions[-1, :, 1].mean() for flow in flows]) for flows in (alone, slices)]
    assert heights[1] == pytest.approx(heights[0], rel=0.03)


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_a_collapse_in_three_dimensions_never_gains_energy(precision: str) -> None:
    scene = room(
        Mass(lower=(0.0, 0.0, 0.2), size=(0.24, 0.48, 0.4)), floor_friction=0.4, wall_friction=0.1, duration=0.8
    )
    total = total_energy(simulate(scene, precision=precision, record=DEPOSIT))  # type: ignore[arg-type]
    assert np.diff(total).max() < 2e-4 * total[0]
    assert total[-1] < 0.8 * total[0]


def test_a_ball_of_sand_comes_to_rest_as_a_round_pile() -> None:
    """A staircase of boxes for a ball, in the middle of the floor: the pile it leaves is as long as it is wide."""
    radius, cell = 0.16, 0.04
    middle = np.array([0.4, radius, 0.4])
    steps = np.arange(-4, 4) * cell + cell / 2
    masses = [
        Mass(
            lower=(middle[0] + x - cell / 2, middle[1] + y - cell / 2, middle[2] - half_width),
            size=(cell, cell, 2 * half_width),
        )
        for x in steps
        for y in steps
        if (half_width := math.floor(math.sqrt(max(radius**2 - x * x - y * y, 0.0)) / cell + 0.5) * cell) > 0.0
    ]
    trajectory = simulate(room(*masses, floor_friction=0.5, duration=1.0), record=WITH_FIELDS)
    pile = trajectory.positions[-1] - middle
    spread = pile.std(axis=0)
    assert spread[0] == pytest.approx(spread[2], rel=0.05)
    assert np.abs(pile.mean(axis=0)[[0, 2]]).max() < 0.1 * cell
    kinetic = trajectory.summary["energy"]["kinetic"]
    assert kinetic[-1] < 1e-2 * max(kinetic)


def test_a_slope_at_repose_stays_and_a_steeper_one_slides() -> None:
    """A layer on a rough incline is an infinite slope: without dilation it bears atan(sin phi) = 26.6 degrees."""

    def speed(slope_deg: float) -> float:
        layer = Mass(lower=(0.0, 0.0, 0.0), size=(1.2, 0.12, 0.12))
        scene = room(
            layer,
            domain=Domain(size=(1.8, 0.4, 0.12), cell=0.04),
            slope_deg=slope_deg,
            floor_friction=2.0,
            duration=0.4,
        )
        trajectory = simulate(scene, record=WITH_FIELDS)
        assert trajectory.velocities is not None
        # The middle of the layer's surface, far from both of its ends.
        start = trajectory.positions[0]
        middle = (start[:, 0] > 0.4) & (start[:, 0] < 0.8) & (start[:, 1] > 0.08)
        return float(trajectory.velocities[-20:, middle, 0].mean())

    # Gravity comes on at once, without the stress that bears it: the layer has to settle first.
    assert abs(speed(20.0)) < 0.01
    assert speed(33.0) > 0.2


@pytest.mark.double
def test_one_scene_on_two_threads_is_the_scene_on_one(monkeypatch: pytest.MonkeyPatch) -> None:
    baffle = Baffle(lower=(0.2, 0.0), size=(0.1, 0.1))
    flat = box(Mass(lower=(0.0, 0.0), size=(0.2, 0.4)), baffles=(baffle,), damping=0.1, duration=0.1)
    deep = room(Mass(lower=(0.0, 0.0, 0.2), size=(0.24, 0.3, 0.4)), duration=0.1)
    for scene in (flat, deep):
        monkeypatch.setattr("mpm.runtime.PARTICLES_PER_WORKER", 10**9)
        alone = simulate(scene, precision="f64", threads=2, record=WITH_FIELDS)
        monkeypatch.setattr("mpm.runtime.PARTICLES_PER_WORKER", 100)
        monkeypatch.setattr("mpm.simulation.SORTED", 0)
        shared = simulate(scene, precision="f64", threads=2, record=WITH_FIELDS)
        # Where principal stresses coincide, half of the digits are lost (`mpm.physics.principal`): another order shows.
        np.testing.assert_allclose(shared.positions, alone.positions, atol=5e-6)
        np.testing.assert_allclose(shared.summary["wall_impulse"], alone.summary["wall_impulse"], rtol=1e-3, atol=1e-6)
        if scene.baffles:
            assert alone.solid_impulse is not None
            np.testing.assert_allclose(shared.solid_impulse, alone.solid_impulse, rtol=1e-3, atol=1e-6)


def test_fields_are_what_the_points_carry() -> None:
    scene = box(Mass(lower=(0.0, 0.0), size=(1.0, 0.3)), damping=0.3, duration=1.0, jitter=0.0)
    trajectory = simulate(scene, record=Recording(fields=frozenset(FIELDS), wall_forces=True))
    assert trajectory.velocities is not None
    assert trajectory.pressure is not None
    assert trajectory.plastic_strain is not None
    np.testing.assert_array_equal(trajectory.velocities[0], trajectory.velocity0)
    assert np.abs(trajectory.velocities[-1]).max() < 0.01
    # A level layer at rest: the vertical stress is the weight above, K0 = nu / (1 - nu) beside it.
    depth = 0.3 - trajectory.positions[-1, :, 1]
    exact = 1800.0 * 9.81 * depth * (1 + 2 * 0.3 / 0.7) / 3
    middle = (depth > 0.1) & (depth < 0.25)
    assert trajectory.pressure[-1, middle].mean() == pytest.approx(exact[middle].mean(), rel=0.1)
    assert np.all(np.diff(trajectory.plastic_strain, axis=0) >= 0.0)


@pytest.mark.double
def test_a_gpus_kernel_computes_the_same_flow(monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel with a thread per particle and atomic sums, here on the CPU's threads."""
    monkeypatch.setitem(runtime.ARCHES, "cuda", runtime.ARCHES["cpu"])
    heavy = dataclasses.replace(SAND, density=2600.0)
    baffle = Baffle(lower=(0.55, 0.0), size=(0.1, 0.2))
    flat = [
        box(
            Mass(lower=(0.0, 0.0), size=(0.2, 0.4)),
            Mass(lower=(0.1, 0.4), size=(0.1, 0.1), material=heavy),
            baffles=(baffle,),
            damping=0.1,
            duration=0.05,
        ),
        box(
            Mass(lower=(0.1, 0.0), size=(0.2, 0.2), velocity=(1.0, 0.0)),
            Mass(lower=(0.4, 0.0), size=(0.1, 0.1), material=heavy),
            baffles=(baffle,),
            damping=0.1,
            step_fraction=0.9,
            duration=0.05,
        ),
    ]
    deep = [room(Mass(lower=(0.0, 0.0, 0.2), size=(0.16, 0.24, 0.2)), duration=0.05)]
    for group in (flat, deep):
        cpu, gpu = (simulate_many(group, precision="f64", record=WITH_FIELDS, arch=arch) for arch in ("cpu", "cuda"))
        for one, other in zip(cpu, gpu, strict=True):
            # Threads add in an order of their own, and where principal stresses coincide half of the digits are lost.
            np.testing.assert_allclose(other.positions, one.positions, atol=5e-6)
            assert other.summary["steps"] == one.summary["steps"]
            for kind, series in one.summary["energy"].items():
                np.testing.assert_allclose(other.summary["energy"][kind], series, rtol=1e-3, atol=1e-9)
            walls = (flow.summary["wall_impulse"] for flow in (other, one))
            np.testing.assert_allclose(*walls, rtol=1e-3, atol=1e-5)
            np.testing.assert_allclose(other.plastic_strain, one.plastic_strain, atol=1e-3)
            if one.solid_impulse is not None:
                np.testing.assert_allclose(other.solid_impulse, one.solid_impulse, rtol=1e-3, atol=1e-6)


@pytest.mark.skipif(shutil.which("nvidia-smi") is not None, reason="there may be a GPU here")
def test_a_missing_gpu_is_one_clear_line() -> None:
    with pytest.raises(InputError, match="--arch: expected a GPU that Taichi can use with cuda, found none"):
        simulate(box(Mass(lower=(0.0, 0.0), size=(0.1, 0.1)), duration=0.01), arch="cuda")
    # And the CPU still works.
    assert simulate(box(Mass(lower=(0.0, 0.0), size=(0.1, 0.1)), duration=0.01)).summary["arch"] == "cpu"


def dropped_beds() -> tuple[Trajectory, Trajectory]:
    """A bed that falls between walls and parts in its bounce: its gaps forgotten, and remembered."""
    loose = box(
        Mass(lower=(0.0, 0.3), size=(0.4, 0.2)), domain=Domain(size=(0.4, 1.0), cell=0.02), duration=2.0, frame_dt=0.01
    )
    forgetful, mindful = simulate_many([dataclasses.replace(loose, volume_correction=each) for each in (False, True)])
    return forgetful, mindful


def test_volume_correction_closes_gaps_and_makes_no_energy() -> None:
    """Sand that parted in the air bears nothing until its gaps have closed: its centre rests at half of its height."""
    forgetful, mindful = dropped_beds()
    assert forgetful.positions[-1, :, 1].mean() > 0.15
    assert mindful.positions[-1, :, 1].mean() == pytest.approx(0.1, rel=0.05)
    for trajectory in (forgetful, mindful):
        total = total_energy(trajectory)
        assert np.diff(total).max() < 2e-4 * total[0]


@pytest.mark.double
def test_a_scene_does_not_remember_what_another_one_of_its_batch_does() -> None:
    plain = box(Mass(lower=(0.2, 0.1), size=(0.2, 0.2), velocity=(2.0, 0.0)), duration=0.2, volume_correction=False)
    alone = simulate(plain, precision="f64")
    beside, _ = simulate_many([plain, dataclasses.replace(plain, volume_correction=True)], precision="f64")
    np.testing.assert_allclose(beside.positions, alone.positions, atol=1e-6)
