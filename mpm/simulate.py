"""Scenes in, trajectories out: small scenes side by side, one per thread; a large one on all threads."""

import time
from collections.abc import Callable, Sequence
from typing import Any, TypedDict, Unpack

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from datasets.command_line import WorkFailed
from datasets.errors import InputError
from datasets.particles import particle_count, warn_if_unresolved
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from mpm import runtime
from mpm.batch import Batch
from mpm.device import run_on_device
from mpm.kernel import Phase, kernel
from mpm.layout import Field, Offset, Precision, Worker
from mpm.processors import processors
from mpm.runtime import Arch
from mpm.summary import summarise

FRAMES_PER_LAUNCH = 20
"""Between two launches the progress bar moves and Ctrl-C is heard."""
PARTICLES_PER_WORKER = 10_000
"""Fewer than that are not worth a thread of their own."""
LARGE = 2 * PARTICLES_PER_WORKER
"""Particles from which one scene takes several threads."""
SORTED = 50_000
"""Particles from which they are sorted by cell at every launch."""


class Options(TypedDict, total=False):
    """How to run a scene."""

    precision: Precision
    """f32 unless given."""
    threads: int | None
    """All cores unless given."""
    arch: Arch
    """The CPU unless given; on a GPU all scenes of a batch run in one launch per step."""
    fields: bool
    """Record velocities, pressure and plastic strain too."""
    until_rest: bool
    """End a scene when its kinetic energy has fallen below a thousandth of its maximum, and fill the frames that are
    left with the last one; the summary's `rest_time` [s] says when."""
    progress: bool
    """Show a bar."""


def simulate(scene: Scene, **options: Unpack[Options]) -> Trajectory:
    """Run one scene, a large one on all threads. Raises WorkFailed if it blew up, InputError where there is no GPU."""
    return simulate_many([scene], **options)[0]


def simulate_many(scenes: Sequence[Scene], **options: Unpack[Options]) -> list[Trajectory]:
    """Run scenes of one dimension side by side, one per thread; each is the same to the bit as alone on one thread.

    Errors as `simulate`.
    """
    if len({scene.dimension for scene in scenes}) > 1:
        raise InputError("expected scenes of one dimension, got 2D and 3D", key="domain.size")
    for scene in scenes:
        warn_if_unresolved(scene)
    precision, arch = options.get("precision", "f32"), options.get("arch", "cpu")
    threads = options.get("threads") or processors()
    runtime.start(precision, threads, arch)
    workers = 1
    if len(scenes) == 1 and arch == "cpu":
        workers = max(1, min(threads, particle_count(scenes[0]) // PARTICLES_PER_WORKER))
    batch = Batch(
        scenes,
        precision=precision,
        workers=workers,
        fields=options.get("fields", False),
        until_rest=options.get("until_rest", False),
        gpu=arch != "cpu",
    )
    run = kernel(batch.features)
    begin = time.perf_counter()
    # No frames: this only compiles. On a GPU the first frame does.
    if arch == "cpu":
        run(*batch.arguments.values(), 0, 0, Phase.FRAMES)
    compile_s = time.perf_counter() - begin

    begin = time.perf_counter()
    frames = max(scene.frames for scene in scenes)
    with tqdm(total=frames - 1, unit="frame", disable=not options.get("progress", False), desc="mpm") as bar:
        if arch == "cpu":
            run_on_threads(batch, run, bar)
        else:
            run_on_device(batch, run, bar)
    wall_s = time.perf_counter() - begin
    return [trajectory(batch, index, arch=arch, wall_s=wall_s, compile_s=compile_s) for index in range(len(scenes))]


def run_on_threads(batch: Batch, run: Callable[..., None], bar: "tqdm[None]") -> None:
    """Compute all frames of all scenes of a batch on the threads of the CPU."""
    frames = max(scene.frames for scene in batch.scenes)
    for first in range(1, frames, FRAMES_PER_LAUNCH):
        last = min(first + FRAMES_PER_LAUNCH, frames)
        for index, particles in enumerate(batch.particles):
            if len(particles.positions) >= SORTED:
                batch.sort(index)
        batch.barrier_count[:] = 0
        run(*batch.arguments.values(), first, last, Phase.FRAMES)
        bar.update(last - first)


def trajectory(batch: Batch, index: int, *, arch: Arch, wall_s: float, compile_s: float) -> Trajectory:
    """What scene `index` did. Raises WorkFailed where it blew up."""
    scene, particles, offset = batch.scenes[index], batch.particles[index], batch.offsets[index]
    positions, energies, impulses = batch.recorded(index), batch.energies(index), batch.impulses(index)
    fields = batch.recorded_fields(index) if batch.features.fields else None
    if len(batch.scenes) > 1:
        # What one trajectory holds must not keep the record of all others in memory.
        positions, fields = positions.copy(), None if fields is None else fields.copy()
    rest, reached = int(offset[Offset.REST]), int(offset[Offset.FRAMES])
    if rest:
        recorded: list[NDArray[Any]] = [positions, energies, impulses]
        for series in recorded if fields is None else [*recorded, fields]:
            series[rest + 1 :] = series[rest]
    if reached < scene.frames or not np.isfinite(positions).all():
        raise WorkFailed(
            f"the simulation blew up at t = {scene.frame_dt * (reached - 1):g} s; "
            f"try a step_fraction below {scene.step_fraction:g}"
        )
    dimension = scene.dimension
    return Trajectory(
        positions=positions,
        time=np.arange(scene.frames, dtype=np.float64) * scene.frame_dt,
        velocity0=particles.velocities.astype(np.float32),
        friction=particles.friction,
        scene=scene,
        velocities=None if fields is None else fields[:, :, :dimension],
        pressure=None if fields is None else fields[:, :, dimension + Field.PRESSURE],
        plastic_strain=None if fields is None else fields[:, :, dimension + Field.PLASTIC_STRAIN],
        baffle_impulse=impulses[:, : len(scene.baffles)] if scene.baffles else None,
        summary=summarise(
            positions[-1],
            energy=energies,
            steps=int(offset[Offset.STEPS]),
            clamped=int(batch.clamped[batch.workers[:, Worker.SCENE] == index].sum()),
            rest_time=rest * scene.frame_dt if rest else None,
            release_time=batch.release_times(index),
            wall_impulse=None if fields is None else impulses[:, -1],
            wall_s=wall_s,
            compile_s=compile_s,
            arch=arch,
            precision=batch.features.precision,
        ),
    )
