"""Stored MPM runs: what has been run with the same options is read, everything else is run."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datasets import Mass, Scene, Trajectory
from datasets.errors import WorkFailed
from mpm import ALL, AT_REST, LAST, Recording, ScenesFailed
from tests.scenes import scene_of
from tests.validation.loop.flows import FakeMpm
from validation import run_store
from validation.run_store import SHARE, Run, RunStore

SCENE = scene_of(Mass(lower=(0.0, 0.0), size=(0.4, 0.2)), cell=0.01)


class Fragile(FakeMpm):
    """Fails at one jitter seed."""

    def __call__(self, scenes: Sequence[Scene], /, *, record: Recording = ALL) -> list[Trajectory]:
        flows = super().__call__(scenes, record=record)
        outcomes = [WorkFailed("it blew up") if flow.scene.seed == 2 else flow for flow in flows]
        if any(isinstance(outcome, WorkFailed) for outcome in outcomes):
            raise ScenesFailed(outcomes)
        return flows


def test_survivors_of_a_failure_are_stored(tmp_path: Path) -> None:
    scenes = [replace(SCENE, seed=seed) for seed in (1, 2, 3)]
    mpm = Fragile()
    with pytest.raises(ScenesFailed, match="scene 1 of 3 failed: it blew up"):
        RunStore(tmp_path, mpm, label="ensemble-")(scenes, record=LAST)
    again = RunStore(tmp_path, mpm)
    flows = again([scenes[0], scenes[2], scenes[0]], record=LAST)
    assert [flow.scene.seed for flow in flows] == [1, 3, 1]
    assert [scene.seed for scene in mpm.scenes] == [1, 2, 3]
    np.testing.assert_array_equal([flow.time for flow in flows], [[1.0]] * 3)
    assert again.path(Run(scene=flows[1].scene)).name.startswith("ensemble-02-")


def test_what_is_returned_is_what_is_stored(tmp_path: Path) -> None:
    store = RunStore(tmp_path, FakeMpm(scatter=0.01))
    (first,), (second,) = store([SCENE]), store([SCENE])
    assert first.summary == second.summary
    assert first.summary[SHARE] >= 0.0
    assert first.scene == second.scene
    for name in ("positions", "time", "velocity0", "friction"):
        one, other = getattr(first, name), getattr(second, name)
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)


def test_other_options_versions_and_broken_files_are_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mpm = FakeMpm()
    store = RunStore(tmp_path, mpm)
    store([SCENE])
    (last,) = store([SCENE], record=LAST)
    assert len(mpm.scenes) == 2
    assert len(last.time) == 1
    base = Run(scene=SCENE)
    changes = {"precision": "f64"}, {"record": AT_REST}, {"record": ALL}, {"scene": replace(SCENE, duration=0.5)}
    assert len({run.digest for run in (base, *(replace(base, **change) for change in changes))}) == 5
    store.path(base).write_bytes(b"no archive")
    store([SCENE], record=LAST)
    assert len(mpm.scenes) == 3
    assert len(list(tmp_path.iterdir())) == 2
    monkeypatch.setattr(run_store, "__version__", "another")
    store([SCENE])
    assert len(mpm.scenes) == 4
