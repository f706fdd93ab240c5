"""What a run will take, before it is allocated: its counts, the bytes of its arrays, a range of time."""

import dataclasses

import numpy as np
import pytest

from datasets import Scene, read_scene
from mpm import ALL, LAST, WITH_FIELDS, Recording, simulate
from mpm.arrays.batch import Batch
from mpm.arrays.layout import Precision, node_room
from mpm.footprint import FAST, PROCESS, SLOW, SPEED, START, expected, footprint, planned
from tests.refusals import refused

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
    found = expected(COLUMN, SPEED[2] * 120.0, memory=300 * 2**20, processors=2)
    assert found.shortest == pytest.approx(START[2][0] + 60.0 / FAST)
    assert found.longest == pytest.approx(START[2][1] + 60.0 / SLOW)
    assert str(found) == "expected: 0.6 to 2.6 min, 300 MiB of memory"
    more = expected(COLUMN, SPEED[2] * 120.0, memory=0, processors=2, after=600.0)
    assert more.shortest == pytest.approx(found.shortest + 600.0)
    work = 1.0e10
    column, baffles = (expected(scene, work, memory=0).longest for scene in (COLUMN, BAFFLES))
    bare = expected(dataclasses.replace(BAFFLES, baffles=()), work, memory=0).longest
    assert column < bare < baffles
    assert expected(COLUMN, work, memory=0, precision="f64").longest > column
    assert expected(COLUMN, work, memory=0, arch="cuda").longest < column / 5.0
    rests = expected(COLUMN, work, memory=0, until_rest=True)
    assert (rests.longest, rests.shortest < 0.6 * expected(COLUMN, work, memory=0).shortest) == (column, True)
