"""MPM runs that stay: each is a file, and a scene that was run before is read instead of run again."""

import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from datasets.command_line import WorkFailed
from datasets.errors import InputError
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from inverse.forward.interface import Simulate
from mpm import ScenesFailed
from mpm.output.request import ALL, LAST, Recording
from mpm.process import processors

SHARE = "share_s"
"""In the summary of a kept run: its share of the wall time of all that ran beside it [s]."""


class KeptRuns:
    """`simulate`, with every run kept as `FOLDER/PREFIXNN.npz`: what was finished before a kill is not done again.

    deposit_only: the last frame alone is recorded, a hundredth of the file and all that an observation needs.
    """

    def __init__(self, folder: Path, simulate: Simulate, *, prefix: str = "", deposit_only: bool = False) -> None:
        self.folder, self.simulate, self.prefix, self.deposit_only = folder, simulate, prefix, deposit_only
        self.files: dict[Scene, Path] = {}
        for path in sorted(folder.glob(f"{prefix}[0-9]*.npz")):
            try:
                self.files[Trajectory.load(path).scene] = path
            except InputError:
                continue  # Not one of ours, or from another version: run again, under the next number.

    def __call__(self, scenes: Sequence[Scene], /, *, record: Recording = ALL) -> list[Trajectory]:
        """The trajectory of each scene, as it is kept; those that are not there yet run side by side, some at a time.

        Where some of them fail, the others are kept before ScenesFailed is raised.
        """
        missing = [scene for scene in dict.fromkeys(scenes) if scene not in self.files]
        at_once = 2 * processors()
        with tqdm(total=len(missing), desc="MPM", unit="run", leave=False, disable=None) as bar:
            for first in range(0, len(missing), at_once):
                self._run(missing[first : first + at_once])
                bar.update(min(at_once, len(missing) - first))
        return [Trajectory.load(self.files[scene]) for scene in scenes]

    def _run(self, scenes: Sequence[Scene]) -> None:
        began = time.perf_counter()
        outcomes: Sequence[Trajectory | WorkFailed]
        failed: ScenesFailed | None = None
        try:
            outcomes = self.simulate(scenes, record=LAST if self.deposit_only else ALL)
        except ScenesFailed as error:
            failed, outcomes = error, error.outcomes
        share = (time.perf_counter() - began) / len(scenes)
        for scene, trajectory in zip(scenes, outcomes, strict=True):
            if isinstance(trajectory, Trajectory):
                path = self._free()
                dataclasses.replace(trajectory, summary=trajectory.summary | {SHARE: share}).save(path)
                self.files[scene] = path
        if failed is not None:
            raise failed

    def file(self, scene: Scene) -> Path:
        """Where the run of `scene` lies."""
        return self.files[scene]

    def _free(self) -> Path:
        taken = {path.name for path in self.folder.glob(f"{self.prefix}[0-9]*.npz")}
        number = 1
        while f"{self.prefix}{number:02d}.npz" in taken:
            number += 1
        return self.folder / f"{self.prefix}{number:02d}.npz"
