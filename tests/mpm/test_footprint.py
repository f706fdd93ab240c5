"""What a run will take, what sets its step, and the cheapest resolution that keeps a tolerance."""

import dataclasses
import math

import numpy as np
import pytest

from datasets import Domain, Mass, Material, Scene, Solid, read_scene
from datasets.geometry.placement import connected, corners
from datasets.scene.stiffness import greatest_speed
from mpm import ALL, LAST, WITH_FIELDS, Recording, simulate, simulate_many
from mpm.arrays.batch import Batch
from mpm.arrays.layout import Precision, node_room
from mpm.footprint import PROCESS, SPEED, expected, footprint, planned, step_spoken
from mpm.resolution import (
    MeasuredResolution,
    Resolution,
    characteristic_length,
    fitted_cell,
    read_measured,
    read_tolerance,
    resolved,
)
from tests.refusals import refused
from tests.scenes import box, scene_of

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
FOOT = 260.0  # x of the foot [m], where the slope of 300 m would meet the level without the arc between


def mountainside() -> Scene:
    """1.5 m on a path of 300 m at 30 degrees, then an arc and the level; bed friction 0.3, cells of 0.75 m."""
    along = RADIUS * np.tan(0.5 * SLOPE)
    angles = SLOPE - np.linspace(0.0, SLOPE, 17)
    arc = [(FOOT + along - RADIUS * np.sin(angle), 5.0 + RADIUS * (1.0 - np.cos(angle))) for angle in angles.tolist()]
    points = ((0.0, 5.0 + FOOT * np.tan(SLOPE)), *arc, (END, 5.0))
    ground = Solid(kind="terrain", points=tuple((float(x), float(y)) for x, y in points), friction=FRICTION)
    layer = Mass(kind="layer", thickness=1.5, outline=((10.0,), (40.0,)))
    soil = Material(friction_deg=30.0, density=2000.0)
    settings = {"size": (END, 162.0), "cell": 0.75, "open_sides": ("x-", "x+"), "duration": 26.0, "frame_dt": 0.5}
    return scene_of(layer, material=soil, solids=(ground,), **settings)


def stopping_place() -> float:
    """x [m] where a block from the middle of the release rests: what it slides on bears its centrifugal force too.

    v dv/ds = g (sin t - mu cos t) - mu v^2 / R on the arc, for w = v^2 there A sin t + B cos t and what decays with
    exp(-2 mu) over a radian."""
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
    soils = [dataclasses.replace(scene.material, young=factor * default) for factor in factors]
    scenes = [dataclasses.replace(scene, material=soil) for soil in soils]
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
    for speed in (0.0, 20.0):
        body = dataclasses.replace(slow.masses[0], velocity=(speed, 0.0))
        steps = simulate(dataclasses.replace(slow, step_fraction=1.0, masses=(body,))).summary["steps"]
        assert steps == 2 * math.ceil(0.005 / 0.02 * (slow.material.wave_speed + speed))
    assert flow.summary["wave_speed"] == pytest.approx(fast.material.wave_speed)
    assert "by the flow where it is faster than 58 m/s: it may reach 90 m/s" in step_spoken(fast)
    assert "flow" not in step_spoken(slow)
    stiff = box(material=dataclasses.replace(slow.material, young=2.0e8))
    assert "young = 2e+08 Pa; 180000 Pa would do, in 0.03 of the steps" in step_spoken(stiff)


def boxes(*masses: tuple[tuple[float, ...], tuple[float, ...]], size: tuple[float, ...] = (1.0, 1.0)) -> Scene:
    """Masses given as (lower, size) in a box of cells of 0.01 m."""
    return scene_of(*(Mass(lower=lower, size=extent) for lower, extent in masses), size=size, cell=0.01)


SQUARE = boxes(((0.0, 0.0), (0.2, 0.4)))


def measured(cells: float, promised: float, cost: float, *, dimension: int = 2, points: int = 2) -> MeasuredResolution:
    what = Resolution(cells=cells, particles_per_axis=points, step_fraction=0.9, precision="f32")
    errors = {"expected": 0.5 * promised, "promised": promised, "thickness": promised}
    return MeasuredResolution(dimension=dimension, resolution=what, particle_steps=1.0e6 * cost, **errors)


@pytest.mark.parametrize(("text", "value"), [("2%", 0.02), (" 2.5 % ", 0.025), ("0.02", 0.02), ("1e-2", 0.01)])
def test_a_tolerance_is_a_percentage_or_a_fraction(text: str, value: float) -> None:
    assert read_tolerance(text) == pytest.approx(value)
    for wrong in ("2", "0", "-1%", "100%", "two", "", "%", "nan", "inf%"):
        assert refused(read_tolerance, wrong, said="expected a percentage such as 2%").key == "--tolerance"


def test_the_cheapest_within_the_tolerance_is_picked() -> None:
    rows = (10, 0.06, 1.0), (20, 0.03, 8.0), (40, 0.015, 64.0)
    measurements = [*(measured(*row) for row in rows), measured(15, 0.028, 9.0, points=3)]
    assert resolved(SQUARE, 0.05, measurements).cells == 20.0
    assert resolved(SQUARE, 0.029, measurements).scene.particles_per_axis == 3
    assert resolved(SQUARE, 0.015, measurements).cells == 40.0


def test_a_tolerance_below_the_best_is_refused_with_the_best() -> None:
    measurements = [measured(10, 0.06, 1.0), measured(40, 0.021, 64.0), measured(10, 0.001, 1.0, dimension=3)]
    refused(resolved, SQUARE, 0.02, measurements, said="--tolerance: expected at least 2.1% in 2D")


@pytest.mark.parametrize("lengths", [(1.0, 1.0), (1.81, 0.83), (0.96, 0.36)])
@pytest.mark.parametrize("largest", [0.07, 0.01, 0.004])
def test_a_cell_divides_every_side_of_the_box(lengths: tuple[float, ...], largest: float) -> None:
    cell = fitted_cell(Domain(size=lengths, cell=0.01), largest)
    assert cell <= largest * (1.0 + 1e-9)
    # Scenes on other grids are refused.
    masses = (Mass(lower=(0.0, 0.0), size=(0.2, 0.2)),)
    dataclasses.replace(SQUARE, domain=Domain(size=lengths, cell=cell), masses=masses)


def test_masses_that_touch_are_one_body_and_a_side_from_wall_to_wall_does_not_count() -> None:
    layers = boxes(*(((0.0, 0.028 * n), (0.35, 0.028)) for n in range(10)))
    assert characteristic_length(layers) == pytest.approx(0.28)
    # The last joins two groups that did not touch before.
    joined = boxes(((0.0, 0.0), (0.1, 0.1)), ((0.3, 0.0), (0.1, 0.1)), ((0.1, 0.0), (0.2, 0.1)))
    for masses, count in ((joined.masses, 1), (joined.masses[:2], 2)):
        assert len(np.unique(connected(*corners(masses)))) == count
    thin = boxes(((0.0, 0.0, 0.0), (0.4, 0.2, 0.05)), size=(1.0, 1.0, 0.05))
    assert characteristic_length(thin) == pytest.approx(0.2)
    assert characteristic_length(boxes(((0.0, 0.0), (1.0, 0.3)))) == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("name", "dimension"), [("column-tall-21", 2), ("layers-10", 2), ("baffles-2", 3), ("baffles-5", 3)]
)
def test_what_ships_resolves_every_shipped_kind_of_scene(name: str, dimension: int) -> None:
    measurements = [measurement for measurement in read_measured() if measurement.dimension == dimension]
    loosest, tightest = (pick(measurement.promised for measurement in measurements) for pick in (max, min))
    loose, tight = (resolved(read_scene(name), tolerance) for tolerance in (loosest, 1.2 * tightest))
    assert loose.scene.dimension == dimension
    assert tight.measured.promised <= 1.2 * tightest
    assert tight.cost > loose.cost
    assert tight.scene.domain.cell < loose.scene.domain.cell
