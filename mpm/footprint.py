"""The size and cost of a run before anything is allocated: particles, nodes, frames, steps, memory and time.

    >>> print(footprint(read_scene("column-tall-42")))
    3200 particles, 107 x 107 nodes, 401 frames, 4400 steps or more

The arrays of a run (`mpm.arrays.batch`) are counted from the scene alone. The grid follows the particles, not the box,
and counts with its initial room (`mpm.arrays.layout.node_room`). The other memory of a process is measured: Taichi with
a compiled kernel (`PROCESS`), and temporary arrays while the state is filled (`BESIDE`).

    >>> print(expected(read_scene("column-tall-42"), 1.4e9, memory=3e8))
    expected: 25 to 110 s, 286 MiB of memory

The time is a start (Taichi, compilation) plus the planned particle-steps over a speed for each kind of scene. The range
covers slow and fast machines, from cores that share their memory with many others to a single core.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from datasets import memory
from datasets.errors import require
from datasets.geometry.contact_surface import contact_surface_of
from datasets.scene import Scene
from datasets.scene.particles import mass_counts
from datasets.scene.stiffness import greatest_speed, specific_stress
from mpm.arrays.features import NODE, features_of
from mpm.arrays.layout import BED_PER_CELL, Energy, Precision, Span, column_count, node_room, node_shape
from mpm.arrays.properties import STABILITY, substeps_per_frame
from mpm.output.recording import ALL, Recording
from mpm.resolution import particle_steps
from mpm.runtime import Arch
from mpm.solids.obstacles import farthest, window_around

PROCESS = 240 * 2**20  # bytes of a process with Taichi and a kernel
BESIDE = 2.5  # peak over the bytes of the particles and their state
STRESS = 4096  # bytes per particle for the initial equilibrium of a mass: a factorisation
MOST_STEPS = 2**31 - 1  # a counter's limit; at a million particle-steps a second one particle would take half an hour

SPEED = {2: 35e6, 3: 15e6}  # particle-steps a second of a processor, by dimension (`python -m validation.bench speed`)
GPU_SPEED = {2: 350e6, 3: 120e6}  # on a GPU (`python -m validation.bench gpu`)
SOLIDS, DOUBLE = 0.8, 0.75  # factors on the speed next to solids and in f64
SLOW, FAST = 0.4, 1.7  # speeds of machines over these: from 16 threads that share one memory to a single thread
START = {2: (1.0, 8.0), 3: (2.0, 15.0)}  # seconds of a start, from kernels that are on disk to those that are compiled
EARLIEST = 0.5  # least share of the steps after which a flow may rest, if runs end at rest
MUCH = 10.0  # Young's modulus over what the flow needs, above which a softer material is suggested
INVERSION = 250 * 2**20  # bytes of PyTorch and of an inversion in a process that also runs the MPM


@dataclass(frozen=True, kw_only=True)
class Footprint:
    """The size, memory and steps of a run."""

    particles: int
    nodes: tuple[int, ...]  # of the box along each axis; the grid holds those near the material
    frames: int  # including the first
    steps: int  # at least: a frame whose particles move fast has more
    bytes: int  # peak memory of the whole process

    @property
    def work(self) -> float:
        """Particle-steps."""
        return float(self.particles) * self.steps

    def __str__(self) -> str:
        nodes = " x ".join(map(str, self.nodes))
        return f"{self.particles} particles, {nodes} nodes, {self.frames} frames, {self.steps} steps or more"


def footprint(
    scene: Scene,
    *,
    record: Recording = ALL,
    precision: Precision = "f32",
    workers: int = 1,
    gpu: bool = False,
    in_file: bool = False,
) -> Footprint:
    """The footprint of a run on `workers`, with frames in a file or in memory. Raises InputError for too many steps."""
    features = features_of([scene], precision, record=record, shared=workers > 1, gpu=gpu)
    substeps = substeps_per_frame(scene, [scene.material_of(mass) for mass in scene.masses])
    steps = substeps * (scene.frames - 1)
    instead = "a softer `young`, larger cells or a shorter time"
    got = f"{steps:.3g}, {substeps:.3g} in each frame: {instead}"
    require(steps <= MOST_STEPS, "duration", f"at most {MOST_STEPS} steps", got)
    count, dimension = sum(mass_counts(scene)), features.dimension
    nodes, surface = node_shape(scene.domain), contact_surface_of(scene) if features.listed else None
    real = 4 if features.precision == "f32" else 8
    particle = 8 * (2 * dimension + dimension**2 + 2) + 8
    room = math.prod(nodes) if gpu else node_room(scene.domain, math.ceil(count / workers))
    sizes = (
        PROCESS,
        count * BESIDE * (particle + real * features.state.size),
        workers * room * real * NODE + workers * column_count(scene.domain) * 4 * (1 + len(Span)),
        # The cells around the faces of solids, which have lists of them.
        16 * window_around(scene.domain, surface.faces, farthest(scene)).count if surface else 0,
        # The lattice of a terrain's bed.
        (8 + 2 * real) * BED_PER_CELL**2 * column_count(scene.domain) if features.terrain else 0,
        STRESS * count if any(mass.k0 is not None for mass in scene.masses) else 0,
    )
    kept = len(record.kept(scene.frames))
    solids = len(scene.baffles) + len(scene.solids) + (2 * dimension + 1 if record.wall_forces else 0)
    # Smoothed fields are held twice.
    numbers = dimension + (2 * (dimension + features.stresses + 2) if record.fields else 0) + int(record.pore_pressure)
    recorded = 4 * count * kept * numbers + 8 * scene.frames * (len(Energy) + 2 * solids * dimension)
    size = int(sum(sizes)) + (0 if in_file else recorded)
    return Footprint(particles=count, nodes=nodes, frames=scene.frames, steps=steps, bytes=size)


def require_memory(footprints: list[Footprint]) -> None:
    """Raise InputError if runs side by side need more memory than is free; it says how much, and what to change."""
    extra = sum(need.bytes - PROCESS for need in footprints)
    largest = max(footprints, key=lambda need: need.bytes)
    runs = "a run" if len(footprints) == 1 else f"{len(footprints)} runs"
    instead = "larger cells, fewer particles_per_axis or frames (--every, --last-frame, --hdf5)"
    memory.require(extra, runs, f"{largest}; {instead}")


def step_spoken(scene: Scene) -> str:
    """The initial time step and what sets it, in words; with the advice to use a softer material, if one would do."""
    materials = [scene.material_of(mass) for mass in scene.masses]
    stiffest = max(materials, key=lambda material: material.wave_speed)
    wave, speed = stiffest.wave_speed, greatest_speed(scene)
    slow = (STABILITY / scene.step_fraction - 1.0) * wave
    step = scene.frame_dt / substeps_per_frame(scene, materials)
    line = f"time step {step:.2g} s, set by elastic waves of {wave:.3g} m/s"
    if speed > slow:
        line += f", by the flow where it is faster than {slow:.3g} m/s: it may reach {speed:.3g} m/s"
    enough = specific_stress(scene) * stiffest.density
    if stiffest.modulus > MUCH * enough > 0.0:
        shares = f"{(enough / stiffest.modulus) ** 0.5:.2g} of the steps"
        line += f" (young = {stiffest.modulus:.2g} Pa; {float(f'{enough:.1e}'):g} Pa would do, in {shares})"
    return line


@dataclass(frozen=True, kw_only=True)
class Expected:
    """Expected time and memory."""

    shortest: float
    longest: float  # of the range [s]
    memory: float  # at the peak, of all processes [bytes]
    least: bool = False  # whether it may take longer than the range, because the number of runs is open

    def __str__(self) -> str:
        seconds = f"{'at least ' * self.least}{spoken(self.shortest, self.longest)}"
        return f"expected: {seconds}, {memory.spoken(self.memory)} of memory"


def spoken(shortest: float, longest: float) -> str:
    """A range of durations in the largest suitable unit, to two digits each: `2 to 12 s`."""
    unit, size = next((pair for pair in (("h", 3600.0), ("min", 60.0)) if longest >= 2.0 * pair[1]), ("s", 1.0))
    low, high = (f"{float(f'{seconds / size:.2g}'):g}" for seconds in (shortest, longest))
    return f"{high} {unit}" if low == high else f"{low} to {high} {unit}"


def expected(
    scene: Scene,
    work: float,
    *,
    memory: float,
    processors: int = 1,
    precision: Precision = "f32",
    arch: Arch = "cpu",
    until_rest: bool = False,
    least: bool = False,
    after: float = 0.0,
) -> Expected:
    """Time and memory for `work` [particle-steps] of scenes like this on `processors`, followed by `after` seconds.

    until_rest: whether runs end when the flow rests; least: whether more work may follow, as it does with `after`."""
    speed = processors * SPEED[scene.dimension] if arch == "cpu" else GPU_SPEED[scene.dimension]
    speed *= (SOLIDS if scene.baffles or scene.solids else 1.0) * (DOUBLE if precision == "f64" else 1.0)
    first, last = START[scene.dimension]
    shortest = first + (EARLIEST if until_rest else 1.0) * work / (FAST * speed) + after
    longest = last + work / (SLOW * speed) + after
    return Expected(shortest=shortest, longest=longest, memory=memory, least=least or after > 0.0)


def planned(scenes: Sequence[Scene]) -> tuple[float, float]:
    """Particle-steps of runs, and the memory [bytes] that the longest of them takes in a process of its own."""
    steps = [particle_steps(scene) for scene in scenes]
    return float(sum(steps)), float(footprint(scenes[steps.index(max(steps))]).bytes)
