"""Seconds and memory of a gradient over particles and steps, each case in a process of its own and on one thread."""

import dataclasses
import time
from dataclasses import dataclass

import numpy as np

from datasets.library import read_scene
from datasets.particles import particle_count
from datasets.scene import Domain, Mass, Scene
from mpm.adjoint.gradient import pull_back
from mpm.adjoint.tape import MEMORY_MIB, Tape
from validation.report.memory import peak, reset_peak, resident
from validation.report.process import isolated

SCENE = "column-tall-42"
WARM_UP_S = 0.1
"""Flow that the kernels are compiled on [s]."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A column that is larger and lasts longer than the shipped one, on the same cells."""

    scale: float
    """Length and height over the shipped one's."""
    duration: float
    """[s]."""
    memory_mib: float = MEMORY_MIB
    """Budget of the tape."""

    @property
    def scene(self) -> Scene:
        """The column in its box."""
        scene = read_scene(SCENE)
        (mass,) = scene.masses

        def scaled(lengths: tuple[float, ...]) -> tuple[float, ...]:
            return tuple(round(length * self.scale, 9) for length in lengths)

        return dataclasses.replace(
            scene,
            duration=self.duration,
            domain=Domain(size=scaled(scene.domain.size), cell=scene.domain.cell),
            masses=(Mass(lower=mass.lower, size=scaled(mass.size)),),
        )


CASES = (
    Case(scale=1.0, duration=1.0),
    Case(scale=2.0, duration=1.0),
    Case(scale=2.0, duration=2.0),
    Case(scale=5.59, duration=3.185, memory_mib=6144.0),
)
"""3,200 and 12,800 particles over 4,400 steps, 12,800 over 8,800, 100,000 over 14,000."""
QUICK = (Case(scale=0.5, duration=0.1), Case(scale=0.5, duration=0.2))


@dataclass(frozen=True, kw_only=True)
class Usage:
    """What a gradient took."""

    particles: int
    steps: int
    seconds: float
    """Of the run with checkpoints, its replay and its reverse."""
    tape: int
    """Checkpoints, one segment's states and bars [bytes]."""
    extra: int
    """Greatest resident size of the process above what it held before [bytes]."""
    whole: int
    """Greatest resident size of the process, Python and Taichi included [bytes]."""

    @property
    def nanoseconds(self) -> float:
        """For each particle and step."""
        return 1.0e9 * self.seconds / (self.particles * self.steps)


def gradient(scene: Scene, memory_mib: float) -> Tape:
    """The tape of a run after the gradient of its mean x."""
    tape = Tape([scene], [scene.frames - 1], precision="f32", memory_mib=memory_mib, threads=1)
    slope = np.zeros(tape.positions().shape)
    slope[..., 0] = 1.0 / particle_count(scene)
    pull_back(tape, [slope])
    return tape


def usage(case: Case) -> Usage:
    """Of one case in this process; kernels are compiled on a short flow before."""
    gradient(dataclasses.replace(Case(scale=1.0, duration=WARM_UP_S).scene), MEMORY_MIB)
    reset_peak()
    before, began = resident() or peak(), time.perf_counter()
    tape = gradient(case.scene, case.memory_mib)
    seconds = time.perf_counter() - began
    return Usage(
        particles=particle_count(case.scene),
        steps=int(tape.steps.sum()),
        seconds=seconds,
        tape=tape.bytes(),
        extra=max(0, peak() - before),
        whole=peak(),
    )


def in_process(case: Case) -> Usage:
    """A case in a process of its own. Raises WorkFailed."""
    return isolated(usage, case)
