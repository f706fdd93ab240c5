"""The solver against exact solutions, what every run keeps, what the transfer keeps; side walls of a channel in 2D."""

import dataclasses
import math
import shutil
from functools import partial

import numpy as np
import pytest

from datasets import Baffle, Channel, Mass, Material, Scene, read_scene
from mpm import LAST, WITH_FIELDS, Recording, simulate, simulate_many
from tests import scenes
from tests.refusals import refused
from tests.scenes import SAND, scaled, scene_of
from validation.bench.stability.bench import FOLDER
from validation.bench.stability.exact_solutions import (
    FreeFlight,
    SlidingBlock,
    StandingWave,
    centre_displacement,
    settlement,
    total_energy,
)

box, room = partial(scenes.box, duration=0.2), partial(scenes.room, duration=0.2)
DEPOSIT = dataclasses.replace(WITH_FIELDS, frames="last")  # compiles no other kernel than `WITH_FIELDS`
TALL = Mass(lower=(0.0, 0.0), size=(0.2, 0.4))
FIRM = Material(friction_deg=45.0, cohesion=1.0e9, tension_cutoff=1.0e9, poisson=0.0, young=1.0e6)
"""Too strong to yield: an elastic solid."""


@pytest.mark.double
@pytest.mark.parametrize(
    "scene",
    [
        box(Mass(lower=(0.2, 0.6), size=(0.2, 0.2), velocity=(1.0, 0.5))),
        room(Mass(lower=(0.2, 0.5, 0.3), size=(0.16, 0.16, 0.16), velocity=(1.0, 0.5, -0.4))),
    ],
    ids=["2D", "3D"],
)
def test_a_body_in_the_air_falls_on_a_parabola(scene: Scene) -> None:
    flow = simulate(dataclasses.replace(scene, volume_correction=False), precision="f64", record=WITH_FIELDS)
    exact = FreeFlight.of_flow(flow).displacement(flow.time)
    np.testing.assert_allclose(centre_displacement(flow), exact, atol=1e-6)


@pytest.mark.parametrize(
    ("block", "slope_deg", "friction"),
    [
        (box(Mass(lower=(0.1, 0.0), size=(0.2, 0.1))), 30.0, 0.2),
        (box(Mass(lower=(0.1, 0.0), size=(0.2, 0.1))), 15.0, 0.0),
        pytest.param(room(Mass(lower=(0.08, 0.0, 0.3), size=(0.2, 0.12, 0.2))), 30.0, 0.2, marks=pytest.mark.slow),
    ],
)
def test_a_block_slides_down_an_incline(block: Scene, slope_deg: float, friction: float) -> None:
    """The displacement of a rigid block with Coulomb friction; ours is elastic and stiff."""
    incline = {"slope_deg": slope_deg, "floor_friction": friction, "duration": 0.4, "jitter": 0.0}
    scene = dataclasses.replace(block, material=dataclasses.replace(FIRM, young=1.0e7), **incline)
    slid = centre_displacement(simulate(scene))[-1]
    # It bounces elastically on the floor: an impulse of its last bounce is still to come or to be given back.
    tolerance = {2: 0.005, 3: 0.01}[scene.dimension] * 0.5 * 9.81 * 0.4**2
    assert slid[0] == pytest.approx(SlidingBlock.of_scene(scene).displacement(scene.duration), abs=tolerance)
    assert scene.dimension == 2 or abs(slid[2]) < 1e-4


@pytest.mark.double
def test_a_free_body_keeps_its_angular_momentum() -> None:
    """An elastic bar that turns by a radian without weight, from a lattice that its turn leaves."""
    bar = Mass(lower=(0.4, 0.4), size=(0.24, 0.12), angular_velocity=10.0)
    scene = box(bar, material=FIRM, gravity=0.0, duration=0.1, volume_correction=False)
    flow = simulate(scene, precision="f64", record=WITH_FIELDS)
    motion = (vectors.astype(np.float64) for vectors in (flow.positions, flow.velocities))
    x, v = (vectors - vectors.mean(axis=1, keepdims=True) for vectors in motion)
    spin = (x[..., 0] * v[..., 1] - x[..., 1] * v[..., 0]).mean(axis=1)
    np.testing.assert_allclose(spin, spin[0], rtol=1e-3)


@pytest.mark.slow
@pytest.mark.double
def test_an_elastic_bar_rings_with_its_period() -> None:
    """Of the lowest mode kinetic and elastic energy are one in the mean over whole periods: omega = rms v / rms u."""
    bar = read_scene(FOLDER / "hard_cases" / "bar-mode.toml")
    flow = simulate(bar, precision="f64", record=WITH_FIELDS)
    wave = StandingWave.of_bar(flow)
    whole = flow.time * wave.omega < 2.0 * math.pi * math.floor(bar.duration * wave.omega / (2.0 * math.pi))
    x, v = (vectors[whole, :, 0].astype(np.float64) for vectors in (flow.positions, flow.velocities))
    assert np.std(v @ wave.shape) / np.std((x - x[0]) @ wave.shape) == pytest.approx(wave.omega, rel=0.03)


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
def test_a_collapse_never_gains_energy(precision: str) -> None:
    weak = Material(friction_deg=15.0)
    scene = box(TALL, material=weak, floor_friction=0.4, wall_friction=0.1, duration=1.0)
    total = total_energy(simulate(scene, precision=precision, record=DEPOSIT))
    assert np.diff(total).max() < 2e-4 * total[0]
    assert total[-1] < 0.8 * total[0]


@pytest.mark.parametrize("corrected", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_thrown_block_bounces_off_walls_without_gaining_energy(corrected: bool) -> None:
    """It becomes a spray, whose particles cross each other's cells: their affine motion must not grow of that."""
    scene = box(Mass(lower=(0.4, 0.4), size=(0.2, 0.2), velocity=(6.0, 3.0)), duration=0.6)
    trajectory = simulate(dataclasses.replace(scene, volume_correction=corrected))
    total = total_energy(trajectory)
    assert (total - np.minimum.accumulate(total)).max() < 1e-4 * total[0]
    assert trajectory.positions.min() >= 0.0
    assert trajectory.positions.max() <= 1.0


@pytest.mark.slow
@pytest.mark.double
def test_one_scene_on_two_threads_is_the_scene_on_one(monkeypatch: pytest.MonkeyPatch) -> None:
    baffle = Baffle(lower=(0.2, 0.0), size=(0.1, 0.1))
    flat = box(TALL, baffles=(baffle,), damping=0.1, duration=0.1)
    deep = room(Mass(lower=(0.0, 0.0, 0.2), size=(0.24, 0.3, 0.4)), duration=0.1)
    for scene in (flat, deep):
        monkeypatch.setattr("mpm.runtime.PARTICLES_PER_WORKER", 10**9)
        alone = simulate(scene, precision="f64", threads=2, record=WITH_FIELDS)
        monkeypatch.setattr("mpm.runtime.PARTICLES_PER_WORKER", 100)
        monkeypatch.setattr("mpm.simulation.LARGE", 0)
        shared = simulate(scene, precision="f64", threads=2, record=WITH_FIELDS)
        # Where principal stresses coincide, half of the digits are lost (`mpm.physics.stress`): another order shows.
        np.testing.assert_allclose(shared.positions, alone.positions, atol=5e-6)
        np.testing.assert_allclose(shared.summary["wall_impulse"], alone.summary["wall_impulse"], rtol=1e-3, atol=1e-6)
        if scene.baffles:
            # What is open is decided by a threshold (`mpm.physics.volume_correction.LEAST`): 0.16 % of the impulse.
            np.testing.assert_allclose(shared.solid_impulse, alone.solid_impulse, rtol=5e-3, atol=1e-6)


@pytest.mark.slow
@pytest.mark.double
@pytest.mark.usefixtures("gpu")
def test_a_gpus_kernel_computes_the_same_flow() -> None:
    heavy = dataclasses.replace(SAND, density=2600.0)
    baffles = (Baffle(lower=(0.55, 0.0), size=(0.1, 0.2)),)
    damped = partial(box, baffles=baffles, damping=0.1, duration=0.05)
    thrown = Mass(lower=(0.1, 0.0), size=(0.2, 0.2), velocity=(1.0, 0.0))
    flat = [
        damped(TALL, Mass(lower=(0.1, 0.4), size=(0.1, 0.1), material=heavy)),
        damped(thrown, Mass(lower=(0.4, 0.0), size=(0.1, 0.1), material=heavy), step_fraction=0.9),
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


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("nvidia-smi") is not None, reason="there may be a GPU here")
def test_a_missing_gpu_is_one_clear_line() -> None:
    small = box(Mass(lower=(0.0, 0.0), size=(0.1, 0.1)), duration=0.01)
    refused(simulate, small, arch="cuda", said="--arch: expected a GPU that Taichi can use with cuda, found none")
    assert simulate(small).summary["arch"] == "cpu", "the CPU still works"


COLUMN = scene_of(TALL, size=(1.6, 0.6), duration=1.0, frame_dt=0.005, floor_friction=0.385, step_fraction=0.9)


def stiffer(young: float = 2.0e6, **changes: object) -> Scene:
    """The column at another Young's modulus [Pa] and with other changes."""
    return dataclasses.replace(COLUMN, material=dataclasses.replace(SAND, young=young), **changes)


def test_the_front_does_not_depend_on_stiffness_step_or_output_interval() -> None:
    """Within 3 % at 20 mm cells; APIC, which loses velocity in every step, is apart by a fifth and more."""
    scenes = [stiffer(), stiffer(step_fraction=0.2), stiffer(2.0e8), stiffer(frame_dt=0.001), stiffer(frame_dt=0.01)]
    fronts = np.array([flow.summary["front"] for flow in simulate_many(scenes)])
    assert np.ptp(fronts) <= 0.03 * fronts.mean()
    apic = [dataclasses.replace(scene, relaxation_time=0.0) for scene in scenes[:3]]
    dissipated = np.array([flow.summary["front"] for flow in simulate_many(apic)])
    assert np.ptp(dissipated) > 0.15 * dissipated.mean()


def test_a_front_converges_with_the_cell() -> None:
    """Mean of three packings on cells of 40, 20 and 10 mm: each halving changes it less."""
    soft, body = dataclasses.replace(SAND, young=5.0e5), Mass(lower=(0.0, 0.0), size=(0.2, 0.2))
    settings = {"material": soft, "floor_friction": 0.4, "duration": 0.6, "frame_dt": 0.02, "step_fraction": 0.9}

    def mean_front(cell: float) -> float:
        flows = simulate_many([box(body, cell=cell, seed=seed, **settings) for seed in range(3)])
        return float(np.mean([flow.summary["front"] for flow in flows]))

    coarse, middle, fine = map(mean_front, (0.04, 0.02, 0.01))
    assert abs(fine - middle) < 0.5 * abs(middle - coarse)


@pytest.mark.slow
@pytest.mark.double
def test_the_default_relaxation_scales_with_the_flow() -> None:
    """Ten times the length, sqrt(10) times the time and ten times the modulus give the same flow, scaled."""
    fronts = [simulate(scene, precision="f64").summary["front"] for scene in (COLUMN, scaled(COLUMN, 10.0))]
    assert fronts[1] == pytest.approx(10.0 * fronts[0], rel=1e-3)


@pytest.mark.parametrize(("friction_deg", "floor"), [(0.0, 0.1), (20.0, 0.1), (20.0, 0.0), (60.0, 0.1)])
def test_a_block_slides_between_walls(friction_deg: float, floor: float) -> None:
    """a = g sin - mu_f g cos - (2 mu_w / W) nu g cos h / 2, at least 0: -sigma_zz is nu times the weight above."""
    body, channel = Mass(lower=(0.1, 0.0), size=(0.3, 0.2)), Channel(width=0.08, friction_deg=friction_deg)
    incline = {"slope_deg": 20.0, "floor_friction": floor, "duration": 0.3, "jitter": 0.0}
    scene = box(body, material=dataclasses.replace(FIRM, poisson=0.3, young=1.0e7), channel=channel, **incline)
    slid = centre_displacement(simulate(scene))[-1, 0]
    assert slid == pytest.approx(SlidingBlock.of_scene(scene).displacement(0.3), abs=0.01 * 0.5 * 9.81 * 0.3**2)


@pytest.mark.slow
def test_sand_in_a_channel_flows_as_between_walls_in_three_dimensions() -> None:
    """The front of a column in a channel six cells wide, within 3 % of that in 3D; without walls it goes further."""
    width, sand, angle = 0.12, Material(friction_deg=30.0, young=1.0e6), 15.0
    flow = partial(box, floor_friction=0.5, duration=0.5, material=sand)
    flat = flow(Mass(lower=(0.0, 0.0), size=(0.2, 0.3)), size=(1.2, 0.4))
    body, side = Mass(lower=(0.0, 0.0, 0.0), size=(0.2, 0.3, width)), math.tan(math.radians(angle))
    deep = flow(body, size=(1.2, 0.4, width), wall_friction=side)
    walled = dataclasses.replace(flat, channel=Channel(width=width, friction_deg=angle))
    fronts = [float(simulate(scene, record=LAST).summary["front"]) for scene in (flat, walled, deep)]
    assert fronts[1] == pytest.approx(fronts[2], rel=0.03)
    assert fronts[0] > 1.06 * fronts[2]


def test_what_is_no_channel_is_refused() -> None:
    deep, channel = Mass(lower=(0.0, 0.0, 0.0), size=(0.2, 0.2, 0.2)), Channel(width=0.1, friction_deg=20.0)
    assert refused(box, deep, size=(1.0, 1.0, 1.0), channel=channel).key == "channel"
    assert refused(Channel, width=0.0, friction_deg=20.0).key == "width"
    assert refused(Channel, width=0.1, friction_deg=90.0).key == "friction_deg"
