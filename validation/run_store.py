"""MPM runs stored on disk: each is a file identified by its inputs, so that an interrupted command can resume.

A file is a trajectory (`datasets.flow.trajectory`), `LABELnn-DIGEST.npz`: the digest is that of the scene, the options
of the run and the version of this package.
"""

import dataclasses
import hashlib
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory

from tqdm import tqdm

from datasets import __version__
from datasets.errors import InputError, WorkFailed
from datasets.flow.trajectory import Trajectory
from datasets.lock import locked
from datasets.processes import processors
from datasets.scene import Scene
from datasets.scene.particles import particle_count
from mpm import ALL, LAST, Recording, ScenesFailed, simulate_many
from mpm.arrays.features import features_of
from mpm.arrays.layout import Precision
from mpm.resolution import particle_steps
from mpm.simulation import LARGE

SHARE = "share_s"
"""In the summary of a stored run: its share of the wall time of all parallel runs, without compilation [s]."""

WATER = "pore_pressure"  # a key of recordings that was added later


@dataclass(frozen=True, kw_only=True)
class Run:
    """A requested run."""

    scene: Scene
    precision: Precision = "f32"
    record: Recording = LAST  # what is recorded: by default the last frame, a hundredth of the whole file

    @property
    def digest(self) -> str:
        """Digest of all inputs. Keys at their default are left out, so that new keys do not change it."""
        scene = [
            (field.name, getattr(self.scene, field.name))
            for field in dataclasses.fields(self.scene)
            if getattr(self.scene, field.name) != field.default
        ]
        record = [(field.name, getattr(self.record, field.name)) for field in dataclasses.fields(self.record)]
        # Runs without fields keep their existing names on disk.
        record = [(key, value or [] if key == "fields" else value) for key, value in record if key != WATER or value]
        text = repr((__version__, sorted(scene), record, self.precision))
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    @property
    def kernel(self) -> tuple[bool, str, str]:
        """The recording and the kernel that it needs; large runs, which use all threads, sort last."""
        features = features_of([self.scene], self.precision, record=self.record)
        return particle_count(self.scene) >= LARGE, repr(self.record), repr(features)


@contextmanager
def kept(folder: Path | str | None) -> Iterator[Path]:
    """The folder of finished work, locked for this process, or a temporary folder."""
    with TemporaryDirectory() if folder is None else locked(Path(folder)) as place:
        yield Path(place)


def caveats(flows: Sequence[Trajectory]) -> list[str]:
    """One line with the caveats in the summaries of flows, if there are any."""
    said = [line for flow in flows for line in flow.summary.get("remarks", [])[:1]]
    return [f"{len(said)} of {len(flows)} flows, such as: {said[0]}"] if said else []


class RunStore:
    """The MPM with every run stored in `folder`. Called with scenes, it replaces `mpm.simulate_many`."""

    def __init__(
        self,
        folder: Path,
        simulate: Callable[..., list[Trajectory]] = simulate_many,
        *,
        label: str = "",
        reduce: Callable[[Trajectory], Trajectory] = lambda flow: flow,
    ) -> None:
        """label: prefix of the names of new files, before their number; reduce: flow -> the part that is stored."""
        self.folder, self.simulate, self.label, self.reduce = folder, simulate, label, reduce
        self.width: Callable[[], int] = getattr(simulate, "width", lambda: 2 * processors())
        """The number of runs started at a time."""

    def __call__(self, scenes: Sequence[Scene], /, *, record: Recording = ALL) -> list[Trajectory]:
        """The trajectory of each scene; errors as in `run`."""
        return self.run([Run(scene=scene, record=record) for scene in scenes])

    def run(self, runs: Sequence[Run]) -> list[Trajectory]:
        """The trajectory of each of `runs`; missing ones are computed first, some in parallel. Runs that need the same
        kernel follow each other, cheap ones first. Raises ScenesFailed if some parallel runs fail, after the others are
        stored."""
        trajectories = {run: self._load(run) for run in dict.fromkeys(runs)}
        missing = [run for run, trajectory in trajectories.items() if trajectory is None]
        missing.sort(key=lambda run: (run.kernel, particle_steps(run.scene)))
        total = sum(particle_steps(run.scene) for run in missing)
        with tqdm(total=total, desc="MPM", unit="particle-step", unit_scale=True, leave=False, disable=None) as bar:
            for kernel, group in groupby(missing, key=lambda run: run.kernel):
                alike, size = list(group), 1 if kernel[0] else self.width()
                for first in range(0, len(alike), size):
                    batch = alike[first : first + size]
                    trajectories.update(zip(batch, self._make(batch), strict=True))
                    bar.update(sum(particle_steps(run.scene) for run in batch))
        return [trajectory for run in runs if (trajectory := trajectories[run]) is not None]

    def path(self, run: Run) -> Path:
        """The file of a run, which may not exist yet."""
        number = 1 + len(list(self.folder.glob(f"{self.label}[0-9]*.npz")))
        new = self.folder / f"{self.label}{number:02d}-{run.digest}.npz"
        return min(self.folder.glob(f"*-{run.digest}.npz"), default=new)

    def _load(self, run: Run) -> Trajectory | None:
        """The stored run; None if there is none or its file is broken."""
        try:
            return Trajectory.load(self.path(run))
        except InputError:
            return None

    def _make(self, batch: Sequence[Run]) -> list[Trajectory]:
        """Compute and store runs that differ only in their scenes."""
        began = time.perf_counter()
        chosen = {} if batch[0].precision == Run.precision else {"precision": batch[0].precision}
        failed: ScenesFailed | None = None
        outcomes: Sequence[Trajectory | WorkFailed]
        try:
            outcomes = self.simulate([run.scene for run in batch], record=batch[0].record, **chosen)
        except ScenesFailed as error:
            failed, outcomes = error, error.outcomes
        finished = [outcome for outcome in outcomes if isinstance(outcome, Trajectory)]
        compiled = max((float(flow.summary.get("compile_s", 0.0)) for flow in finished), default=0.0)
        share = (time.perf_counter() - began - compiled) / len(batch)
        stored = []
        for run, outcome in zip(batch, outcomes, strict=True):
            if isinstance(outcome, Trajectory):
                stored.append(self.reduce(dataclasses.replace(outcome, summary=outcome.summary | {SHARE: share})))
                stored[-1].save(self.path(run))
        if failed is not None:
            raise failed
        return stored
