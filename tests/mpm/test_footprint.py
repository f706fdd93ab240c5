"""What a run will take, before it is allocated: counts are those of the run, bytes cover its arrays."""

import dataclasses

import numpy as np
import pytest

from datasets.errors import InputError
from datasets.library import read_scene
from datasets.scene import Scene
from mpm import ALL, LAST, WITH_FIELDS, Recording, simulate
from mpm.arrays.batch import Batch
from mpm.arrays.layout import Precision
from mpm.footprint import PROCESS, footprint


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
    assert np.prod(plan.nodes) * batch.features.node == batch.grid.size
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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"frame_dt": 1.0e4, "duration": 1.0e8}, "duration: expected at most 2147483647 steps"),
        ({"frame_dt": 1.0e-4, "duration": 900.0}, "of memory that are free, got .* fewer particles_per_axis or frames"),
    ],
)
def test_what_no_machine_could_run_is_refused_at_once(
    change: dict[str, float], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("datasets.memory.free", lambda: 2**36)
    scene: Scene = dataclasses.replace(read_scene("column-short-21"), **change)
    with pytest.raises(InputError, match=message):
        simulate(scene)


def test_numbers_that_single_precision_cannot_hold() -> None:
    scene = read_scene("column-short-21")
    thin = dataclasses.replace(scene, gravity=1e-45)
    with pytest.raises(InputError, match="gravity y of -1e-45; --precision f64 holds more"):
        simulate(thin)
