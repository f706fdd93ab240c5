"""The arrays that the kernels work on: several scenes in a row, particles in blocks of lanes."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.material import Material
from datasets.particles import Particles, initial_particles
from datasets.scene import Scene
from mpm.layout import (
    ALIGNMENT,
    PADDING,
    Energy,
    Features,
    Field,
    Gate,
    Held,
    Holding,
    Offset,
    Precision,
    Property,
    Setting,
    StepControl,
    Worker,
)
from mpm.release import gate_rows, held_rows, holding_rows, release_times

Array = NDArray[Any]


class Batch:
    """The state of several scenes and what is recorded of it.

    `workers` threads share one scene; with several scenes each has one. `fields` records velocity, pressure and plastic
    strain too; `until_rest` lets a scene end when its deposit has come to rest. Raises InputError for more particles times
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
        self.particles = [initial_particles(scene) for scene in scenes]
        self.features = features_of(
            scenes, self.particles, precision, fields=fields, until_rest=until_rest, shared=workers > 1, gpu=gpu
        )
        features, lanes = self.features, self.features.lanes
        real = np.dtype(np.float32 if precision == "f32" else np.float64)

        self.settings = np.array([settings_row(s, p) for s, p in zip(scenes, self.particles, strict=True)], real)
        self.properties = np.array([properties_row(p.materials[0], float(p.volume[0])) for p in self.particles], real)
        boxes = [[*np.add(b.lower, np.divide(b.size, 2)), *np.divide(b.size, 2)] for s in scenes for b in s.baffles]
        self.baffles = np.array(boxes or [[0.0]], real)
        self.offsets = np.zeros((len(scenes), len(Offset)), np.int32)
        self.add_gates()
        self.workers = np.zeros((len(scenes) * workers, len(Worker)), np.int32)
        block = node = impulse = line = baffle = recorded = recorded_impulse = 0
        for index, (scene, particles, offset) in enumerate(zip(scenes, self.particles, self.offsets, strict=True)):
            count = len(particles.positions)
            blocks = -(-count // lanes)
            cells = [round(length / scene.domain.cell) for length in scene.domain.size]
            nodes = [c + 2 * PADDING + 1 for c in cells] + [1] * (3 - len(cells))
            offset[Offset.BLOCK], offset[Offset.PARTICLES], offset[Offset.RECORD] = block, count, recorded
            offset[Offset.CELLS_X : Offset.CELLS_X + len(cells)] = cells
            offset[Offset.ENERGY], offset[Offset.BAFFLE], offset[Offset.BAFFLES] = line, baffle, len(scene.baffles)
            offset[Offset.FRAMES], offset[Offset.IMPULSE] = scene.frames, recorded_impulse
            solids = offset[Offset.SOLIDS] = len(scene.baffles) + int(fields)
            offset[Offset.SUBSTEPS] = substeps_per_frame(scene, particles.materials)
            ends = np.linspace(0, blocks, workers + 1).astype(int)
            for number in range(workers):
                worker = self.workers[index * workers + number]
                worker[Worker.SCENE], worker[Worker.NODE], worker[Worker.IMPULSE] = index, node, impulse
                worker[Worker.FIRST], worker[Worker.LAST] = block + ends[number], block + ends[number + 1]
                worker[Worker.SCRATCH] = (index * workers + number) * features.scratch
                # The first clearing covers everything, then the box closes around the material.
                worker[Worker.HIGH_X : Worker.HIGH_X + 3] = nodes
                node += math.prod(nodes)
                impulse += solids * features.dimension
            block += blocks
            recorded += count * scene.frames
            line += scene.frames
            baffle += len(scene.baffles)
            recorded_impulse += scene.frames * solids
        per_point = features.dimension + (len(Field) if fields else 0)
        longest = max(block * features.block * lanes, node * features.node, recorded * per_point)
        if longest >= 2**31:
            raise InputError(f"expected a smaller run: {longest} numbers in a row, Taichi counts to 2^31")
        self.state = aligned((block, features.block, lanes), real)
        self.order = np.zeros(block * lanes, np.int32)
        self.grid = aligned((node, features.node), real)
        counts = [len(particles.positions) for particles in self.particles]
        self.owner = np.repeat(np.arange(len(scenes), dtype=np.int32), counts if gpu else 0)
        self.step_control = np.zeros((len(scenes), len(StepControl)), real)
        self.scratch = aligned(((block if features.gpu else len(self.workers)) * features.scratch, lanes), real)
        self.impulse = aligned((max(impulse, 1), lanes), real)
        self.record = np.zeros(recorded * features.dimension, np.float32)
        self.fields = np.zeros(recorded * (features.dimension + len(Field)) if fields else 1, np.float32)
        self.energy = np.zeros((line, len(Energy)), np.float64)
        self.recorded_impulse = np.zeros((max(recorded_impulse, 1), features.dimension), np.float64)
        self.barrier_count = np.zeros(1, np.int32)
        self.clamped = np.zeros(len(self.workers), np.int32)
        for index in range(len(scenes)):
            self.fill(index)

    def add_gates(self) -> None:
        """The lines of `gates`, `held` and `holding` of all scenes."""
        gates: list[list[int]] = []
        held: list[list[int]] = []
        holding: list[list[float]] = []
        for scene, particles, offset in zip(self.scenes, self.particles, self.offsets, strict=True):
            offset[Offset.GATE], offset[Offset.HELD] = len(gates), len(held)
            gates += gate_rows(scene, len(held))
            held += held_rows(scene, particles)
            holding += holding_rows(scene, particles)
            offset[Offset.GATES], offset[Offset.HELDS] = (
                len(gates) - offset[Offset.GATE],
                len(held) - offset[Offset.HELD],
            )
        self.gates = np.array(gates or [[0] * len(Gate)], np.int32)
        self.held = np.array(held or [[0] * len(Held)], np.int32)
        self.holding = np.array(holding or [[0.0] * len(Holding)], np.float64)

    def fill(self, index: int) -> None:
        """The initial state of one scene, and frame 0 of its record."""
        scene, particles, features = self.scenes[index], self.particles[index], self.features
        state, count = self.state_of(index), len(particles.positions)
        # Lanes without a particle of their own mirror the last one.
        source = np.minimum(np.arange(state.shape[0] * features.lanes), count - 1)

        def put(first: int, values: Array) -> None:
            columns = values[source].reshape(state.shape[0], features.lanes, -1)
            state[:, first : first + columns.shape[2]] = np.moveaxis(columns, 1, 2)

        put(0, particles.positions)
        if features.compensated:
            put(features.remainder, particles.positions - particles.positions.astype(np.float32))
        put(features.velocity, particles.velocities)
        if any(mass.k0 is not None for mass in scene.masses):
            # Imported here: most runs begin without stress and need no sparse solver.
            from mpm.initial_stress import initial_stress

            stress = initial_stress(scene, particles, particles.positions.astype(state.dtype))
            put(features.stress, stress)
            if features.fields:
                self.recorded_fields(index)[0, :, features.dimension + Field.PRESSURE] = -stress[:, :3].mean(axis=1)
            self.energies(index)[0, Energy.ELASTIC] = elastic_energy(particles, stress)
        if features.heterogeneous:
            properties = np.array([properties_row(m, 0.0) for m in particles.materials])[particles.material]
            properties[:, Property.VOLUME] = particles.volume
            put(features.properties, properties)
        state[:, features.present] = (np.arange(len(source)) < count).reshape(-1, features.lanes)
        first = self.offsets[index, Offset.BLOCK] * features.lanes
        self.order[first : first + len(source)] = source
        self.recorded(index)[0] = particles.positions
        if features.fields:
            self.recorded_fields(index)[0, :, : features.dimension] = particles.velocities
        mass = particles.density * particles.volume
        energies = self.energies(index)
        energies[0, Energy.KINETIC] = 0.5 * np.sum(mass * np.sum(particles.velocities**2, axis=1))
        energies[0, Energy.POTENTIAL] = -np.sum(mass * (particles.positions @ scene.gravity_vector))

    def sort(self, index: int) -> None:
        """Put the particles of one scene in the order of their cells, so that neighbours in space are so in memory."""
        state, features, scene = self.state_of(index), self.features, self.scenes[index]
        numbers = np.moveaxis(state, 1, 0).reshape(features.block, -1)
        cells = np.floor(numbers[: features.dimension] / scene.domain.cell).astype(np.int64)
        key = cells[0]
        for axis in range(1, features.dimension):
            key = key * (round(scene.domain.size[axis] / scene.domain.cell) + 1) + cells[axis]
        count = len(self.particles[index].positions)
        key[count:] = np.iinfo(np.int64).max
        order = np.argsort(key, kind="stable")
        state[:] = np.moveaxis(numbers[:, order].reshape(features.block, -1, features.lanes), 0, 1)
        first = self.offsets[index, Offset.BLOCK] * features.lanes
        self.order[first : first + len(order)] = self.order[first : first + len(order)][order]

    @property
    def arguments(self) -> dict[str, Array]:
        """The arrays by name, in the order of the kernel's parameters; memory that is seen in two ways comes twice."""
        lanes = self.features.lanes
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
            "offsets": self.offsets,
            "workers": self.workers,
            "order": self.order,
            "record": self.record,
            "fields": self.fields,
            "energy": self.energy.reshape(-1),
            "recorded_impulse": self.recorded_impulse,
            "barrier_count": self.barrier_count,
            "clamped": self.clamped,
            "owner": self.owner,
            "step_control": self.step_control,
            "gates": self.gates,
            "held": self.held,
            "holding": self.holding,
        }

    @property
    def first_nodes(self) -> Array:
        """Where the grid of each worker begins, shape [workers]."""
        return self.workers[:, Worker.NODE]

    def state_of(self, index: int) -> Array:
        """Blocks of one scene, shape [blocks, vectors, lanes]; a view."""
        first = self.offsets[index, Offset.BLOCK]
        return self.state[first : first - (-self.offsets[index, Offset.PARTICLES] // self.features.lanes)]

    def frames_of(self, array: Array, index: int, width: int) -> Array:
        """The part of a flat record with `width` numbers a particle that belongs to one scene, [T, N, width]; a view."""
        first, count = self.offsets[index, Offset.RECORD] * width, int(self.offsets[index, Offset.PARTICLES])
        frames = self.scenes[index].frames
        return array[first : first + frames * count * width].reshape(frames, count, width)

    def recorded(self, index: int) -> NDArray[np.float32]:
        """Positions of one scene [m], shape [T, N, D]; a view."""
        return self.frames_of(self.record, index, self.features.dimension)

    def recorded_fields(self, index: int) -> NDArray[np.float32]:
        """Velocity [m/s] and what `Field` lists of one scene, shape [T, N, D + len(Field)]; a view."""
        return self.frames_of(self.fields, index, self.features.dimension + len(Field))

    def release_times(self, index: int) -> list[float | None] | None:
        """When each mass of one scene was let go [s]; see `mpm.release.release_times`."""
        first = self.offsets[index, Offset.HELD]
        opened = self.held[first : first + self.offsets[index, Offset.HELDS], Held.OPENED]
        return release_times(self.scenes[index], opened)

    def energies(self, index: int) -> NDArray[np.float64]:
        """Energies of one scene [J, per metre of width in 2D], shape [T, len(Energy)]; a view."""
        first = self.offsets[index, Offset.ENERGY]
        return self.energy[first : first + self.scenes[index].frames]

    def impulses(self, index: int) -> NDArray[np.float64]:
        """Momentum that each solid has taken up to each frame [N s, per metre of width in 2D], shape [T, solids, D].

        The baffles in the order of the scene, then all walls of the box together where fields are recorded.
        """
        scene, first, solids = (
            self.scenes[index],
            self.offsets[index, Offset.IMPULSE],
            int(self.offsets[index, Offset.SOLIDS]),
        )
        recorded_impulse = self.recorded_impulse[first : first + scene.frames * solids]
        return np.cumsum(recorded_impulse.reshape(scene.frames, solids, self.features.dimension), axis=0)


def features_of(
    scenes: Sequence[Scene],
    particles: Sequence[Particles],
    precision: Precision,
    *,
    fields: bool = False,
    until_rest: bool = False,
    shared: bool = False,
    gpu: bool = False,
) -> Features:
    """What has to be compiled for these scenes, all of one dimension."""
    materials = [material for each in particles for material in each.materials]
    return Features(
        dimension=scenes[0].dimension,
        precision=precision,
        relaxed=any(scene.relaxation > 0.0 for scene in scenes),
        damped=any(scene.damping > 0.0 for scene in scenes),
        cohesive=any(material.cohesion > 0.0 for material in materials),
        dilates=any(material.dilation_deg > 0.0 for material in materials),
        corrected=any(scene.volume_correction for scene in scenes),
        heterogeneous=any(len(each.materials) > 1 or each.common_volume is None for each in particles),
        baffles=any(scene.baffles for scene in scenes),
        fields=fields,
        gated=any(mass.release is not None for scene in scenes for mass in scene.masses),
        rests=until_rest,
        shared=shared,
        gpu=gpu,
    )


def elastic_energy(particles: Particles, stress: Array) -> float:
    """Sum of V0 [(1 + nu) sigma : sigma - nu (tr sigma)^2] / (2 E) [J]; stress [Pa], shape [N, 4 or 6]."""
    rows = np.array([properties_row(material, 0.0) for material in particles.materials])[particles.material]
    square = (stress[:, :3] ** 2).sum(axis=1) + 2.0 * (stress[:, 3:] ** 2).sum(axis=1)
    trace = stress[:, :3].sum(axis=1)
    each = rows[:, Property.ELASTIC_DEVIATOR] * square - rows[:, Property.ELASTIC_TRACE] * trace**2
    return float(particles.volume @ each)


def aligned(shape: tuple[int, ...], real: np.dtype[Any]) -> Array:
    """Zeros that begin at a multiple of ALIGNMENT bytes."""
    size = math.prod(shape) * real.itemsize
    memory = np.zeros(size + ALIGNMENT, np.uint8)
    offset = -memory.ctypes.data % ALIGNMENT
    return memory[offset : offset + size].view(real).reshape(shape)


def substeps_per_frame(scene: Scene, materials: Sequence[Material]) -> int:
    """Steps in a frame: the fewest whose dt is at most `step_fraction` * cell / (fastest wave speed).

    Fixed for a scene, because APIC's dissipation is per step; the kernel takes more in a frame whose particles move so
    fast that (wave speed + speed) dt would leave the cell.
    """
    fastest = max(material.wave_speed for material in materials)
    return math.ceil(scene.frame_dt * fastest / (scene.step_fraction * scene.domain.cell))


def settings_row(scene: Scene, particles: Particles) -> list[float]:
    """One line of `settings`, in the order of `Setting`."""
    values = {
        Setting.CELL: scene.domain.cell,
        Setting.FRAME_DT: scene.frame_dt,
        Setting.GRAVITY_X: scene.gravity_vector[0],
        Setting.GRAVITY_Y: scene.gravity_vector[1],
        Setting.FLOOR_FRICTION: scene.floor_friction,
        Setting.WALL_FRICTION: scene.wall_friction,
        Setting.BAFFLE_FRICTION: scene.baffle_friction,
        Setting.DAMPING: scene.damping,
        Setting.CORRECTED: float(scene.volume_correction),
        Setting.WAVE_SPEED: max(material.wave_speed for material in particles.materials),
        Setting.RELAXATION_RATE: 1.0 / scene.relaxation if scene.relaxation > 0.0 else 0.0,
    }
    return [values[column] for column in Setting]


def properties_row(material: Material, volume: float) -> list[float]:
    """One line of `properties`, in the order of `Property`; `volume` of a particle [m^D]."""
    friction, dilation = math.radians(material.friction_deg), math.radians(material.dilation_deg)
    values = {
        Property.VOLUME: volume,
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
