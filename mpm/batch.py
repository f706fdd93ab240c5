"""The arrays that the kernels work on: several scenes in a row, points in blocks of lanes."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.material import Material
from datasets.points import MaterialPoints, material_points
from datasets.scene import Scene
from mpm.layout import ALIGNMENT, PADDING, Energy, Field, Needs, Pace, Place, Precision, Property, Setting, Worker

Array = NDArray[Any]


class Batch:
    """The state of several scenes and what is recorded of it.

    `workers` threads share one scene; with several scenes each has one. `fields` records velocity, pressure and plastic
    strain too; `until_rest` lets a scene end when its deposit has come to rest. Raises InputError for more points times
    frames than can be counted.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        *,
        precision: Precision,
        workers: int = 1,
        fields: bool = False,
        until_rest: bool = False,
        gpu: bool = False,
    ) -> None:
        self.scenes = list(scenes)
        self.points = [material_points(scene) for scene in scenes]
        self.needs = needs_of(
            scenes, self.points, precision, fields=fields, until_rest=until_rest, shared=workers > 1, gpu=gpu
        )
        needs, lanes = self.needs, self.needs.lanes
        real = np.dtype(np.float32 if precision == "f32" else np.float64)

        self.settings = np.array([settings_row(s, p) for s, p in zip(scenes, self.points, strict=True)], real)
        self.properties = np.array([properties_row(points.materials[0]) for points in self.points], real)
        boxes = [[*np.add(b.lower, np.divide(b.size, 2)), *np.divide(b.size, 2)] for s in scenes for b in s.baffles]
        self.baffles = np.array(boxes or [[0.0]], real)
        self.places = np.zeros((len(scenes), len(Place)), np.int32)
        self.workers = np.zeros((len(scenes) * workers, len(Worker)), np.int32)
        block = node = impulse = line = baffle = recorded = taken = 0
        for index, (scene, points, place) in enumerate(zip(scenes, self.points, self.places, strict=True)):
            count = len(points.positions)
            blocks = -(-count // lanes)
            cells = [round(length / scene.domain.cell) for length in scene.domain.size]
            nodes = [c + 2 * PADDING + 1 for c in cells] + [1] * (3 - len(cells))
            place[Place.BLOCK], place[Place.POINTS], place[Place.RECORD] = block, count, recorded
            place[Place.CELLS_X : Place.CELLS_X + len(cells)] = cells
            place[Place.ENERGY], place[Place.BAFFLE], place[Place.BAFFLES] = line, baffle, len(scene.baffles)
            place[Place.FRAMES], place[Place.TAKEN] = scene.frames, taken
            solids = place[Place.SOLIDS] = len(scene.baffles) + int(fields)
            place[Place.SUBSTEPS] = substeps_per_frame(scene, points.materials)
            ends = np.linspace(0, blocks, workers + 1).astype(int)
            for number in range(workers):
                worker = self.workers[index * workers + number]
                worker[Worker.SCENE], worker[Worker.NODE], worker[Worker.IMPULSE] = index, node, impulse
                worker[Worker.FIRST], worker[Worker.LAST] = block + ends[number], block + ends[number + 1]
                worker[Worker.SCRATCH] = (index * workers + number) * needs.scratch
                # The first clearing covers everything, then the box closes around the material.
                worker[Worker.HIGH_X : Worker.HIGH_X + 3] = nodes
                node += math.prod(nodes)
                impulse += solids * needs.dimension
            block += blocks
            recorded += count * scene.frames
            line += scene.frames
            baffle += len(scene.baffles)
            taken += scene.frames * solids
        per_point = needs.dimension + (len(Field) if fields else 0)
        longest = max(block * needs.block * lanes, node * needs.node, recorded * per_point)
        if longest >= 2**31:
            raise InputError(f"expected a smaller run: {longest} numbers in a row, Taichi counts to 2^31")
        self.state = aligned((block, needs.block, lanes), real)
        self.order = np.zeros(block * lanes, np.int32)
        self.grid = aligned((node, needs.node), real)
        counts = [len(points.positions) for points in self.points]
        self.owner = np.repeat(np.arange(len(scenes), dtype=np.int32), counts if gpu else 0)
        self.pace = np.zeros((len(scenes), len(Pace)), real)
        self.scratch = aligned(((block if needs.gpu else len(self.workers)) * needs.scratch, lanes), real)
        self.impulse = aligned((max(impulse, 1), lanes), real)
        self.record = np.zeros(recorded * needs.dimension, np.float32)
        self.fields = np.zeros(recorded * (needs.dimension + len(Field)) if fields else 1, np.float32)
        self.energy = np.zeros((line, len(Energy)), np.float64)
        self.taken = np.zeros((max(taken, 1), needs.dimension), np.float64)
        self.gate = np.zeros(1, np.int32)
        self.clamped = np.zeros(len(self.workers), np.int32)
        for index in range(len(scenes)):
            self.fill(index)

    def fill(self, index: int) -> None:
        """The initial state of one scene, and frame 0 of its record."""
        scene, points, needs = self.scenes[index], self.points[index], self.needs
        state, count = self.state_of(index), len(points.positions)
        # Lanes without a point of their own mirror the last one.
        source = np.minimum(np.arange(state.shape[0] * needs.lanes), count - 1)

        def put(first: int, values: Array) -> None:
            columns = values[source].reshape(state.shape[0], needs.lanes, -1)
            state[:, first : first + columns.shape[2]] = np.moveaxis(columns, 1, 2)

        put(0, points.positions)
        put(needs.velocity, points.velocities)
        if needs.several:
            rows = np.array([properties_row(material)[: needs.columns] for material in points.materials])
            put(needs.properties, rows[points.material])
        state[:, needs.present] = (np.arange(len(source)) < count).reshape(-1, needs.lanes)
        first = self.places[index, Place.BLOCK] * needs.lanes
        self.order[first : first + len(source)] = source
        self.recorded(index)[0] = points.positions
        if needs.fields:
            self.recorded_fields(index)[0, :, : needs.dimension] = points.velocities
        density = np.array([material.density for material in points.materials])[points.material]
        mass = density * points.volume
        energies = self.energies(index)
        energies[0, Energy.KINETIC] = 0.5 * np.sum(mass * np.sum(points.velocities**2, axis=1))
        energies[0, Energy.POTENTIAL] = -np.sum(mass * (points.positions @ scene.gravity_vector))

    def sort(self, index: int) -> None:
        """Put the points of one scene in the order of their cells, so that neighbours in space are so in memory."""
        state, needs, scene = self.state_of(index), self.needs, self.scenes[index]
        numbers = np.moveaxis(state, 1, 0).reshape(needs.block, -1)
        cells = np.floor(numbers[: needs.dimension] / scene.domain.cell).astype(np.int64)
        key = cells[0]
        for axis in range(1, needs.dimension):
            key = key * (round(scene.domain.size[axis] / scene.domain.cell) + 1) + cells[axis]
        count = len(self.points[index].positions)
        key[count:] = np.iinfo(np.int64).max
        order = np.argsort(key, kind="stable")
        state[:] = np.moveaxis(numbers[:, order].reshape(needs.block, -1, needs.lanes), 0, 1)
        first = self.places[index, Place.BLOCK] * needs.lanes
        self.order[first : first + len(order)] = self.order[first : first + len(order)][order]

    @property
    def arguments(self) -> dict[str, Array]:
        """The arrays by name, in the order of the kernel's parameters; memory that is seen in two ways comes twice."""
        lanes = self.needs.lanes
        return {
            "state": self.state.reshape(-1, lanes),
            "lanes": self.state.reshape(-1),
            "grid": self.grid,
            "scratch": self.scratch,
            "scratch_lanes": self.scratch.reshape(-1),
            "impulse": self.impulse,
            "impulse_lanes": self.impulse.reshape(-1),
            "settings": self.settings,
            "properties": self.properties,
            "baffles": self.baffles,
            "places": self.places,
            "workers": self.workers,
            "order": self.order,
            "record": self.record,
            "fields": self.fields,
            "energy": self.energy.reshape(-1),
            "taken": self.taken,
            "gate": self.gate,
            "clamped": self.clamped,
            "owner": self.owner,
            "pace": self.pace,
        }

    @property
    def first_nodes(self) -> Array:
        """Where the grid of each worker begins, shape [workers]."""
        return self.workers[:, Worker.NODE]

    def state_of(self, index: int) -> Array:
        """Blocks of one scene, shape [blocks, vectors, lanes]; a view."""
        first = self.places[index, Place.BLOCK]
        return self.state[first : first - (-self.places[index, Place.POINTS] // self.needs.lanes)]

    def frames_of(self, array: Array, index: int, width: int) -> Array:
        """The part of a flat record with `width` numbers a point that belongs to one scene, [T, N, width]; a view."""
        first, count = self.places[index, Place.RECORD] * width, int(self.places[index, Place.POINTS])
        frames = self.scenes[index].frames
        return array[first : first + frames * count * width].reshape(frames, count, width)

    def recorded(self, index: int) -> NDArray[np.float32]:
        """Positions of one scene [m], shape [T, N, D]; a view."""
        return self.frames_of(self.record, index, self.needs.dimension)

    def recorded_fields(self, index: int) -> NDArray[np.float32]:
        """Velocity [m/s] and what `Field` lists of one scene, shape [T, N, D + len(Field)]; a view."""
        return self.frames_of(self.fields, index, self.needs.dimension + len(Field))

    def energies(self, index: int) -> NDArray[np.float64]:
        """Energies of one scene [J, per metre of width in 2D], shape [T, len(Energy)]; a view."""
        first = self.places[index, Place.ENERGY]
        return self.energy[first : first + self.scenes[index].frames]

    def impulses(self, index: int) -> NDArray[np.float64]:
        """Momentum that each solid has taken up to each frame [N s, per metre of width in 2D], shape [T, solids, D].

        The baffles in the order of the scene, then all walls of the box together where fields are recorded.
        """
        scene, first, solids = (
            self.scenes[index],
            self.places[index, Place.TAKEN],
            int(self.places[index, Place.SOLIDS]),
        )
        taken = self.taken[first : first + scene.frames * solids]
        return np.cumsum(taken.reshape(scene.frames, solids, self.needs.dimension), axis=0)


def needs_of(
    scenes: Sequence[Scene],
    points: Sequence[MaterialPoints],
    precision: Precision,
    *,
    fields: bool = False,
    until_rest: bool = False,
    shared: bool = False,
    gpu: bool = False,
) -> Needs:
    """What has to be compiled for these scenes, all of one dimension."""
    materials = [material for each in points for material in each.materials]
    return Needs(
        dimension=scenes[0].dimension,
        precision=precision,
        damped=any(scene.damping > 0.0 for scene in scenes),
        cohesive=any(material.cohesive for material in materials),
        dilates=any(material.dilation_deg > 0.0 for material in materials),
        softens=any(material.softening_length is not None for material in materials),
        corrected=any(scene.volume_correction for scene in scenes),
        several=any(len(each.materials) > 1 for each in points),
        baffles=any(scene.baffles for scene in scenes),
        fields=fields,
        rests=until_rest,
        shared=shared,
        gpu=gpu,
    )


def aligned(shape: tuple[int, ...], real: np.dtype[Any]) -> Array:
    """Zeros that begin at a multiple of ALIGNMENT bytes."""
    size = math.prod(shape) * real.itemsize
    memory = np.zeros(size + ALIGNMENT, np.uint8)
    offset = -memory.ctypes.data % ALIGNMENT
    return memory[offset : offset + size].view(real).reshape(shape)


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
        Setting.BAFFLE_FRICTION: scene.baffle_friction,
        Setting.DAMPING: scene.damping,
        Setting.CORRECTED: float(scene.volume_correction),
        Setting.WAVE_SPEED: max(material.wave_speed for material in points.materials),
    }
    return [values[column] for column in Setting]


def properties_row(material: Material) -> list[float]:
    """One line of `properties`, in the order of `Property`; where strength grows with depth, that of the top."""
    friction, dilation = math.radians(material.friction_deg), math.radians(material.dilation_deg)
    residual = material.residual
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
        Property.RESIDUAL_SIN_PHI: math.sin(math.radians(residual.friction_deg)),
        Property.RESIDUAL_STRENGTH: 2.0 * residual.cohesion * math.cos(math.radians(residual.friction_deg)),
        Property.RESIDUAL_LIMIT: residual.tension_limit,
        Property.SOFTENING: math.sqrt(3.0) / material.softening_length if material.softening_length else 0.0,
    }
    return [values[column] for column in Property]


def properties_at(material: Material, depth: Array) -> Array:
    """Lines of `properties` of points `depth` [m] below the top of their body, shape [N]; [N, len(Property)]."""
    rows = np.tile(properties_row(material), (len(depth), 1))
    for state, strength, limit in (
        (material, Property.STRENGTH, Property.LIMIT),
        (material.residual, Property.RESIDUAL_STRENGTH, Property.RESIDUAL_LIMIT),
    ):
        cohesion, friction = state.cohesion_at(depth), math.radians(state.friction_deg)
        rows[:, strength] = 2.0 * cohesion * math.cos(friction)
        apex = cohesion / state.friction if state.friction > 0.0 else np.inf
        rows[:, limit] = np.minimum(state.tension_cutoff, apex)
    return rows
