"""What a run will take, before it is allocated, and what sets its step, on which a thin flow does not depend."""

import dataclasses

import numpy as np
import pytest

from datasets import Domain, Mass, Material, Scene, Solid, read_scene
from datasets.scene.stiffness import greatest_speed
from mpm import ALL, LAST, WITH_FIELDS, Recording, simulate, simulate_many
from mpm.arrays.batch import Batch
from mpm.arrays.layout import Precision, node_room
from mpm.footprint import PROCESS, SPEED, expected, footprint, planned, step_spoken
from tests.refusals import refused
from tests.scenes import box

COLUMN, BAFFLES = read_scene("column-tall-42"), read_scene("baffles-2")


@pytest.mark.parametrize(
    ("name", "record", "precision"),
    [
        ("column-tall-42", LAST, "f32"),
        ("layers-10", WITH_FIELDS, "f64"),
        ("baffles-2", Recording(frames=7), "f32"),
        ("slope-layers", ALL, "f64"),
    ],
)
def test_it_covers_the_arrays_of_a_run(name: str, record: Recording, precision: Precision) -> None:
    scene = read_scene(name)
    plan = footprint(scene, record=record, precision=precision)
    batch = Batch([scene], precision=precision, record=record)
    assert plan.particles == len(batch.particles[0].positions)
    assert plan.nodes[: scene.dimension] == plan.nodes
    assert len(batch.grid) == node_room(scene.domain, len(batch.state) * batch.features.lanes)
    size = sum(array.nbytes for array in vars(batch).values() if isinstance(array, np.ndarray))
    size += sum(array.nbytes for array in batch.record[0].values()) * (not batch.in_kernel)
    assert size <= plan.bytes - PROCESS <= 4.0 * size


def test_steps_and_frames_are_those_of_the_run() -> None:
    scene = dataclasses.replace(read_scene("column-short-21"), duration=0.025)
    plan = footprint(scene)
    flow = simulate(scene)
    assert plan.frames == len(flow.time)
    assert plan.steps == flow.summary["steps"]
    assert f"{plan.particles} particles, " in str(plan)
    # Many runs are planned from scenes alone: their work, and the bytes of the largest.
    work, size = planned([scene, COLUMN])
    assert (work, size) == (plan.work + footprint(COLUMN).work, footprint(COLUMN).bytes)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"frame_dt": 1.0e4, "duration": 1.0e8}, "duration: expected at most 2147483647 steps"),
        ({"frame_dt": 1.0e-4, "duration": 900.0}, "fewer particles_per_axis or frames"),
        # Single precision does not hold it.
        ({"gravity": 1e-45}, "gravity y of -1e-45; --precision f64 holds more"),
    ],
)
def test_what_no_machine_could_run_is_refused_at_once(
    change: dict[str, float], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("datasets.memory.free", lambda: 2**36)
    scene: Scene = dataclasses.replace(read_scene("column-short-21"), **change)
    refused(simulate, scene, said=message)


def test_a_range_grows_with_the_work_and_falls_with_the_processors() -> None:
    estimate = expected(COLUMN, SPEED[2] * 120.0, memory=300 * 2**20, processors=2)
    assert str(estimate) == "expected: 0.6 to 2.6 min, 300 MiB of memory"
    more = expected(COLUMN, SPEED[2] * 120.0, memory=0, processors=2, after=600.0)
    assert more.shortest == pytest.approx(estimate.shortest + 600.0)
    work = 1.0e10
    column, baffles = (expected(scene, work, memory=0).longest for scene in (COLUMN, BAFFLES))
    bare = expected(dataclasses.replace(BAFFLES, baffles=()), work, memory=0).longest
    assert column < bare < baffles
    assert expected(COLUMN, work, memory=0, precision="f64").longest > column
    assert expected(COLUMN, work, memory=0, arch="cuda").longest < column / 5.0
    rests = expected(COLUMN, work, memory=0, until_rest=True)
    assert (rests.longest, rests.shortest < 0.6 * expected(COLUMN, work, memory=0).shortest) == (column, True)


SLOPE, RADIUS, END, FRICTION = np.radians(30.0), 60.0, 600.0, 0.3
FOOT = 260.0
"""x of the foot [m], where the slope of 300 m would meet the level without the arc between."""


def mountainside() -> Scene:
    """1.5 m on a path of 300 m at 30 degrees, then an arc and the level; bed friction 0.3, cells of 0.75 m."""
    along = RADIUS * np.tan(0.5 * SLOPE)
    angles = SLOPE - np.linspace(0.0, SLOPE, 17)
    arc = [(FOOT + along - RADIUS * np.sin(angle), 5.0 + RADIUS * (1.0 - np.cos(angle))) for angle in angles.tolist()]
    points = ((0.0, 5.0 + FOOT * np.tan(SLOPE)), *arc, (END, 5.0))
    return Scene(
        domain=Domain(size=(END, 162.0), cell=0.75),
        material=Material(friction_deg=30.0, density=2000.0),
        masses=(Mass(kind="layer", thickness=1.5, outline=((10.0,), (40.0,))),),
        solids=(Solid(kind="terrain", points=tuple((float(x), float(y)) for x, y in points), friction=FRICTION),),
        open_sides=("x-", "x+"),
        duration=26.0,
        frame_dt=0.5,
    )


def stopping_place() -> float:
    """x [m] where a block from the middle of the release rests: what it slides on bears its centrifugal force too.

    v dv/ds = g (sin t - mu cos t) - mu v^2 / R on the arc, for w = v^2 there A sin t + B cos t and what decays with
    exp(-2 mu) over a radian.
    """
    along, lift = RADIUS * np.tan(0.5 * SLOPE), 2.0 * RADIUS * 9.81
    straight = (FOOT - 25.0) / np.cos(SLOPE) - along
    begin = 2.0 * 9.81 * (np.sin(SLOPE) - FRICTION * np.cos(SLOPE)) * straight
    sine, cosine = lift * np.array([3.0 * FRICTION, 1.0 - 2.0 * FRICTION**2]) / (1.0 + 4.0 * FRICTION**2)
    left = (begin - sine * np.sin(SLOPE) - cosine * np.cos(SLOPE)) * np.exp(-2.0 * FRICTION * SLOPE)
    return float(FOOT + along + (cosine + left) / (2.0 * FRICTION * 9.81))


@pytest.mark.slow
def test_a_thin_fast_flow_does_not_depend_on_young() -> None:
    """Front and greatest mean speed over a factor of ten around the default; it rests where a block does."""
    scene = mountainside()
    default = scene.material.modulus
    assert default == pytest.approx(2000.0 * greatest_speed(scene) ** 2)
    factors = (10.0**-0.5, 1.0, 10.0**0.5)
    scenes = [
        dataclasses.replace(scene, material=dataclasses.replace(scene.material, young=factor * default))
        for factor in factors
    ]
    flows = simulate_many(scenes, record=Recording(fields=True))
    runs = np.array([flow.summary["front"] - 40.0 for flow in flows])
    speeds = np.array([np.linalg.norm(flow.velocities, axis=-1).mean(axis=1).max() for flow in flows])
    assert np.ptp(runs) < 0.03 * runs.mean()
    assert np.ptp(speeds) < 0.03 * speeds.mean()
    assert 0.8 * greatest_speed(scene) < speeds.mean() < greatest_speed(scene)
    middles = np.array([flow.positions[-1, :, 0].mean() for flow in flows])
    np.testing.assert_allclose(middles - 25.0, stopping_place() - 25.0, rtol=0.01)
    assert [flow.summary["step_limit"] for flow in flows] == ["flow", "waves", "waves"]


def test_it_is_said_what_sets_the_step() -> None:
    """Waves, or a flow faster than 1.5 times these; both before it runs and in its summary."""
    slow = box(Mass(lower=(0.4, 0.4), size=(0.1, 0.1)), duration=0.01, gravity=0.0)
    thrown = dataclasses.replace(slow.masses[0], velocity=(90.0, 0.0))
    fast = dataclasses.replace(slow, masses=(thrown,), material=dataclasses.replace(slow.material, young=2.0e6))
    flow, waves = simulate(fast), simulate(slow)
    assert (waves.summary["step_limit"], flow.summary["step_limit"]) == ("waves", "flow")
    assert flow.summary["wave_speed"] == pytest.approx(fast.material.wave_speed)
    assert "by the flow where it is faster than 58 m/s: it may reach 90 m/s" in step_spoken(fast)
    assert "flow" not in step_spoken(slow)
    stiff = box(material=dataclasses.replace(slow.material, young=2.0e8))
    assert "young = 2e+08 Pa; 180000 Pa would do, in 0.03 of the steps" in step_spoken(stiff)
