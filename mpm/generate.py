"""python -m mpm.generate DEFINITION --out DIR: simulate a dataset; each process runs one scene at a time."""

import sys
from collections.abc import Iterable
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from functools import reduce
from pathlib import Path

import numpy as np
from tqdm import tqdm

from datasets.command_line import disk_failed, run
from datasets.definitions import read_definition
from datasets.definitions.definition import DEPOSITS, Definition, Entry, Split, Storage
from datasets.definitions.training import MotionStatistics, metadata, motion_statistics, thin
from datasets.errors import InputError, WorkFailed, require
from datasets.files import write_json
from datasets.flow.trajectory import Trajectory, stored_scene, trajectory_files
from datasets.lock import locked
from datasets.processes import processors
from datasets.scene import Scene
from datasets.scene.particles import mass_counts
from mpm.cluster import QUEUED, Workers, connected, pool
from mpm.footprint import PROCESS, expected, planned

MOST_JOBS = 1000  # processes on one machine
TIMINGS = ("wall_s", "compile_s")  # keys of a summary that differ from run to run; a dataset leaves them out


def command(
    definition: str,
    /,
    *,
    out: Path,
    count: int | None = None,
    seed: int = 0,
    jobs: int | None = None,
    scheduler: str | None = None,
) -> None:
    """Simulate the trajectories of a dataset definition with the MPM.

    Running the same command again simulates the missing trajectories. The files depend on the seed, not on the number
    of jobs.

    Args:
        definition: flow2d, columns2d, obstacle3d, baffles3d, terrain3d, cohesive3d, paper2d, paper3d, or the path of a
            TOML file.
        out: Folder of the dataset: train, valid, test, metadata.json.
        count: Number of trajectories, the first ones of the definition; all unless given.
        seed: Seed of the dataset.
        jobs: Number of processes that simulate; one per processor unless given.
        scheduler: Address of a Dask scheduler, such as tcp://10.0.0.1:8786, or its JSON file. Its workers simulate
            instead; they need this version of Talus and the folder OUT at the same path."""
    require(scheduler is None or jobs is None, "--jobs", "none with --scheduler, whose workers are the jobs")
    jobs = processors() if jobs is None else jobs
    generate(read_definition(definition), out, seed=seed, count=count, jobs=jobs, scheduler=scheduler)


def generate(
    definition: Definition,
    out: Path,
    *,
    seed: int,
    count: int | None,
    jobs: int,
    scheduler: str | None = None,
    after: float = 0.0,
    beside: float = 0.0,
) -> None:
    """Simulate the missing trajectories of a dataset in `out`, then describe the dataset in `metadata.json`.

    Runs in `jobs` processes or on the workers of a Dask scheduler. Prints the expected time and memory, including the
    time `after` [s] and the memory `beside` [bytes] that the caller needs. Raises InputError if `out` holds
    trajectories of another dataset, WorkFailed if a simulation fails."""
    require(1 <= jobs <= MOST_JOBS, "jobs", f"at least 1 job and at most {MOST_JOBS} jobs", jobs)
    entries = definition.entries(seed=seed, count=count)
    # Each trajectory of an inversion is read in units of its own.
    alike = definition.storage is None or not definition.storage.deposit
    if alike and len({entry.scene.frame_dt for entry in entries}) > 1:
        raise InputError(f"expected the same time between frames in all scenes of {definition.name}", key="frame_dt")
    with locked(out), pool(jobs) if scheduler is None else connected(scheduler) as workers:
        missing = missing_entries(entries, out)
        if missing:
            until_rest = definition.storage is not None and not definition.storage.deposit
            processes = jobs if scheduler is None else max(1, workers.width() // QUEUED)
            work, size = planned([entry.scene for entry in missing])
            # The parent process does not load Taichi.
            size = PROCESS / 2 + beside + min(processes, len(missing)) * size
            first = missing[0].scene
            price = expected(first, work, memory=size, processors=processes, until_rest=until_rest, after=after)
            print(price, flush=True)
        simulate_all(workers, missing, out, total=len(entries), storage=definition.storage)
        paths = [(trajectory_path(entry, out),) for entry in entries if entry.split is Split.TRAIN]
        finished = workers.finished(statistics_of, paths)
        # The sum over all trajectories, in their order, whichever is ready first.
        by_number = dict(tqdm(finished, total=len(paths), desc="statistics", unit="trajectory", dynamic_ncols=True))
        statistics = reduce(MotionStatistics.__add__, (by_number[number] for number in range(len(paths))))
        write_json(out / "metadata.json", metadata(definition.name, entries, seed=seed, statistics=statistics))


def trajectory_path(entry: Entry, out: Path) -> Path:
    """The file of a trajectory in the dataset folder `out`."""
    return out / entry.split.value / f"{entry.name}.npz"


def missing_entries(entries: Iterable[Entry], out: Path) -> list[Entry]:
    """The entries without a file. Raises InputError for a file that is not of this dataset: nothing is overwritten."""
    required = {trajectory_path(entry, out): entry for entry in entries}
    present = {path: None for split in Split for path in trajectory_files(out / split.value)}
    for path in present:
        if path not in required:
            raise InputError("expected no trajectory but those of this definition, seed and count", where=str(path))
        if stored_scene(path) != required[path].scene:
            raise InputError("expected the scene that this definition and seed give, found another", where=str(path))
    return [entry for path, entry in required.items() if path not in present]


def simulate_all(workers: Workers, entries: list[Entry], out: Path, *, total: int, storage: Storage | None) -> None:
    """Simulate `entries`, of `total` in the dataset.

    A failed one does not stop the others; WorkFailed names it. Raises OSError where the disk is full or read-only: the
    others would fail too."""
    failures = []
    tasks = [(entry.scene, trajectory_path(entry, out), storage) for entry in entries]
    with tqdm(total=total, initial=total - len(entries), unit="trajectory", dynamic_ncols=True) as bar:
        for number, future in workers.completed(simulate_one, tasks):
            error = future.exception()
            if isinstance(error, BrokenProcessPool) or (error is not None and disk_failed(error)):
                raise error
            if error is not None:
                failures.append(f"{entries[number].name} ({type(error).__name__}: {error})")
            bar.update()
    if failures:
        raise WorkFailed(f"{len(failures)} of {len(entries)} trajectories failed, first {min(failures)}")


def simulate_one(scene: Scene, path: Path, storage: Storage | None = None) -> None:
    """Simulate `scene` in a process of the pool; save its trajectory, or the part that `storage` keeps, to `path`."""
    # Only the processes that simulate import Taichi; their parent does not.
    from mpm import Recording, simulate

    until_rest = storage is not None and not storage.deposit
    trajectory = simulate(scene, precision="f32", threads=1, record=Recording(until_rest=until_rest))
    summary = {key: value for key, value in trajectory.summary.items() if key not in TIMINGS}
    trajectory = replace(trajectory, summary=summary)
    if storage is not None:
        if storage.deposit:
            end, end_time = trajectory.positions[-1:], trajectory.time[-1:]
            deposit = replace(trajectory, positions=end, time=end_time, solid_impulse=None)
            deposit.save(path.parents[1] / DEPOSITS / path.name)
        trajectory = thinned(trajectory, storage)
    trajectory.save(path)


def thinned(trajectory: Trajectory, storage: Storage) -> Trajectory:
    """A subset of the particles of an MPM trajectory, each with the volume of the particles that it represents."""
    scene = trajectory.scene
    require(trajectory.entry_time is None, "storage", "all particles of a scene with inflow", "some")
    positions, rng = trajectory.positions, np.random.default_rng(scene.seed)
    stay, volumes = thin(positions[0], trajectory.volumes, cell=storage.cell, kept=storage.kept, rng=rng)
    mass = np.repeat(np.arange(len(scene.masses)), mass_counts(scene))
    return replace(
        trajectory,
        positions=positions[:, stay],
        velocity0=trajectory.velocity0[stay],
        friction=trajectory.friction[stay],
        volume=volumes,
        mass=mass[stay].astype(np.int32),
    )


def statistics_of(path: Path) -> MotionStatistics:
    """The statistics of the trajectory at `path`; runs in a process of the pool."""
    trajectory = Trajectory.load(path)
    return motion_statistics(trajectory.positions, trajectory.frame_dt)


if __name__ == "__main__":
    sys.exit(run(command, "python -m mpm.generate"))
