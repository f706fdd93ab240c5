"""python -m mpm.generate DEFINITION --out DIR: simulate a dataset, one process per scene at a time."""

import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import reduce
from itertools import islice
from multiprocessing import get_context
from operator import add
from pathlib import Path
from types import FrameType

import numpy as np
from tqdm import tqdm

from datasets.command_line import WorkFailed, disk_failed, run
from datasets.definitions import read_definition
from datasets.definitions.definition import Definition, Entry, Split, Storage
from datasets.errors import InputError
from datasets.files import remove_own_parts, write_json
from datasets.frames import HDF5 as SUFFIX
from datasets.lock import locked
from datasets.particles import mass_counts
from datasets.processes import end_with_parent, processors
from datasets.scene import Scene
from datasets.training.metadata import metadata
from datasets.training.statistics import MotionStatistics, motion_statistics
from datasets.training.thinning import thin
from datasets.trajectory import Trajectory, stored_scene, trajectory_files

GRACE = 0.5
"""Seconds to wait for a signal of one's own when a process was killed: a batch system sends it to all of a job."""
POLL = 2.0
"""Seconds after which one looks whether anybody works."""
TIMINGS = ("wall_s", "compile_s")
"""Keys of a summary that differ from run to run; the files of a dataset must not."""


def command(
    definition: str,
    /,
    *,
    out: Path,
    count: int | None = None,
    seed: int = 0,
    jobs: int | None = None,
    scheduler: str | None = None,
    compress: bool = False,
) -> None:
    """Simulate the trajectories of a dataset definition with the MPM.

    Running the same command again finishes what is missing. The files are the same for the same seed, whatever the
    number of jobs.

    Parameters
    ----------
    definition
        flow2d, columns2d, obstacle3d, baffles3d, paper2d, paper3d, or the path of a definition in TOML.
    out
        Folder of the dataset: train, valid, test, metadata.json, generation.json.
    count
        How many trajectories, the first ones of the definition; all of them unless given.
    seed
        Seed of the dataset.
    jobs
        Processes that simulate; one per processor unless given.
    scheduler
        Address of a Dask scheduler, such as tcp://10.0.0.1:8786, or its JSON file, whose workers simulate instead;
        they need this version of Talus and the folder OUT in the same place.
    compress
        Write HDF5 of a quarter of the size, positions to a part of a cell, which are read more slowly.
    """
    if scheduler is not None and jobs is not None:
        raise InputError("expected none with --scheduler, whose workers are the jobs", key="--jobs")
    generate(
        read_definition(definition),
        out,
        seed=seed,
        count=count,
        jobs=processors() if jobs is None else jobs,
        scheduler=scheduler,
        suffix=SUFFIX if compress else ".npz",
    )


def generate(
    definition: Definition,
    out: Path,
    *,
    seed: int,
    count: int | None,
    jobs: int,
    scheduler: str | None = None,
    suffix: str = ".npz",
) -> None:
    """Simulate what is missing of a dataset in `out`, then describe it in `metadata.json`.

    In `jobs` processes, or by the workers of the Dask scheduler at an address. Raises InputError where `out` holds
    other trajectories than these, WorkFailed where a simulation fails.
    """
    if jobs < 1:
        raise InputError(f"expected at least 1 job, got {jobs}", key="jobs")
    start = time.perf_counter()
    entries = definition.entries(seed=seed, count=count)
    if len({entry.scene.frame_dt for entry in entries}) > 1:
        raise InputError(f"expected the same time between frames in all scenes of {definition.name}", key="frame_dt")
    with locked(out), pool(jobs) if scheduler is None else cluster(scheduler) as workers:
        missing = missing_entries(entries, out, suffix)
        simulate_all(workers, missing, out, total=len(entries), storage=definition.storage, suffix=suffix)
        train = [trajectory_path(entry, out, suffix) for entry in entries if entry.split is Split.TRAIN]
        statistics = statistics_of(workers.executor, train)
        write_json(out / "metadata.json", metadata(definition, entries, seed=seed, statistics=statistics))
        write_json(
            out / "generation.json",
            {
                "simulated": len(missing),
                "kept": len(entries) - len(missing),
                "jobs": workers.width(),
                "wall_s": time.perf_counter() - start,
            },
        )


@dataclass(frozen=True, kw_only=True)
class Workers:
    """Who simulates."""

    executor: Executor
    width: Callable[[], int]
    """How many trajectories to hand out at a time."""
    check: Callable[[], None] = lambda: None
    """Raises WorkFailed where nobody is left to work."""


def trajectory_path(entry: Entry, out: Path, suffix: str = ".npz") -> Path:
    """The file of a trajectory in the dataset folder `out`."""
    return out / entry.split.value / f"{entry.name}{suffix}"


def missing_entries(entries: Iterable[Entry], out: Path, suffix: str = ".npz") -> list[Entry]:
    """The entries without a file. Raises InputError for a file that is not of this dataset: nothing is overwritten."""
    required = {trajectory_path(entry, out, suffix): entry for entry in entries}
    found = {path: None for split in Split for path in trajectory_files(out / split.value)}
    for path in found:
        if path not in required:
            if path.suffix != suffix and path.with_suffix(suffix) in required:
                other = "with" if path.suffix == SUFFIX else "without"
                raise InputError(f"expected {suffix}, the dataset was begun {other} --compress", where=str(path))
            raise InputError("expected no trajectory but those of this definition, seed and count", where=str(path))
        if stored_scene(path) != required[path].scene:
            raise InputError("expected the scene that this definition and seed give, found another", where=str(path))
    return [entry for path, entry in required.items() if path not in found]


def simulate_all(
    workers: Workers,
    entries: list[Entry],
    out: Path,
    *,
    total: int,
    storage: Storage | None = None,
    suffix: str = ".npz",
) -> None:
    """Simulate `entries`, of `total` in the dataset. A failed one does not stop the others; WorkFailed names it.

    Raises OSError where the disk is full or read-only: the others would fail too.
    """
    waiting = iter(entries)
    running: dict[Future[None], str] = {}
    failures = []
    with tqdm(total=total, initial=total - len(entries), unit="trajectory", dynamic_ncols=True) as bar:
        while True:
            # No more than the processes can take: what an executor has queued it cannot give back on Ctrl-C.
            for entry in islice(waiting, max(0, workers.width() - len(running))):
                task = workers.executor.submit(simulate_one, entry.scene, trajectory_path(entry, out, suffix), storage)
                running[task] = entry.name
            if not running:
                break
            ended = wait(running, timeout=POLL, return_when=FIRST_COMPLETED).done
            if not ended:
                workers.check()
            for future in ended:
                name = running.pop(future)
                try:
                    future.result()
                except BrokenProcessPool:
                    raise
                except CancelledError:
                    workers.check()
                    raise WorkFailed("the scheduler has gone; what was finished is kept") from None
                except Exception as error:  # whatever goes wrong in one scene, the others are kept
                    if disk_failed(error):
                        raise
                    failures.append(f"{name} ({type(error).__name__}: {error})")
                bar.update()
    if failures:
        raise WorkFailed(f"{len(failures)} of {len(entries)} trajectories failed, first {min(failures)}")


def simulate_one(scene: Scene, path: Path, storage: Storage | None = None) -> None:
    """Simulate `scene` and save its trajectory, or what `storage` says of it, to `path`; in a process of the pool."""
    # Taichi belongs to the processes that simulate: the one that directs them does not import it.
    from mpm import Recording, simulate

    trajectory = simulate(scene, precision="f32", threads=1, record=Recording(until_rest=storage is not None))
    if storage is not None:
        trajectory = thinned(trajectory, storage)
    summary = {key: value for key, value in trajectory.summary.items() if key not in TIMINGS}
    replace(trajectory, summary=summary).save(path)


def thinned(trajectory: Trajectory, storage: Storage) -> Trajectory:
    """Some of the particles of a trajectory of the MPM, each with the volume of those that it stands for."""
    scene = trajectory.scene
    stay = thin(
        trajectory.positions[0],
        trajectory.volumes,
        cell=storage.cell,
        kept=storage.kept,
        rng=np.random.default_rng(scene.seed),
    )
    mass = np.repeat(np.arange(len(scene.masses)), mass_counts(scene))
    return replace(
        trajectory,
        positions=trajectory.positions[:, stay.indices],
        velocity0=trajectory.velocity0[stay.indices],
        friction=trajectory.friction[stay.indices],
        volume=stay.volumes,
        mass=mass[stay.indices].astype(np.int32),
    )


def statistics_of(executor: Executor, paths: Sequence[Path]) -> MotionStatistics:
    """The statistics of all trajectories together, added in their order whoever is ready first."""
    each = executor.map(statistics_of_one, paths)
    bar: Iterable[MotionStatistics] = tqdm(
        each, total=len(paths), desc="statistics", unit="trajectory", dynamic_ncols=True
    )
    return reduce(add, bar)


def statistics_of_one(path: Path) -> MotionStatistics:
    """The statistics of the trajectory at `path`; runs in a process of the pool."""
    trajectory = Trajectory.load(path)
    return motion_statistics(trajectory.positions, trajectory.frame_dt)


@contextmanager
def pool(jobs: int) -> Iterator[Workers]:
    """`jobs` processes started afresh. When the block ends early they finish their present scene and begin no other."""
    executor = ProcessPoolExecutor(max_workers=jobs, mp_context=get_context("spawn"), initializer=begin_worker)
    try:
        yield Workers(executor=executor, width=lambda: jobs)
    except BrokenProcessPool:
        time.sleep(GRACE)
        raise WorkFailed("a process was killed, perhaps for want of memory; try fewer jobs") from None
    finally:
        executor.shutdown(cancel_futures=True)


def begin_worker() -> None:
    """Make a process of the pool end with its director, who alone answers a Ctrl-C: it goes to the whole terminal.

    A batch system's SIGTERM goes to all; whoever gets it leaves no unfinished file.
    """
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, leave)


def leave(number: int, _: FrameType | None) -> None:
    """End this process by the signal `number`."""
    remove_own_parts()
    signal.signal(number, signal.SIG_DFL)
    signal.raise_signal(number)


@contextmanager
def cluster(address: str) -> Iterator[Workers]:
    """The workers of a Dask scheduler, which share this folder. Raises InputError."""
    from mpm.cluster import connected

    with connected(address) as found:
        yield Workers(executor=found.executor, width=lambda: found.width, check=found.check)


if __name__ == "__main__":
    sys.exit(run(command, "python -m mpm.generate"))
