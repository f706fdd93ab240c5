"""Scenes in, trajectories out: one scene per thread, as many side by side as asked for."""

import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from datasets.command_line import WorkFailed
from datasets.errors import InputError
from datasets.material import Material
from datasets.points import MaterialPoints, material_points
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from mpm import runtime
from mpm.advance import advance
from mpm.layout import PADDING, Energy, Place, Property, Setting
from mpm.nodes import node_width
from mpm.runtime import Precision
from mpm.summary import summarise

FRAMES_PER_LAUNCH = 20
"""Between two launches the progress bar moves and Ctrl-C is heard."""


def simulate(
    scene: Scene, *, precision: Precision = "f32", threads: int | None = None, progress: bool = False
) -> Trajectory:
    """Run one scene. Raises InputError for what the solver does not do, WorkFailed if the run blew up."""
    return simulate_many([scene], precision=precision, threads=threads, progress=progress)[0]


def simulate_many(
    scenes: Sequence[Scene], *, precision: Precision = "f32", threads: int | None = None, progress: bool = False
) -> list[Trajectory]:
    """Run scenes side by side, one per thread; each trajectory is the same to the bit as when run alone.

    `threads` defaults to all cores. Raises as `simulate`.
    """
    for scene in scenes:
        if scene.dimension != 2:
            raise InputError("expected 2 lengths, the solver is two-dimensional", key="domain.size")
        if scene.baffles:
            raise InputError("expected no baffles, the solver does not have them yet", key="baffles")
    runtime.start(precision, threads)
    batch = Batch(scenes, np.dtype(np.float32 if precision == "f32" else np.float64))
    begin = time.perf_counter()
    batch.advance(0, 0)
    compile_s = time.perf_counter() - begin

    begin = time.perf_counter()
    frames = max(scene.frames for scene in scenes)
    with tqdm(total=frames - 1, unit="frame", disable=not progress, desc="mpm") as bar:
        for first in range(1, frames, FRAMES_PER_LAUNCH):
            last = min(first + FRAMES_PER_LAUNCH, frames)
            batch.advance(first, last)
            bar.update(last - first)
    wall_s = time.perf_counter() - begin
    return [batch.trajectory(index, wall_s=wall_s, compile_s=compile_s) for index in range(len(scenes))]


class Batch:
    """The flat arrays that the kernel works on, for several scenes in a row."""

    def __init__(self, scenes: Sequence[Scene], real: np.dtype[Any]) -> None:
        self.scenes = list(scenes)
        self.points = [material_points(scene) for scene in scenes]
        self.real = real
        self.damped = any(scene.damping > 0.0 for scene in scenes)
        materials = list(dict.fromkeys(material for points in self.points for material in points.materials))
        self.dilates = any(material.dilation_deg > 0.0 for material in materials)
        self.several = any(len(points.materials) > 1 for points in self.points)

        self.settings = np.array([settings_row(s, p) for s, p in zip(scenes, self.points, strict=True)], real)
        self.properties = np.array([properties_row(material) for material in materials], real)
        self.places = np.zeros((len(scenes), len(Place)), np.int32)
        self.x = flat([points.positions for points in self.points], real)
        self.v = flat([points.velocities for points in self.points], real)
        total = len(self.x) // 2
        self.c = np.zeros(4 * total, real)
        self.sigma = np.zeros(4 * total, real)
        self.material = flat(
            [np.array([materials.index(m) for m in p.materials])[p.material] for p in self.points], np.dtype(np.int32)
        )
        point = node = record = line = 0
        for place, scene, points in zip(self.places, scenes, self.points, strict=True):
            count = len(points.positions)
            cells_x, cells_y = (round(length / scene.domain.cell) for length in scene.domain.size)
            place[Place.POINT], place[Place.POINTS] = point, count
            place[Place.NODE], place[Place.RECORD], place[Place.ENERGY] = node, record, line
            place[Place.CELLS_X], place[Place.CELLS_Y] = cells_x, cells_y
            place[Place.MATERIAL] = materials.index(points.materials[0])
            place[Place.FRAMES] = scene.frames
            place[Place.SUBSTEPS] = substeps_per_frame(scene, points.materials)
            # The first clearing covers everything, then the box closes around the material.
            place[Place.BOX_RIGHT], place[Place.BOX_TOP] = cells_x + 2 * PADDING + 1, cells_y + 2 * PADDING + 1
            point += count
            node += (cells_x + 2 * PADDING + 1) * (cells_y + 2 * PADDING + 1)
            record += 2 * count * scene.frames
            line += scene.frames
        self.grid = np.zeros(node * node_width(self.damped), real)
        self.record = np.zeros(record, np.float32)
        self.energy = np.zeros((line, len(Energy)), np.float64)
        for index, (scene, points) in enumerate(zip(scenes, self.points, strict=True)):
            self.recorded(index)[0] = points.positions
            density = np.array([material.density for material in points.materials])[points.material]
            mass = density * points.volume
            self.energies(index)[0, Energy.KINETIC] = 0.5 * np.sum(mass * np.sum(points.velocities**2, axis=1))
            self.energies(index)[0, Energy.POTENTIAL] = -np.sum(mass * (points.positions @ scene.gravity_vector))

    def advance(self, first: int, last: int) -> None:
        """Compute frames [first, last) of every scene; an empty range only compiles the kernel."""
        advance(
            self.x,
            self.v,
            self.c,
            self.sigma,
            self.material,
            self.grid,
            self.settings,
            self.properties,
            self.places,
            self.record,
            self.energy,
            first,
            last,
            self.damped,
            self.dilates,
            self.several,
        )

    def recorded(self, index: int) -> NDArray[np.float32]:
        """Positions of one scene [m], shape [T, N, 2]; a view."""
        place, frames = self.places[index], self.scenes[index].frames
        count, first = place[Place.POINTS], place[Place.RECORD]
        return self.record[first : first + 2 * count * frames].reshape(frames, count, 2)

    def energies(self, index: int) -> NDArray[np.float64]:
        """Energies of one scene [J/m], shape [T, len(Energy)]; a view."""
        first = self.places[index, Place.ENERGY]
        return self.energy[first : first + self.scenes[index].frames]

    def trajectory(self, index: int, *, wall_s: float, compile_s: float) -> Trajectory:
        """What scene `index` did. Raises WorkFailed where it blew up."""
        scene, points, positions = self.scenes[index], self.points[index], self.recorded(index).copy()
        reached = int(self.places[index, Place.FRAMES])
        if reached < scene.frames or not np.isfinite(positions).all():
            raise WorkFailed(
                f"the simulation blew up at t = {scene.frame_dt * (reached - 1):g} s; "
                f"try a step_fraction below {scene.step_fraction:g}"
            )
        return Trajectory(
            positions=positions,
            time=np.arange(scene.frames, dtype=np.float64) * scene.frame_dt,
            velocity0=points.velocities.astype(np.float32),
            friction=points.friction,
            scene=scene,
            summary=summarise(
                positions[-1],
                energy=self.energies(index),
                steps=int(self.places[index, Place.STEPS]),
                clamped=int(self.places[index, Place.CLAMPED]),
                wall_s=wall_s,
                compile_s=compile_s,
                precision="f32" if self.real == np.float32 else "f64",
            ),
        )


def substeps_per_frame(scene: Scene, materials: Sequence[Material]) -> int:
    """Steps in a frame: the fewest whose dt is at most `step_fraction` * cell / (fastest wave speed).

    Fixed for a scene, because APIC's dissipation is per step; the kernel takes more in a frame whose points move so
    fast that (wave speed + speed) dt would leave the cell.
    """
    fastest = max(material.wave_speed for material in materials)
    return math.ceil(scene.frame_dt * fastest / (scene.step_fraction * scene.domain.cell))


def settings_row(scene: Scene, points: MaterialPoints) -> list[float]:
    """One line of `settings`, in the order of `Setting`."""
    values = {
        Setting.CELL: scene.domain.cell,
        Setting.FRAME_DT: scene.frame_dt,
        Setting.VOLUME: points.volume,
        Setting.GRAVITY_X: scene.gravity_vector[0],
        Setting.GRAVITY_Y: scene.gravity_vector[1],
        Setting.FLOOR_FRICTION: scene.floor_friction,
        Setting.WALL_FRICTION: scene.wall_friction,
        Setting.DAMPING: scene.damping,
        Setting.WAVE_SPEED: max(material.wave_speed for material in points.materials),
    }
    return [values[column] for column in Setting]


def properties_row(material: Material) -> list[float]:
    """One line of `properties`, in the order of `Property`."""
    friction, dilation = math.radians(material.friction_deg), math.radians(material.dilation_deg)
    values = {
        Property.DENSITY: material.density,
        Property.LAME: material.lame,
        Property.SHEAR: material.shear_modulus,
        Property.SIN_PHI: math.sin(friction),
        Property.SIN_PSI: math.sin(dilation),
        Property.STRENGTH: 2.0 * material.cohesion * math.cos(friction),
        Property.LIMIT: material.tension_limit,
        Property.ELASTIC_DEVIATOR: (1.0 + material.poisson) / (2.0 * material.young),
        Property.ELASTIC_TRACE: material.poisson / (2.0 * material.young),
    }
    return [values[column] for column in Property]


def flat(arrays: Sequence[NDArray[Any]], kind: np.dtype[Any]) -> NDArray[Any]:
    """The arrays one after the other, in one dimension."""
    return np.concatenate([array.ravel() for array in arrays]).astype(kind)
