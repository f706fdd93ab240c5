"""What a run will take, before any of it is allocated: particles, nodes, frames, steps and memory.

    >>> print(footprint(read_scene("column-tall-42")))
    3200 particles, 107 x 107 nodes, 401 frames, 4400 steps or more

The arrays of a run are those of `mpm.arrays.batch`, counted here from the scene alone; what else a process holds is
measured: Taichi with a compiled kernel (`PROCESS`), and what stands beside the state while it is filled (`BESIDE`).
"""

import math
from dataclasses import dataclass

from datasets import memory
from datasets.errors import InputError
from datasets.particles import mass_counts
from datasets.scene import Scene
from mpm.arrays.features import features_of
from mpm.arrays.layout import Energy, Precision, node_shape
from mpm.arrays.properties import substeps_per_frame
from mpm.output.request import ALL, Recording

PROCESS = 240 * 2**20
"""Bytes of a process with Taichi and a kernel."""
BESIDE = 2.5
"""Peak over the bytes of the particles and their state."""
STRESS = 4096
"""Bytes that an equilibrium of a mass at the start takes per particle: a factorisation."""
MOST_STEPS = 2**31 - 1
"""A counter's limit; at a million particle-steps a second one particle would take half an hour."""


@dataclass(frozen=True, kw_only=True)
class Footprint:
    """What a run takes."""

    particles: int
    nodes: tuple[int, ...]
    """Of the grid along each axis."""
    frames: int
    """With the first."""
    steps: int
    """At least: a frame whose particles move fast has more."""
    bytes: int
    """Of memory, at the peak, of the whole process."""

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
    """What a run of `scene` on so many `workers` takes, its frames in a file or in memory.

    Raises InputError for one that no machine could make.
    """
    features = features_of([scene], precision, record=record, shared=workers > 1, gpu=gpu)
    substeps = substeps_per_frame(scene, [scene.material_of(mass) for mass in scene.masses])
    steps = substeps * (scene.frames - 1)
    if steps > MOST_STEPS:
        raise InputError(
            f"expected at most {MOST_STEPS} steps, got {steps:.3g}, {substeps:.3g} in each frame: "
            "a softer `young`, larger cells or a shorter time",
            key="duration",
        )
    count, dimension = sum(mass_counts(scene)), features.dimension
    nodes = node_shape(scene.domain)
    real = 4 if features.precision == "f32" else 8
    particle = 8 * (2 * dimension + dimension**2 + 2) + 8
    sizes = (
        PROCESS,
        count * BESIDE * (particle + real * features.block),
        math.prod(nodes) * workers * (real * features.node + (16 if features.contact else 0)),
        STRESS * count if any(mass.k0 is not None for mass in scene.masses) else 0,
    )
    kept = len(record.kept(scene.frames))
    solids = len(scene.baffles) + len(scene.solids) + (2 * dimension + 1 if record.wall_forces else 0)
    # What is smoothed is there twice.
    numbers = dimension + (2 * (dimension + features.stresses + 2) if record.fields else 0)
    recorded = 4 * count * kept * numbers + 8 * scene.frames * (len(Energy) + 2 * solids * dimension)
    size = int(sum(sizes)) + (0 if in_file else recorded)
    return Footprint(particles=count, nodes=nodes, frames=scene.frames, steps=steps, bytes=size)


def require_memory(footprints: list[Footprint]) -> None:
    """Raise InputError where runs side by side take more memory than is free: how much, and what to change."""
    extra = sum(each.bytes - PROCESS for each in footprints)
    largest = max(footprints, key=lambda each: each.bytes)
    memory.require(
        extra,
        f"{'a run' if len(footprints) == 1 else f'{len(footprints)} runs'}",
        f"{largest}; larger cells, fewer particles_per_axis or frames (--every, --last-frame, --hdf5)",
    )
