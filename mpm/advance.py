"""The kernel: frames of MLS-MPM steps, for many scenes on a thread each or for one large scene on all threads.

Many scenes: a scene runs on one thread from the first step of a launch to the last: no atomics, no barriers, and the
result is the same to the bit on any number of threads. One large scene: each thread has its own part of the points and
its own grid, and where the grids overlap they are summed; the last bits then depend on the number of threads. A launch
costs Taichi a third of a millisecond, as much as a step of 10,000 points, so the threads wait for each other inside it.
"""

from collections.abc import Callable
from enum import Enum, auto
from functools import cache
from typing import Any

import taichi as ti

from mpm.layout import Needs, Pace, Place, Setting, Worker
from mpm.motion import move_block, move_points
from mpm.nodes import clear, rows_of, update_node, update_nodes
from mpm.note import note, note_block, note_scene, squared_speed, steps_at_speed, steps_of_frame
from mpm.transfer import block_to_grid, points_to_grid

TURNS = 512
"""Taichi hands a thread no fewer turns of a loop than these."""


class Phase(Enum):
    """What a launch does."""

    FRAMES = auto()
    """Frames from `first` to before `last`, a thread per worker."""
    SPEED = auto()
    """The number of steps that each scene needs for its next frame."""
    STEP = auto()
    """One step of every scene whose dt is not zero; `last` is the largest number of nodes of a scene."""
    NOTE = auto()
    """Record frame `first` of every scene that still moves."""


@ti.data_oriented
class Arrays:
    """The arrays of a batch by name, as the kernel hands them on; `mpm.batch` says what each holds."""

    def __init__(self, needs: Needs, **arrays: Any) -> None:
        self.needs = needs
        vars(self).update(arrays)


@ti.func
def meet(of: ti.template()):
    """Wait until all workers of a shared scene have come here; nothing where scenes are not shared.

    Each has a thread of its own, because Taichi has as many threads as there are workers. Reading by adding zero keeps
    the compiler from reading once.
    """
    if ti.static(of.needs.shared):
        count = of.workers.shape[0]
        goal = (ti.atomic_add(of.gate[0], 1) // count + 1) * count
        while ti.atomic_add(of.gate[0], 0) < goal:
            pass


@ti.func
def advance_worker(worker, first, last, of: ti.template()):
    """Compute the frames [first, last) of a worker's part of its scene; record them if it is the scene's first."""
    scene = of.workers[worker, Worker.SCENE]
    rows = rows_of(scene, of)
    for frame in range(first, ti.min(last, of.places[scene, Place.FRAMES])):
        if of.places[scene, Place.REST] > 0:
            break
        substeps = steps_of_frame(scene, of)
        meet(of)
        if substeps == 0:
            of.places[scene, Place.FRAMES] = frame
            break
        dt = of.settings[scene, Setting.FRAME_DT] / substeps
        for _ in range(substeps):
            clear(worker, rows, of)
            points_to_grid(worker, scene, dt, rows, of)
            meet(of)
            update_nodes(worker, scene, dt, rows, of)
            meet(of)
            move_points(worker, scene, dt, rows, of)
        meet(of)
        if worker == 0 or not ti.static(of.needs.shared):
            of.places[scene, Place.STEPS] = of.places[scene, Place.STEPS] + substeps
            note(scene, frame, of)
        meet(of)


@cache
def kernel(needs: Needs) -> Callable[..., None]:
    """The kernel for scenes with `needs`; nothing else is compiled into it.

    It takes the arrays of `mpm.batch.Batch.arguments`, then `first`, `last` and the phase. Phase.FRAMES: compute and
    record the frames [first, last). The others are parts of a frame, each on as many threads as there are points, for a
    GPU: see `mpm.device`.
    """
    real = ti.f32 if needs.precision == "f32" else ti.f64
    numbers = ti.types.ndarray(dtype=real, ndim=1)
    blocks = numbers if needs.gpu else ti.types.ndarray(dtype=ti.types.vector(needs.lanes, real), ndim=1)
    nodes = ti.types.ndarray(dtype=ti.types.vector(needs.node, real), ndim=1)
    table = ti.types.ndarray(dtype=real, ndim=2)
    integers = ti.types.ndarray(dtype=ti.i32, ndim=1)
    integer_table = ti.types.ndarray(dtype=ti.i32, ndim=2)
    singles = ti.types.ndarray(dtype=ti.f32, ndim=1)
    doubles = ti.types.ndarray(dtype=ti.f64, ndim=1)
    double_table = ti.types.ndarray(dtype=ti.f64, ndim=2)

    @ti.kernel
    def advance(
        state: blocks,
        lanes: numbers,
        grid: nodes,
        scratch: blocks,
        scratch_lanes: numbers,
        impulse: blocks,
        impulse_lanes: numbers,
        settings: table,
        properties: table,
        baffles: table,
        places: integer_table,
        workers: integer_table,
        order: integers,
        record: singles,
        fields: singles,
        energy: doubles,
        taken: double_table,
        gate: integers,
        clamped: integers,
        owner: integers,
        pace: table,
        first: ti.i32,
        last: ti.i32,
        phase: ti.template(),
    ):
        # `ti.static` makes the object while the kernel is compiled.
        of = ti.static(
            [
                Arrays(
                    needs,
                    state=state,
                    lanes=lanes,
                    grid=grid,
                    scratch=scratch,
                    scratch_lanes=scratch_lanes,
                    impulse=impulse,
                    impulse_lanes=impulse_lanes,
                    settings=settings,
                    properties=properties,
                    baffles=baffles,
                    places=places,
                    workers=workers,
                    order=order,
                    record=record,
                    fields=fields,
                    energy=energy,
                    taken=taken,
                    gate=gate,
                    clamped=clamped,
                    owner=owner,
                    pace=pace,
                )
            ]
        )[0]
        if ti.static(phase == Phase.FRAMES):
            ti.loop_config(block_dim=TURNS)
            for turn in range(workers.shape[0] * TURNS):
                if turn % TURNS == 0:
                    advance_worker(turn // TURNS, first, last, of)
        if ti.static(phase == Phase.SPEED):
            for scene in range(places.shape[0]):
                pace[scene, Pace.SPEED] = 0.0
            for block in range(owner.shape[0]):
                ti.atomic_max(pace[owner[block], Pace.SPEED], ti.sqrt(squared_speed(block, of)))
            for scene in range(places.shape[0]):
                pace[scene, Pace.STEPS] = steps_at_speed(scene, pace[scene, Pace.SPEED], of)
        if ti.static(phase == Phase.STEP):
            for n in range(grid.shape[0]):
                grid[n] = 0.0 * grid[n]
            for block in range(owner.shape[0]):
                scene = owner[block]
                if pace[scene, Pace.DT] > 0.0:
                    at = workers[scene, Worker.NODE]
                    block_to_grid(at, scene, block, block * needs.scratch, pace[scene, Pace.DT], rows_of(scene, of), of)
            for q in range(last * places.shape[0]):
                update_node(q % last, q // last, of)
            for block in range(owner.shape[0]):
                scene = owner[block]
                dt = pace[scene, Pace.DT]
                if dt > 0.0:
                    at = workers[scene, Worker.NODE]
                    move_block(scene, at, scene, block, block * needs.scratch, dt, rows_of(scene, of), of)
        if ti.static(phase == Phase.NOTE):
            for block in range(owner.shape[0]):
                if pace[owner[block], Pace.STEPS] > 0.0:
                    note_block(owner[block], first, block, of)
            for scene in range(places.shape[0]):
                if pace[scene, Pace.STEPS] > 0.0:
                    note_scene(scene, first, of)

    return advance
