"""What changes on the way: masses that barriers retain until their time, materials that lose their strength."""

import dataclasses
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datasets import Gate, Mass, Material, Scene, Solid, Stage
from datasets.scene.grid_field import Field
from datasets.scene.particles import initial_particles
from mpm import AT_REST, LAST, WITH_FIELDS, Recording, simulate, simulate_many
from mpm.adjoint.gradient import gradient
from mpm.arrays.batch import Batch
from mpm.arrays.layout import Energy, Offset
from mpm.initial.stages import particles_after, settled
from mpm.output.checkpoint import Checkpoint
from mpm.simulation import Options
from tests.mpm.test_run import broken_off
from tests.refusals import refused
from tests.scenes import SAND, box, room, scene_of, with_masses
from validation.bench.stability.invariants import momentum

CLAY = Material(friction_deg=20.0, cohesion=2.0e4, tension_cutoff=1.0e4)
COLUMN = Mass(lower=(0.4, 0.0), size=(0.2, 0.2), k0="elastic")
LOST = {"cohesion": 0.0, "tension_cutoff": 0.0}


def staged(*stages: Stage, **changes: Any) -> Scene:
    settings = {"material": CLAY, "floor_friction": 0.5, "duration": 0.6, "stages": stages} | changes
    return box(COLUMN, **settings)


def widths(scene: Scene, **options: Any) -> tuple[list[float], list[float | None]]:
    """Extent of the deposit in each frame [m], and when stages began [s]."""
    flow = simulate(scene, threads=1, **options)
    return np.ptp(flow.positions[:, :, 0], axis=1).tolist(), flow.summary["stage_time"]


def test_a_column_stands_until_its_cohesion_is_lost() -> None:
    width, times = widths(staged(Stage(time=0.2, **LOST)))
    assert times == [pytest.approx(0.2)]
    assert width[40] == pytest.approx(width[0], abs=1.0e-4)
    assert width[-1] > width[0] + 0.1


def test_until_settled_and_at_rest_after_the_last_stage() -> None:
    """The run does not end at rest before the second stage, nor while what that let go still speeds up."""
    scene = staged(Stage(time=0.1, friction_deg=19.0), Stage(time="settled", **LOST), duration=2.0)
    width, (first, second) = widths(scene, record=dataclasses.replace(AT_REST, frames="all"))
    assert first == pytest.approx(0.1)
    assert 0.1 < second < 0.5
    assert width[-1] > width[0] + 0.1
    # What never settles is remarked.
    nowhere = Stage(time=0.02, lower=(0.8, 0.0), size=(0.1, 0.1), friction_deg=19.0)
    flow = simulate(staged(nowhere, Stage(time="settled", **LOST), duration=0.05), threads=1)
    assert flow.summary["stage_time"] == [0.02, None]
    assert any(line.startswith("stages[1] did not begin: by t = 0.05 s") for line in flow.summary["remarks"])
    # And what is for no particle.
    assert "stages[0] changes nothing: no particle began where it applies" in flow.summary["remarks"]


def test_settled_is_what_is_in_the_box_once_all_has_entered() -> None:
    """One frame after the last particle there is no series yet; a share of the mass moves by its own energy."""
    enters = Mass(kind="inflow", section=((0.2,),), hydrograph=((0.0, 0.1, 1.0), (0.1, 0.1, 1.0)))
    batch = Batch([box(enters, duration=1.0, stages=(Stage(time="settled", friction_deg=20.0),))], precision="f32")
    entered = int(batch.offsets[0, Offset.ENTERED])
    for batch.computed in (1, entered):
        assert not settled(batch, 0)
    batch.computed = len(batch.energy) - 1
    energies = batch.energies(0)
    energies[:] = 0.0
    energies[entered + 1 :, Energy.KINETIC] = [1.0, *np.full(len(energies) - entered - 2, 5.0e-4)]
    assert settled(batch, 0)
    energies[entered + 2 :, Energy.ABSENT] = 0.99
    assert not settled(batch, 0)


def test_the_material_is_that_of_the_stage_alone() -> None:
    """Free of stress at the start, a stage in the first frame differs from the material itself by that frame alone."""
    body = Mass(lower=(0.4, 0.0), size=(0.2, 0.2))
    early = box(body, material=SAND, duration=0.1, frame_dt=1.0e-4)
    late = dataclasses.replace(early, material=CLAY, stages=(Stage(time=1.0e-4, friction_deg=30.0, **LOST),))
    one, other = (simulate(scene, threads=1, record=LAST).positions[-1] for scene in (late, early))
    np.testing.assert_allclose(one, other, atol=1.0e-3)


def test_only_what_began_in_the_region_changes() -> None:
    bodies = (Mass(lower=(0.0, 0.0), size=(0.2, 0.2)), Mass(lower=(0.4, 0.0), size=(0.2, 0.2)))
    angles = Field(quantity="friction_deg", origin=(0.0, 0.0), spacing=(1.0, 1.0), nodes=(1, 1), values=(25.0,))
    stages = (
        Stage(time=0.01, mass=1, cohesion=100.0),
        Stage(time=0.02, lower=(0.1, 0.0), size=(0.4, 0.1), friction_deg=10.0),
        Stage(time=0.03, outline=((0.0,), (0.05,)), cohesion=7.0),
    )
    scene = box(*bodies, material=CLAY, stages=stages, fields=(angles,))
    particles = initial_particles(scene)
    x, y = particles.positions.T
    after = particles_after(scene, particles, 3)
    cohesion = np.where(x < 0.05, 7.0, np.where(particles.mass == 1, 100.0, CLAY.cohesion))
    np.testing.assert_array_equal(after.cohesion, cohesion.astype(np.float32))
    np.testing.assert_array_equal(after.friction_deg, np.where((x >= 0.1) & (x <= 0.5) & (y <= 0.1), 10.0, 25.0))
    # In 3D an outline is one in plan.
    corner = Stage(time=0.01, outline=((0.0, 0.0), (0.2, 0.0), (0.0, 0.2)), cohesion=1.0)
    scene = room(Mass(lower=(0.0, 0.0, 0.0), size=(0.2, 0.2, 0.2)), material=CLAY, stages=(corner,))
    particles = initial_particles(scene)
    weak = particles_after(scene, particles, 1).cohesion == 1.0
    np.testing.assert_array_equal(weak, particles.positions[:, [0, 2]].sum(axis=1) < 0.2)


@pytest.mark.parametrize("time", [0.2, "settled"])
def test_a_run_goes_on_across_a_stage(tmp_path: Path, time: float | str) -> None:
    scene = staged(Stage(time=time, **LOST), duration=0.6)
    options: Options = {"threads": 1, "record": Recording(frames=3)}
    whole, start = simulate(scene, **options), None
    for calls in (12, 23):
        broken_off(scene, calls, resume=start, **options).save(tmp_path / "checkpoint.npz")
        start = Checkpoint.load(tmp_path / "checkpoint.npz")
    again = simulate(scene, resume=start, **options)
    np.testing.assert_array_equal(again.positions, whole.positions)
    assert again.summary["stage_time"] == whole.summary["stage_time"]


@pytest.mark.slow
@pytest.mark.usefixtures("gpu")
def test_side_by_side_on_one_thread_and_on_a_gpu() -> None:
    scenes = [staged(Stage(time=time, **LOST), duration=0.4, seed=seed) for seed, time in enumerate((0.1, "settled"))]
    together = simulate_many([*scenes, staged(duration=0.1)], threads=2, record=LAST)
    for scene, beside in zip(scenes, together, strict=False):
        np.testing.assert_array_equal(simulate(scene, threads=1, record=LAST).positions, beside.positions)
    cpu, gpu = (simulate_many(scenes, precision="f64", record=AT_REST, arch=arch) for arch in ("cpu", "cuda"))
    for one, other in zip(cpu, gpu, strict=True):
        assert one.summary["stage_time"] == other.summary["stage_time"]
        np.testing.assert_allclose(one.summary["front"], other.summary["front"], atol=2.0e-3)


OUTSIDE = "expected a region inside the domain [1.0, 1.0], in part at least"


@pytest.mark.parametrize(
    ("stage", "said"),
    [
        ({"time": 0.6}, "stages[0].time: expected a time before the end at 0.6 s, got 0.6"),
        ({"time": "soon"}, "time: expected a time in s or 'settled', got 'soon'"),
        ({"mass": 1}, "stages[0].mass: expected one of 0 to 0, got 1"),
        ({"lower": (0.0, 0.0)}, "stages[0].size: expected lower and size together, lower is given, got none"),
        ({"lower": (20.0, 0.0), "size": (1.0, 1.0)}, f"stages[0].lower: {OUTSIDE}, got [20.0, 0.0]"),
        ({"outline": ((2.0,), (3.0,))}, f"stages[0].outline: {OUTSIDE}, got [(2.0,), (3.0,)]"),
        ({"outline": ((0.1,),)}, "stages[0].outline: expected at least 2 rows of 1 numbers, got 1"),
        ({"cohesion": None}, "stages[0]: expected a constant of the material that changes, got none"),
        ({"dilation_deg": 50.0}, "stages[0].dilation_deg: expected an angle in [0, friction_deg], got 50"),
    ],
)
def test_a_stage_that_is_none_is_refused_with_its_key(stage: dict[str, Any], said: str) -> None:
    assert str(refused(lambda: staged(Stage(**{"time": 0.2, "cohesion": 1.0} | stage)))) == said


def test_residual_strengths_stay_below_times_ascend_and_the_adjoint_says_no() -> None:
    soft = dataclasses.replace(CLAY, softening_length=0.1, residual_friction_deg=15.0)
    mistake = refused(staged, Stage(time=0.2, friction_deg=10.0), material=soft)
    said = "residual_friction_deg of the material beside it: expected a value in [0, friction_deg], at most 10, got 15"
    assert str(mistake) == f"stages[0]: {said}"
    settled, first = Stage(time="settled", cohesion=1.0), Stage(time=0.2, cohesion=0.5)
    refused(staged, settled, first, said="stages[1].time: expected times in ascending order, then 'settled'")
    said = "stages: expected a scene without stages, which the adjoint does not cover"
    refused(gradient, staged(first), lambda x, v: (0.0, 0.0 * x, None), said=said)


CELL = 0.02
HELD = Mass(lower=(0.4, 0.0), size=(0.2, 0.3), release=0.05)
BEHIND = scene_of(HELD, size=(1.0, 0.4), cell=CELL, duration=0.2)
BLOCK = Mass(lower=(0.1, 0.0, 0.06), size=(0.1, 0.1, 0.08), release=0.02)
SCENE_3D = scene_of(BLOCK, size=(0.3, 0.2, 0.2), cell=CELL, duration=0.06)


precisely = partial(simulate, precision="f64", threads=1, record=WITH_FIELDS)
BOTH = pytest.mark.parametrize("scene", [BEHIND, pytest.param(SCENE_3D, marks=pytest.mark.slow)], ids=["2D", "3D"])


@pytest.mark.double
@BOTH
def test_a_mass_stands_until_its_time_and_then_flows(scene: Scene) -> None:
    flow, mass = precisely(scene), scene.masses[0]
    frame = round(mass.release / scene.frame_dt)
    assert flow.summary["release_time"] == [mass.release]
    for axis in (0, 2)[: scene.dimension - 1]:
        held = flow.positions[: frame + 1, :, axis]
        assert held.min() > mass.lower[axis] - 0.01 * CELL
        assert held.max() < mass.lower[axis] + mass.size[axis] + 0.01 * CELL
        free = flow.positions[-1, :, axis]
        assert free.min() < held.min() - 0.1 * CELL
        assert free.max() > held.max() + 0.1 * CELL
    # It is let go with the first step after the frame of its release, not later.
    before, after = flow.positions[frame + 1 : frame + 3, :, 0].max(axis=1)
    assert after - before > 0.2 * (before - flow.positions[frame, :, 0].max()) >= 0.0
    assert before > flow.positions[frame, :, 0].max()


@pytest.mark.parametrize("top", [0.1, 0.101, 0.105, 0.112])
def test_barriers_stand_on_a_solid_at_any_height(top: float) -> None:
    """Rows of nodes below its top carry the lowest particles, too: not held, 2 % of a mass ran out at 0.101 m."""
    held = dataclasses.replace(HELD, lower=(0.4, top), release=0.2975)
    ground = Solid(lower=(0.0, 0.0), size=(1.0, top))
    flow = simulate(scene_of(held, size=(1.0, 0.6), cell=CELL, solids=(ground,), duration=0.3), threads=1)
    assert flow.positions[-2, :, 0].min() > 0.4 - 0.01 * CELL
    assert flow.positions[-2, :, 0].max() < 0.6 + 0.01 * CELL


@pytest.mark.double
@pytest.mark.parametrize("release", [0.05, "settled"])
def test_what_barriers_and_damping_take_is_in_the_balance(release: float | str) -> None:
    scene = with_masses(BEHIND, dataclasses.replace(HELD, lower=(0.3, 0.0), release=release))
    assert momentum(precisely(scene)).value < 1e-5


@pytest.mark.double
def test_a_mass_settles_before_it_is_let_go() -> None:
    flow = precisely(with_masses(BEHIND, dataclasses.replace(HELD, release="settled"), duration=0.5))
    (release,) = flow.summary["release_time"]
    assert 0.01 < release < 0.4
    frame = round(release / flow.frame_dt)
    kinetic = flow.summary["energy"]["kinetic"]
    weight = 0.2 * 0.3 * SAND.density
    assert kinetic[frame] < 2e-6 * 0.5 * weight * (9.81 * 0.3 / SAND.wave_speed) ** 2 < kinetic[1]
    # At its own weight, and it flows at once.
    vertical = SAND.density * 9.81 * (0.3 - flow.positions[frame, :, 1])
    assert np.polyfit(vertical, flow.pressure[frame], 1)[0] == pytest.approx((1.0 + 2 * 0.43) / 3.0, rel=0.1)
    assert kinetic[frame + 8] > 1e3 * kinetic[frame]


@pytest.mark.double
def test_masses_have_their_own_times() -> None:
    first = Mass(lower=(0.0, 0.0), size=(0.2, 0.2), k0=0.5, release=0.05)
    second = Mass(lower=(0.8, 0.0), size=(0.2, 0.2), k0=0.5, release=0.1)
    third = Mass(lower=(0.4, 0.2), size=(0.1, 0.1))
    settling = Mass(lower=(0.55, 0.0), size=(0.1, 0.1), release="settled")
    # Without volume correction, which the falling mass would ask for: gaps that close slowly keep a mass from settling.
    scene = with_masses(BEHIND, first, second, third, settling, duration=0.15, jitter=0.4, volume_correction=False)
    flow, particles = precisely(scene), initial_particles(scene)
    times = flow.summary["release_time"]
    assert times[:3] == [0.05, 0.1, 0.0]
    assert 0.0 < times[3] < 0.15
    for number, frame in ((0, 20), (1, 40)):
        speed = np.linalg.norm(flow.velocities[:, particles.mass == number], axis=2).max(axis=1)
        assert speed[: frame + 1].max() < 1e-9
        assert speed[frame + 1] > 1e-2
    # The free one falls meanwhile.
    falling = flow.velocities[20, particles.mass == 2, 1].mean()
    assert falling == pytest.approx(-9.81 * 0.05, rel=0.01)


@pytest.mark.double
@BOTH
def test_a_gate_holds_what_is_above_its_foot(scene: Scene) -> None:
    gate = Gate(speed=2.0, time_constant=0.03)
    mass = dataclasses.replace(scene.masses[0], gate=gate)
    flow, gone = precisely(with_masses(scene, mass)), precisely(scene)
    assert flow.summary["release_time"] == [mass.release]
    opened = round(mass.release / scene.frame_dt)
    assert (flow.positions[: opened + 1] == gone.positions[: opened + 1]).all()
    right = mass.lower[0] + mass.size[0]
    for frame in range(opened + 1, scene.frames):
        x, since = flow.positions[frame], float(flow.time[frame]) - mass.release
        # The integral of v (1 - exp(-t / tau)).
        foot = gate.speed * (since + gate.time_constant * np.expm1(-since / gate.time_constant))
        # A particle feels the nodes up to one and a half cells away.
        held = x[:, 1] > foot + 1.5 * CELL
        assert (x[held, 0] < right + 0.01 * CELL).all()
        assert (x[held, 0] > mass.lower[0] - 0.01 * CELL).all()
    # It flows out beneath, less than without a gate.
    standing, out, free = (x[:, 0].max() for x in (flow.positions[opened], flow.positions[-1], gone.positions[-1]))
    assert standing + 0.02 * CELL < out < free - 0.02 * CELL
    refused(gradient, with_masses(scene, mass), lambda x, v: (0.0, 0.0 * x, None), said="scene without a gate")


@pytest.mark.double
def test_a_fast_gate_is_none() -> None:
    fast = with_masses(BEHIND, dataclasses.replace(HELD, gate=Gate(speed=1000.0)))
    assert (precisely(fast).positions == precisely(BEHIND).positions).all()
