"""Simulate scenes: small scenes side by side, one per thread; a large scene on all threads."""

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from threading import Timer
from typing import Any, TypedDict, Unpack, get_args

import numpy as np
from tqdm import tqdm

from datasets.errors import InputError, WorkFailed, require
from datasets.flow.array_files import FrameWriter
from datasets.flow.trajectory import Trajectory
from datasets.scene import Scene
from datasets.scene.checks import warn_if_unlikely
from datasets.scene.library import read_scene
from datasets.scene.particles import particle_count, warn_if_unresolved
from datasets.schema import unknown_key
from mpm import runtime
from mpm.arrays.batch import Batch, particles_of
from mpm.arrays.features import Features, features_of
from mpm.arrays.layout import FRAMES_PER_CALL, Offset, Precision
from mpm.device import run_on_device
from mpm.footprint import footprint, require_memory
from mpm.initial.stages import begin_stages, call_end
from mpm.kernel import Phase, compute, kernel
from mpm.output.checkpoint import Checkpoint
from mpm.output.outcome import flow_of, trajectory
from mpm.output.recording import ALL, Recording
from mpm.runtime import ARCHES, Arch

LARGE = 2 * runtime.PARTICLES_PER_WORKER
"""From this many particles on, a scene uses several threads and is sorted by cell every FRAMES_PER_CALL frames."""
COMPILING = {2: 5, 3: 10}  # seconds to compile a kernel, by dimension
PARTICLE_STEPS_PER_CALL = 5.0e6  # about a second or two of one thread: a stop waits for the end of a call
SHORT = 0.02  # a call shorter than this [s] says too little about how busy the processors are
PATIENCE = 4.0  # a large scene tries all its threads again after one second, then after two, at most after this many


class Options(TypedDict, total=False):
    """How to run a scene."""

    precision: Precision
    """f32 unless given."""
    threads: int | None
    """All cores unless given."""
    arch: Arch
    """The CPU unless given; on a GPU one call computes a step of all scenes of a batch."""
    record: Recording
    """What to record, and until when to run; the positions in all frames unless given."""
    progress: bool
    """Show a progress bar."""
    file: FrameWriter
    """File that takes the positions during the run, in place of memory; for one scene, on the CPU, without fields."""


def check_options(options: Mapping[str, Any]) -> None:
    """Raise InputError for an unknown option or an invalid value."""
    names = [*Options.__annotations__]
    for name in options:
        if name not in names:
            raise InputError(unknown_key(name, names), key=name)
    precisions, threads = get_args(Precision), options.get("threads")
    positive = threads is None or (isinstance(threads, int | np.integer) and int(threads) > 0)
    for name, ok, expected in (
        ("precision", options.get("precision", "f32") in precisions, f"one of {', '.join(precisions)}"),
        ("arch", options.get("arch", "cpu") in [*ARCHES], f"one of {', '.join(ARCHES)}"),
        ("threads", positive, "a whole number from 1 on"),
        ("record", isinstance(options.get("record", ALL), Recording), "a Recording"),
    ):
        require(ok, name, expected, repr(options.get(name)))


class ScenesFailed(WorkFailed):
    """Some scenes of a batch failed; the others did not."""

    def __init__(self, outcomes: "Sequence[Trajectory | WorkFailed]") -> None:
        self.outcomes = list(outcomes)
        """The trajectory or the failure of each scene, in the order in which they were given."""
        failed = {index: outcome for index, outcome in enumerate(outcomes) if isinstance(outcome, WorkFailed)}
        first, reason = next(iter(failed.items()))
        others = f" (and {len(failed) - 1} more of {len(outcomes)})" if len(failed) > 1 else f" of {len(outcomes)}"
        super().__init__(f"scene {first}{others} failed: {reason}")


class Interrupted(KeyboardInterrupt):
    """A run was stopped between two calls of the kernel."""

    def __init__(self, checkpoint: Checkpoint, so_far: Trajectory) -> None:
        self.checkpoint = checkpoint
        self.so_far = so_far
        """The records until then."""
        super().__init__()


def simulate(
    scene: Scene | str | Path,
    *,
    resume: Checkpoint | None = None,
    stop: Callable[[], bool] = lambda: False,
    **options: Unpack[Options],
) -> Trajectory:
    """Run a scene, given as such, by its path or by a shipped name; a large one uses all threads.

        trajectory = simulate(scene, record=Recording(frames=10, fields=True))
        trajectory.positions, trajectory.summary["front"]        # [m], shape [T, N, D]; m

    stop: called every few frames; once it returns True, Interrupted is raised with a checkpoint. resume: a checkpoint,
    from which the run continues; on as many threads the result is the same to the bit as without interruption. Raises
    WorkFailed if the run blew up, InputError if there is no GPU or if the checkpoint belongs to another scene,
    recording or precision."""
    check_options(options)
    scene = scene if isinstance(scene, Scene) else read_scene(scene)
    warn_if_unlikely(scene)
    warn_if_unresolved(scene)
    arch, threads = options.get("arch", "cpu"), options.get("threads")
    precision, record = options.get("precision", "f32"), options.get("record", ALL)
    parts = runtime.parts_for(particle_count(scene), threads) if arch == "cpu" else 1
    file, gpu = options.get("file"), arch != "cpu"
    require(file is None or not record.state, "file", "only positions: fields are smoothed in memory")
    plan = footprint(scene, record=record, precision=precision, workers=parts, gpu=gpu, in_file=file is not None)
    require_memory([plan])
    particles = particles_of([scene])
    workers = min(parts, runtime.workers_for(particle_count(scene), threads))
    runtime.start(precision, threads, arch, enough=workers)
    batch = Batch([scene], precision=precision, workers=parts, record=record, gpu=gpu, particles=particles, file=file)
    if resume is not None:
        resume.restore(batch)
    show = options.get("progress", False)
    with tqdm(total=scene.frames - 1, initial=batch.computed, unit="frame", disable=not show, desc="mpm") as bar:
        wall_s, compile_s = run_batch(batch, arch, bar, stop, threads=workers, say=show)
    wall_s += 0.0 if resume is None else resume.wall_s
    if batch.computed < scene.frames - 1 and not batch.ended(batch.computed + 1).any():
        kept = sum(frame <= batch.computed for frame in batch.kept(0))
        so_far = flow_of(batch, 0, batch.recorded(0)[:kept])
        raise Interrupted(Checkpoint.from_batch(batch, wall_s=wall_s), so_far)
    outcome = trajectory(batch, 0, arch=arch, wall_s=wall_s, compile_s=compile_s)
    if isinstance(outcome, WorkFailed):
        raise outcome
    return outcome


def simulate_many(scenes: Sequence[Scene | str | Path], **options: Unpack[Options]) -> list[Trajectory]:
    """Run scenes side by side, one per thread; with fewer than LARGE particles, each is the same to the bit as alone.

    Raises ScenesFailed after all have ended if one blew up, and InputError as `simulate` does."""
    if len(scenes) == 1:
        return [simulate(scenes[0], **options)]
    return whole(simulate_each(scenes, **options))


def whole(outcomes: Sequence[Trajectory | WorkFailed]) -> list[Trajectory]:
    """The trajectories of scenes. Raises ScenesFailed if a scene has none."""
    trajectories = [outcome for outcome in outcomes if isinstance(outcome, Trajectory)]
    if len(trajectories) < len(outcomes):
        raise ScenesFailed(outcomes)
    return trajectories


def simulate_each(scenes: Sequence[Scene | str | Path], **options: Unpack[Options]) -> list[Trajectory | WorkFailed]:
    """As `simulate_many`, but a scene that blew up leaves a WorkFailed in its place.

    Scenes that need the same features run together, in the kernel that each would get alone; `wall_s` and `compile_s`
    of their summaries are those of all scenes together."""
    check_options(options)
    require(len(scenes) > 0, "scenes", "one scene at least", "none")
    given = [scene if isinstance(scene, Scene) else read_scene(scene) for scene in scenes]
    require("file" not in options, "file", "a single scene for frames kept in a file", "several")
    for scene in given:
        warn_if_unresolved(scene)
    arch, record = options.get("arch", "cpu"), options.get("record", ALL)
    precision, gpu = options.get("precision", "f32"), arch != "cpu"
    require_memory([footprint(scene, record=record, precision=precision, gpu=gpu) for scene in given])
    runtime.start(precision, options.get("threads"), arch)
    particles = particles_of(given)
    groups: dict[Features, list[int]] = {}
    for index, scene in enumerate(given):
        features = features_of([scene], precision, record=record, gpu=gpu)
        groups.setdefault(features, []).append(index)
    outcomes: dict[int, Trajectory | WorkFailed] = {}
    wall_s = compile_s = 0.0
    frames = sum(max(given[index].frames for index in group) - 1 for group in groups.values())
    show = options.get("progress", False)
    with tqdm(total=frames, unit="frame", disable=not show, desc="mpm") as bar:
        for group in groups.values():
            alike, filled = [given[index] for index in group], [particles[index] for index in group]
            batch = Batch(alike, precision=precision, record=record, gpu=gpu, particles=filled)
            seconds = run_batch(batch, arch, bar, lambda: False, say=show)
            wall_s, compile_s = wall_s + seconds[0], compile_s + seconds[1]
            for number, index in enumerate(group):
                outcomes[index] = trajectory(batch, number, arch=arch, wall_s=0.0, compile_s=0.0)
    for outcome in outcomes.values():
        if isinstance(outcome, Trajectory):
            outcome.summary.update(wall_s=wall_s, compile_s=compile_s)
    return [outcomes[index] for index in range(len(scenes))]


def run_batch(
    batch: Batch, arch: Arch, bar: "tqdm[None]", stop: Callable[[], bool], *, threads: int | None = None, say: bool
) -> tuple[float, float]:
    """Run all scenes of a batch to their ends or until a stop; return the seconds to compute and to compile.

    threads: for one scene in parts; one per part unless given. say: announce a compilation that takes more than a
    second; a kernel that was compiled before loads in less."""
    run = kernel(batch.features)
    begin = time.perf_counter()
    line = f"compiling: the first run of a kind takes some {COMPILING[batch.features.dimension]} s longer"
    waiting = Timer(1.0, print, (line,), {"file": sys.stderr, "flush": True})
    if say and arch == "cpu":
        waiting.start()
    # A call for no frames only compiles. On a GPU the first frame compiles.
    try:
        if arch == "cpu":
            run(*batch.arguments.values(), 0, 0, Phase.FRAMES)
    finally:
        waiting.cancel()
    compile_s = time.perf_counter() - begin
    begin = time.perf_counter()
    if arch == "cpu":
        run_on_threads(batch, bar, stop, threads)
    else:
        run_on_device(batch, run, bar, stop)
    return time.perf_counter() - begin, compile_s


def run_on_threads(batch: Batch, bar: "tqdm[None]", stop: Callable[[], bool], threads: int | None = None) -> None:
    """Compute the frames of all scenes of a batch, after `batch.computed`, on the threads of the CPU.

    A call ends where particles are sorted (the same frames whether or not the run was interrupted), where a frame is
    kept that the kernel does not record, and where a stage may begin."""
    end, crew = max(scene.frames for scene in batch.scenes), Crew(batch, threads)
    steps = (batch.offsets[:, Offset.SUBSTEPS] * batch.offsets[:, Offset.PARTICLES].astype(float)).sum()
    most = max(1, int(PARTICLE_STEPS_PER_CALL * crew.most / steps))
    while (first := batch.computed + 1) < end and not batch.ended(first).all() and not stop():
        since_sorted = (first - 1) % FRAMES_PER_CALL
        last = min(first + most, first + FRAMES_PER_CALL - since_sorted, end)
        if (every := batch.recording.every) > 0 and not batch.in_kernel:
            last = min(last, first + every - (first - 1) % every)
        last = min(last, call_end(batch, first))
        for index, particles in enumerate(batch.particles):
            if since_sorted == 0 and len(particles.positions) >= LARGE:
                batch.sort(index)
            elif since_sorted == 0 and batch.features.contact:
                batch.put_contacts_first(index)
        begin, used = time.perf_counter(), time.process_time()
        compute(batch, last, crew.threads)
        crew.choose(time.perf_counter() - begin, time.process_time() - used)
        batch.keep(first)
        begin_stages(batch)
        bar.update(last - first)


class Crew:
    """The number of threads for the parts of a large scene: it is halved while other processes occupy processors.
    Threads wait for each other in every step: if one waits for a processor, all do. If m <= 1 of T processors are
    taken, T threads run at 1 - m of their speed, and T / 2 threads at half of it. The result is the same to the bit."""

    def __init__(self, batch: Batch, threads: int | None = None) -> None:
        self.most = self.threads = threads or len(batch.workers)
        self.shared = batch.features.processor.shared
        self.wait, self.patience = 0.0, 1.0

    def choose(self, wall: float, used: float) -> None:
        """Choose the threads of the next call: the last took `wall` seconds, and `used` seconds of all processors."""
        if self.shared and self.threads > 1 and wall > SHORT and self.threads - used / wall > 0.5:
            self.threads, self.wait = self.threads // 2, self.patience
            self.patience = min(2.0 * self.patience, PATIENCE)
        elif self.threads < self.most:
            self.wait -= wall
            if self.wait <= 0.0:
                self.threads = self.most
        else:
            self.patience = 1.0
