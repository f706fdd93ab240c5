"""Frames that are kept on disk while a run goes on are those that memory would hold."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from datasets.errors import InputError
from mpm import AT_REST, LAST, WITH_FIELDS, Recording, simulate
from mpm.arrays.batch import Batch
from mpm.arrays.layout import FRAMES_PER_CALL
from mpm.footprint import footprint
from mpm.simulation import simulate_each, simulate_resumably
from tests.mpm.scenes import box

FLOW = box(duration=0.28)


@pytest.mark.parametrize(
    "record",
    [Recording(), LAST, AT_REST, Recording(frames=3), Recording(frames=50), Recording(until_rest=True)],
    ids=["all", "last", "at rest", "every third", "fewer than calls", "all until rest"],
)
def test_a_streamed_run_is_the_same_to_the_bit(tmp_path: Path, record: Recording) -> None:
    scene = dataclasses.replace(FLOW, duration=0.6) if record.until_rest else FLOW
    assert scene.frames > 2 * FRAMES_PER_CALL
    whole, streamed = simulate(scene, record=record), simulate(scene, record=record, stream=tmp_path)
    np.testing.assert_array_equal(streamed.positions, whole.positions)
    np.testing.assert_array_equal(streamed.time, whole.time)
    costs = ("wall_s", "compile_s")
    assert {k: v for k, v in streamed.summary.items() if k not in costs} == {
        k: v for k, v in whole.summary.items() if k not in costs
    }
    assert list(tmp_path.iterdir()) == []


def test_it_goes_on_from_a_checkpoint(tmp_path: Path) -> None:
    _, checkpoint = simulate_resumably(dataclasses.replace(FLOW, duration=0.13), stream=tmp_path)
    longer = simulate(FLOW, resume=checkpoint, stream=tmp_path)
    np.testing.assert_array_equal(longer.positions, simulate(FLOW).positions)


def test_memory_holds_the_frames_of_a_call(tmp_path: Path) -> None:
    whole = Batch([FLOW], precision="f32")
    streamed = Batch([FLOW], precision="f32", stream=tmp_path)
    assert whole.positions.size == FLOW.frames * len(whole.particles[0].positions) * 2
    assert streamed.positions.size == FRAMES_PER_CALL * len(whole.particles[0].positions) * 2
    plan, kept = footprint(FLOW, stream=True), footprint(FLOW)
    assert plan.disk >= whole.positions.nbytes
    assert plan.bytes == kept.bytes - plan.disk
    assert "of frames on disk" in str(plan)
    assert "disk" not in str(kept)


def test_fields_and_other_scenes_beside_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="stream: expected positions alone"):
        simulate(FLOW, record=WITH_FIELDS, stream=tmp_path)
    with pytest.raises(InputError, match="stream: expected one scene"):
        simulate_each([FLOW, FLOW], stream=tmp_path)
