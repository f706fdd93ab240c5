"""How long work will take and how much memory, before it begins: a range, by one speed for each kind of scene.

    >>> print(expected(read_scene("column-tall-42"), 1.4e9, memory=3e8))
    expected: 25 to 110 s, 286 MiB of memory

Work takes a start (Taichi, the kernel's compilation) and its particle-steps, as planned, over a speed. The range holds
slow and fast machines, from cores that share their memory with many others to a core on its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from datasets import memory
from datasets.scene import Scene
from mpm.arrays.layout import Precision
from mpm.footprint import footprint
from mpm.resolution import particle_steps
from mpm.runtime import Arch

SPEED = {2: 35e6, 3: 15e6}
"""Particle-steps a second on one processor, in 2D and in 3D (`python -m validation.bench speed`)."""
GPU_SPEED = {2: 350e6, 3: 120e6}
"""On a GPU (`python -m validation.bench gpu`)."""
SOLIDS, DOUBLE = 0.8, 0.75
"""Shares of the speed that are left beside solids and in f64."""
SLOW, FAST = 0.4, 1.7
"""Speeds of machines over these: from 16 threads that wait for one memory to a thread alone."""
START = {2: (1.0, 8.0), 3: (2.0, 15.0)}
"""Seconds of a start, from kernels that are on disk to those that are compiled."""
EARLIEST = 0.5
"""Share of the steps after which flows are taken to rest, where runs end then."""

INVERSION = 250 * 2**20
"""Bytes of PyTorch and of an inversion in a process that also runs the MPM."""


@dataclass(frozen=True, kw_only=True)
class Expected:
    """What work will take."""

    shortest: float
    longest: float
    """Of the range [s]."""
    memory: float
    """At the peak, of all processes [bytes]."""
    least: bool = False
    """Whether it may take longer than the range: how many runs there will be is open."""

    def __str__(self) -> str:
        seconds = f"{'at least ' * self.least}{spoken(self.shortest, self.longest)}"
        return f"expected: {seconds}, {memory.spoken(self.memory)} of memory"


def spoken(shortest: float, longest: float) -> str:
    """A range of durations, to two digits each in the unit in which the longer one is short: `2 to 12 s`."""
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
    """What `work` [particle-steps] of scenes like this will take on so many processors, and `after` seconds after it.

    until_rest: whether runs end where the flow rests; least: whether more work may follow; so it does `after`.
    """
    speed = processors * SPEED[scene.dimension] if arch == "cpu" else GPU_SPEED[scene.dimension]
    speed *= (SOLIDS if scene.baffles or scene.solids else 1.0) * (DOUBLE if precision == "f64" else 1.0)
    first, last = START[scene.dimension]
    return Expected(
        shortest=first + (EARLIEST if until_rest else 1.0) * work / (FAST * speed) + after,
        longest=last + work / (SLOW * speed) + after,
        memory=memory,
        least=least or after > 0.0,
    )


def planned(scenes: Sequence[Scene]) -> tuple[float, float]:
    """Particle-steps of runs, and the memory [bytes] that the longest of them takes in a process of its own."""
    steps = [particle_steps(scene) for scene in scenes]
    return float(sum(steps)), float(footprint(scenes[steps.index(max(steps))]).bytes)
