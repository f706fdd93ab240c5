"""python -m mpm.generate DEFINITION --out DIR: simulate a dataset, one process per scene at a time."""

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

MOST_JOBS = 1000  # processes of one machine
TIMINGS = ("wall_s", "compile_s")  # keys of a summary that differ from run to run; the files of a dataset must not


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

    Running the same command again finishes what is missing. The files are the same for the same seed, whatever the
    number of jobs.

    Args:
        definition: flow2d, columns2d, obstacle3d, baffles3d, terrain3d, paper2d, paper3d, or the path of one in TOML.
        out: Folder of the dataset: train, valid, test, metadata.json.
        count: How many trajectories, the first ones of the definition; all of them unless given.
        seed: Seed of the dataset.
        jobs: Processes that simulate; one per processor unless given.
        scheduler: Address of a Dask scheduler, such as tcp://10.0.0.1:8786, or its JSON file, whose workers simulate
            instead; they need this version of Talus and the folder OUT in the same place.
    """
    if scheduler is not None and jobs is not None:
        raise InputError("expected none with --scheduler, whose workers are the jobs", key="--jobs")
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
    """Simulate what is missing of a dataset in `out`, then describe it in `metadata.json`.

    In `jobs` processes, or by the workers of the Dask scheduler at an address. Prints what that will take, with `after`
    [s] of what its caller does next and `beside` [bytes] of what that holds. Raises InputError where `out` holds other
    trajectories than these, WorkFailed where a simulation fails.
    """
    require(1 <= jobs <= MOST_JOBS, "jobs", f"at least 1 job and at most {MOST_JOBS} jobs", jobs)
    entries = definition.entries(seed=seed, count=count)
    # Those of an inversion are read each in units of its own.
    alike = definition.storage is None or not definition.storage.deposit
    if alike and len({entry.scene.frame_dt for entry in entries}) > 1:
        raise InputError(f"expected the same time between frames in all scenes of {definition.name}", key="frame_dt")
    with locked(out), pool(jobs) if scheduler is None else connected(scheduler) as workers:
        missing = missing_entries(entries, out)
        if missing:
            until_rest = definition.storage is not None and not definition.storage.deposit
            processes = jobs if scheduler is None else max(1, workers.width() // QUEUED)
            work, size = planned([entry.scene for entry in missing])
            # The process that directs the others has no Taichi.
            size = PROCESS / 2 + beside + min(processes, len(missing)) * size
            first = missing[0].scene
            price = expected(first, work, memory=size, processors=processes, until_rest=until_rest, after=after)
            print(price, flush=True)
        simulate_all(workers, missing, out, total=len(entries), storage=definition.storage)
        paths = [(trajectory_path(entry, out),) for entry in entries if entry.split is Split.TRAIN]
        finished = workers.finished(statistics_of, paths)
        # Of all trajectories together, added in their order whoever is ready first.
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
    others would fail too.
    """
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
    """Simulate `scene` and save its trajectory, or what `storage` says of it, to `path`; in a process of the pool."""
    # Taichi belongs to the processes that simulate: the one that directs them does not import it.
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
    """Some of the particles of a trajectory of the MPM, each with the volume of those that it stands for."""
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
