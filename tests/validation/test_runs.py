"""Kept runs: what succeeded beside a scene that failed is not done again."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from datasets.command_line import WorkFailed
from datasets.material import Material
from datasets.scene import Domain, Mass, Scene
from datasets.trajectory import Trajectory
from mpm import ScenesFailed
from mpm.output.request import ALL, Recording
from tests.validation.conftest import FakeMpm
from validation.loop.runs import KeptRuns

SCENE = Scene(
    domain=Domain(size=(1.0, 1.0), cell=0.01),
    material=Material(friction_deg=30.0),
    masses=(Mass(lower=(0.0, 0.0), size=(0.4, 0.2)),),
)


class Fragile(FakeMpm):
    """Fails at one jitter seed."""

    def __call__(self, scenes: Sequence[Scene], /, *, record: Recording = ALL) -> list[Trajectory]:
        flows = super().__call__(scenes, record=record)
        outcomes = [WorkFailed("it blew up") if flow.scene.seed == 2 else flow for flow in flows]
        if any(isinstance(outcome, WorkFailed) for outcome in outcomes):
            raise ScenesFailed(outcomes)
        return flows


def test_survivors_are_kept(tmp_path: Path) -> None:
    scenes = [dataclasses.replace(SCENE, seed=seed) for seed in (1, 2, 3)]
    mpm = Fragile()
    runs = KeptRuns(tmp_path, mpm, deposit_only=True)
    with pytest.raises(ScenesFailed, match="scene 1 of 3 failed: it blew up"):
        runs(scenes)
    assert len(list(tmp_path.iterdir())) == 2
    again = KeptRuns(tmp_path, mpm, deposit_only=True)
    kept = again([scenes[0], scenes[2]])
    assert [flow.scene.seed for flow in kept] == [1, 3]
    assert [scene.seed for scene in mpm.scenes] == [1, 2, 3]
    np.testing.assert_array_equal([flow.time for flow in kept], [[1.0], [1.0]])
