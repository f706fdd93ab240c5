"""How long work will take and how much memory, before it begins, by what runs on this machine took before.

    >>> print(expected("2D f32 cpu", 1.4e7, memory=3e8))
    expected: about 2 s, 286 MiB of memory

Runs of a kind take a start (Taichi, the kernel's compilation) and their particle-steps, as planned, over a speed. Both
are medians over the latest ones, kept in `speeds.json` in the user's cache folder, or in that which the variable
TALUS_CACHE names. A file that cannot be read or written is no reason not to run.
"""

import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from platformdirs import user_cache_path
from pydantic import PositiveFloat, TypeAdapter, ValidationError

from datasets import memory
from datasets.errors import InputError
from datasets.files import read_json, write_json
from datasets.scene import Scene
from mpm.footprint import footprint
from mpm.resolution import particle_steps

KEPT = 5
"""Measurements of a kind that are kept: two that a busy machine spoils do not count."""
SHORTEST = 0.2
"""Seconds of work from which on they say how fast the machine is."""
SPEED = {2: 35e6, 3: 15e6}
"""Particle-steps a second on one processor, in 2D and in 3D (`python -m validation.bench speed`)."""
CAUTION = 3.0
"""Times that a machine of which nothing is known is taken to be slower."""
START = 20.0
"""Seconds of a start there, which compiles the kernel."""

INVERSION = 250 * 2**20
"""Bytes of PyTorch and of an inversion in a process that also runs the MPM."""


@dataclass(frozen=True, kw_only=True)
class Expected:
    """What work will take."""

    seconds: float
    memory: float
    """At the peak, of all processes [bytes]."""
    measured: bool
    """Whether such runs were measured on this machine."""
    least: bool = False
    """Whether it may take longer: how many runs there will be is open."""

    def __str__(self) -> str:
        how = "at least" if self.least else "about"
        first = "" if self.measured else "; no such run was measured on this machine yet"
        return f"expected: {how} {spoken(self.seconds)}, {memory.spoken(self.memory)} of memory{first}"


def spoken(seconds: float) -> str:
    """A duration to two digits in the unit in which it is short: `12 s`, `3.5 min`."""
    unit, size = next((pair for pair in (("h", 3600.0), ("min", 60.0)) if seconds >= 2.0 * pair[1]), ("s", 1.0))
    return f"{float(f'{seconds / size:.2g}'):g} {unit}"


def kind_of(
    scene: Scene, *, precision: str = "f32", arch: str = "cpu", until_rest: bool = False, many: bool = False
) -> str:
    """What runs have in common whose particle-steps take alike.

    until_rest: some of the steps are never made; many: runs side by side share memory, and time for files.
    """
    solids = " solids" * bool(scene.baffles or scene.solids)
    return f"{scene.dimension}D {precision} {arch}{solids}{' until rest' * until_rest}{' many' * many}"


def expected(
    kind: str, work: float, *, memory: float, processors: int = 1, least: bool = False, after: float = 0.0
) -> Expected:
    """What `work` [particle-steps] of a kind will take on so many processors, and `after` seconds or more after it."""
    known = _read().get(kind, {})
    speeds, starts = known.get("speed") or [SPEED[int(kind[0])] / CAUTION], known.get("start") or [START]
    seconds = median(starts) + work / (median(speeds) * processors) + after
    return Expected(seconds=seconds, memory=memory, measured=bool(known.get("speed")), least=least or after > 0.0)


def planned(scenes: Sequence[Scene]) -> tuple[float, float]:
    """Particle-steps of runs, and the memory [bytes] that the longest of them takes in a process of its own."""
    steps = [particle_steps(scene) for scene in scenes]
    return float(sum(steps)), float(footprint(scenes[steps.index(max(steps))]).bytes)


def learn(kind: str, work: float, seconds: float, *, processors: int = 1, start: float | None = None) -> None:
    """Keep that `work` [particle-steps] of a kind took `seconds` on so many processors, after `start` seconds."""
    if seconds < SHORTEST or work <= 0.0:
        return
    known = _read()
    for name, value in (("speed", work / (seconds * processors)), ("start", start)):
        if value is not None:
            latest = known.setdefault(kind, {})
            latest[name] = [*latest.get(name, []), max(value, 1.0e-3)][-KEPT:]
    with suppress(OSError):
        write_json(_file(), known)


def _file() -> Path:
    return Path(os.environ.get("TALUS_CACHE") or user_cache_path("talus")) / "speeds.json"


def _read() -> dict[str, dict[str, list[float]]]:
    """By kind `speed` [particle-steps/s/processor] and `start` [s], the latest last; nothing of a broken file."""
    with suppress(InputError, OSError, ValidationError):
        return TypeAdapter(dict[str, dict[str, list[PositiveFloat]]]).validate_python(read_json(_file()) or {})
    return {}
