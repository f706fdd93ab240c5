"""The arrays that the kernels work on: several scenes in a row, particles in blocks of lanes."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError, require
from datasets.flow.array_files import FrameWriter
from datasets.scene import DOMAIN_SIDES, Scene
from datasets.scene.particles import Particles, initial_particles
from mpm.arrays.features import NODE, features_of
from mpm.arrays.kernel_arguments import DEVICE, RECORD, STEP, aligned, arguments
from mpm.arrays.layout import (
    FIRST_FACE,
    GROWTH,
    INDEX_LIMIT,
    PADDING,
    Beside,
    Contact,
    Energy,
    Offset,
    Precision,
    Property,
    Setting,
    Span,
    StepControl,
    Worker,
    column_count,
    node_room,
    node_shape,
)
from mpm.arrays.properties import (
    drag_tables,
    elastic_energy,
    in_precision,
    initial_gaps,
    properties_of,
    properties_row,
    roughest,
    settings_row,
    substeps_per_frame,
)
from mpm.initial.barriers import held_tables
from mpm.initial.slope import begins_as_slope
from mpm.initial.water import initial_water
from mpm.output.recording import ALL, PRESENT, Recording, window_frames
from mpm.solids.bed import bed_arrays
from mpm.solids.obstacles import initial_contacts, near_walls, obstacles_of

Array = NDArray[Any]
PORTION = 2**18  # particles whose nearest faces are found together at the start; about 250 bytes each
TILE = 4  # cells along each side of the squares in plan by which particles in 3D are sorted


class Batch:
    """The state and the records of several scenes.

    `workers` threads share one scene; with several scenes each has one thread. `record` says what is recorded and
    whether a scene ends when its deposit is at rest. `particles` are those of each scene at the start. The positions of
    one scene can be kept in a `file`. Raises InputError for more particles times frames than can be counted.

    The kernel itself records only positions, if every frame keeps them in memory. All else (few frames, a file, other
    fields) is copied from the state between two calls of the kernel (`keep`)."""

    def __init__(
        self,
        scenes: Sequence[Scene],
        *,
        precision: Precision,
        workers: int = 1,
        record: Recording = ALL,
        gpu: bool = False,
        particles: Sequence[Particles] | None = None,
        file: FrameWriter | None = None,
    ) -> None:
        self.scenes, self.recording, self.file = list(scenes), record, file
        self.particles = particles_of(scenes) if particles is None else list(particles)
        self.features = features_of(scenes, precision, record=record, shared=workers > 1, gpu=gpu)
        features, lanes = self.features, self.features.lanes
        real = np.dtype(np.float32 if precision == "f32" else np.float64)
        pairs = list(zip(scenes, self.particles, strict=True))
        self.settings = in_precision([settings_row(s, p) for s, p in pairs], [*Setting], real)
        rows = [properties_row(material, float(p.volume[0])) for p in self.particles for material in p.materials]
        first = np.cumsum([0, *(len(p.materials) for p in self.particles)])[:-1]
        self.properties = in_precision(rows, [*Property, *features.law.Column], real)[first]
        self.drags, self.drag_places, self.drag_posts = drag_tables(scenes, real)
        self.offsets = np.zeros((len(scenes), len(Offset)), np.int32)
        self.add_contacts(real)
        tables = held_tables(scenes, self.particles, self.offsets, real)
        self.barriers, self.retained, self.settling, self.inflows = tables
        self.workers = np.zeros((len(scenes) * workers, len(Worker)), np.int32)
        self.in_kernel = record.every == 1 and not record.state and file is None
        block = column = impulse = line = recorded = recorded_impulse = 0
        for index, (scene, sand, offset) in enumerate(zip(scenes, self.particles, self.offsets, strict=True)):
            count = len(sand.positions)
            blocks = -(-count // lanes)
            nodes = [*node_shape(scene.domain), 1][:3]
            offset[Offset.BLOCK], offset[Offset.PARTICLES] = block, count
            offset[Offset.RECORD] = recorded if self.in_kernel else -1
            for axis in range(scene.dimension):
                offset[Offset.CELLS_X + axis] = nodes[axis] - 2 * PADDING - 1
            offset[Offset.ENERGY], offset[Offset.OBSTACLES] = line, len(scene.baffles) + len(scene.solids)
            offset[Offset.OPEN] = sum(1 << DOMAIN_SIDES.index(side) for side in scene.open_sides)
            offset[Offset.FRAMES], offset[Offset.IMPULSE] = scene.frames, recorded_impulse
            offset[Offset.WINDOW] = min(window_frames(scene, sand.materials), INDEX_LIMIT)
            # The impulses of the box are those of its sides and of the barriers.
            walls = 2 * scene.dimension + 1 if record.wall_forces else 0
            solids = offset[Offset.SOLIDS] = offset[Offset.OBSTACLES] + walls
            offset[Offset.SUBSTEPS] = substeps_per_frame(scene, sand.materials)
            ends = np.linspace(0, blocks, workers + 1).astype(int)
            for number in range(workers):
                worker = self.workers[index * workers + number]
                worker[Worker.SCENE], worker[Worker.COLUMN], worker[Worker.IMPULSE] = index, column, impulse
                worker[Worker.FIRST], worker[Worker.LAST] = block + ends[number], block + ends[number + 1]
                worker[Worker.SCRATCH] = (index * workers + number) * features.scratch.size
                own_particles = (ends[number + 1] - ends[number]) * lanes
                worker[Worker.ROOM] = math.prod(nodes) if gpu else node_room(scene.domain, own_particles)
                column += column_count(scene.domain)
                impulse += solids * features.dimension
            block += blocks
            recorded += count * scene.frames * self.in_kernel
            line += scene.frames
            recorded_impulse += scene.frames * solids
        scratch = (block if features.processor.gpu else len(self.workers)) * features.scratch.size
        longest = max(int(self.workers[:, Worker.ROOM].sum()) * NODE, recorded * features.dimension)
        indexed = max(block * features.state.size, scratch) * lanes
        if longest >= 2**31 or indexed >= INDEX_LIMIT:
            said = f"{longest} numbers in a row, of at most 2^31, and {indexed} of particles, of at most 2^30"
            raise InputError(f"expected a smaller run: {said}")
        self.state = aligned((block, features.state.size, lanes), real)
        self.order = np.zeros(block * lanes, np.int32)
        self.bases = np.zeros(column, np.int32)
        # Zeros take memory only where they are written: columns near the material, and nodes in use.
        self.spans = np.zeros((1 if gpu else column, len(Span)), np.int32)
        self.make_grid()
        if gpu:
            self.hold_box()
        self.scratch = aligned((scratch, lanes), real)
        self.impulse = aligned((max(impulse, 1), lanes), real)
        self.make_record(recorded, line, recorded_impulse)
        for index in range(len(scenes)):
            self.fill(index)

    def make_record(self, positions: int, frames: int, impulses: int) -> None:
        """Allocate the records of a run, with room for so many positions, frames and impulses of all scenes."""
        scenes, features, real = self.scenes, self.features, self.state.dtype
        counts = self.offsets[:, Offset.PARTICLES] * features.processor.gpu
        self.owner = np.repeat(np.arange(len(scenes), dtype=np.int32), counts)
        self.step_control = np.zeros((len(scenes), len(StepControl)), real)
        self.positions = np.zeros(max(positions * features.dimension, 1), np.float32)
        self.energy = np.zeros((frames, len(Energy)), np.float64)
        self.recorded_impulse = np.zeros((max(impulses, 1), features.dimension), np.float64)
        self.arrivals = np.zeros(len(self.workers), np.int32)
        """How often each thread has waited for the others; one entry for each thread of a call."""
        self.computed = 0
        self.record = [self.empty_record(index) for index in range(len(scenes))]
        """For each scene the recorded positions and fields of its particles by name, shape [T, N, ...] each."""
        self.staged = np.zeros((len(scenes), max(1, *(len(scene.stages) for scene in scenes))), np.int32)
        """The frame in which each stage of each scene began, 0 if it has not begun."""

    def make_grid(self) -> None:
        """A grid with as many nodes as the workers have room for. Raises InputError for more than can be counted."""
        room = self.workers[:, Worker.ROOM].astype(np.int64)
        if room.sum() * NODE >= 2**31:
            raise InputError(f"expected a smaller run: {room.sum()} nodes in use, of at most {2**31 // NODE}")
        self.workers[:, Worker.NODE] = np.cumsum(room) - room
        self.grid = aligned((int(room.sum()), NODE), self.state.dtype)
        cells = len(self.grid) if self.features.wet else 0
        # The last one stays dry.
        self.cells = aligned((2 * (cells + 1), NODE), self.state.dtype)
        self.beside = np.zeros((cells + 1, len(Beside)), np.int32)

    def grow_grid(self) -> bool:
        """Enlarge the grids of workers whose columns need more nodes than fit; return whether there were any."""
        short = self.workers[:, Worker.USED] > self.workers[:, Worker.ROOM]
        if short.any():
            self.workers[short, Worker.ROOM] = (GROWTH * self.workers[short, Worker.USED]).astype(np.int32)
            self.make_grid()
        return bool(short.any())

    def hold_box(self) -> None:
        """Hold all nodes of the boxes, as on a GPU."""
        for scene, worker in zip(self.scenes, self.workers, strict=True):
            count, first = column_count(scene.domain), int(worker[Worker.COLUMN])
            high = node_shape(scene.domain)[1]
            self.bases[first : first + count] = worker[Worker.NODE] + high * np.arange(count)

    def add_contacts(self, real: np.dtype[Any]) -> None:
        """The faces of the solids of all scenes, which of them are near each cell, and the nodes that solids hold; the
        beds of their terrains. Raises InputError for more faces than can be told apart."""
        scenes = self.scenes if self.features.contact else self.scenes[:1]
        obstacles, self.first_obstacles = obstacles_of(scenes)
        self.offsets[: len(scenes), Offset.GEOMETRY] = self.first_obstacles[:-1, 0]
        for offset, window in zip(self.offsets, obstacles.windows, strict=False):
            offset[Offset.WINDOW_LOW_X : Offset.WINDOW_LOW_X + len(window.low)] = window.low
            offset[Offset.WINDOW_X : Offset.WINDOW_X + len(window.low)] = window.shape
        faces, self.beds = len(obstacles.faces), obstacles.beds
        require(faces < 2 * FIRST_FACE, "solids", f"fewer than {2 * FIRST_FACE} faces", str(faces))
        mosts = [roughest(scene) for scene in scenes]
        self.terrain, self.column_heights = bed_arrays(self.beds, mosts, faces, self.offsets, real)

        def table(values: Array, kind: np.dtype[Any] | type) -> Array:
            """`values` as the kernel takes them: never empty."""
            return values.astype(kind) if len(values) else np.zeros((1, *values.shape[1:]), kind)

        self.faces, self.holds = table(obstacles.faces, real), table(obstacles.holds - [FIRST_FACE, 0.0, 0.0], real)
        self.cell_distance = table(obstacles.cell_distance, real)
        self.cell_faces, self.near_faces = table(obstacles.cell_faces, np.int32), table(obstacles.near_faces, np.int32)
        self.node_holds = table(obstacles.node_holds, np.int32)
        self.covered = table(obstacles.covered, np.int32)

    def fill(self, index: int) -> None:
        """Set the initial state of one scene, and frame 0 of its record if that is kept."""
        scene, particles, features = self.scenes[index], self.particles[index], self.features
        state, count = self.state_of(index), len(particles.positions)
        source = np.minimum(np.arange(state.shape[0] * features.lanes), count - 1)  # spare lanes mirror the last one

        def put(first: int, values: Array) -> None:
            put_vectors(state, first, values[source])

        put(0, particles.positions)
        if features.compensated:
            put(features.state.remainder, particles.positions - particles.positions.astype(np.float32))
        put(features.state.velocity, particles.velocities * particles.present[:, None])
        if features.volume_correction:
            put(features.state.gap, initial_gaps(scene, particles))
        for first in range(0, len(source) if features.contact else 0, PORTION):
            contacts = initial_contacts(scene, particles.positions[source[first : first + PORTION]])
            face, (first_face, end) = contacts[:, Contact.FACE], self.first_obstacles[index : index + 2, 1]
            terrain = self.offsets[index, Offset.TERRAIN_FACE]
            contacts[:, Contact.FACE] = np.where(face < end - first_face, face + first_face, terrain) - FIRST_FACE
            portion = state[first // features.lanes :][: PORTION // features.lanes]
            put_vectors(portion, features.state.contacts, contacts)
        if particles.velocity_gradients.any():
            put(features.state.affine, particles.velocity_gradients.reshape(count, -1))
        if features.pores or any(mass.k0 is not None or begins_as_slope(scene, mass) for mass in scene.masses):
            # Imported here: most runs begin without stress and need no sparse solver.
            from mpm.initial.stress import initial_tractions

            water = None
            if features.pores:
                near = near_walls(scene, particles.positions)
                if features.contact:
                    near |= state[:, features.state.contacts + Contact.DELTA].ravel()[:count] > 0.0
                pores, slope = water = initial_water(scene, particles, near)
                put(features.state.pore_pressure, pores[:, : 1 + features.wet])
                place = features.state.seepage if features.seeps else features.state.pressure_slope
                put(place, -slope if features.seeps else slope)
            stress, shear = initial_tractions(scene, particles, particles.positions.astype(state.dtype), water)
            put(features.state.stress, stress)
            if features.contact:
                put(features.state.contacts + Contact.NORMAL + features.dimension, shear)
            self.energies(index)[0, Energy.ELASTIC] = elastic_energy(particles, stress)
        if features.own_columns > 0:
            put(features.state.properties, properties_of(particles)[:, : features.own_columns])
        if features.recorded.until_rest:
            put(features.state.before, particles.velocities * particles.present[:, None])
        real = np.arange(len(source)) < count
        state[:, features.state.present] = (real & particles.present[source]).reshape(-1, features.lanes)
        if features.inflow and particles.entry_time is not None:
            frames = real * particles.entry_time[source] / scene.frame_dt
            put_vectors(state, features.state.entry, np.column_stack([frames, particles.velocities[source]]))
        first = self.offsets[index, Offset.BLOCK] * features.lanes
        self.order[first : first + len(source)] = source
        if self.recording.every > 0:
            self.store(index, 0)
        all_mass = particles.density * particles.volume
        mass, energies = all_mass * particles.present, self.energies(index)
        energies[0, Energy.ABSENT] = 1.0 - mass.sum() / all_mass.sum()
        affine = 0.25 * scene.domain.cell**2 * np.einsum("nij,nij->n", *2 * [particles.velocity_gradients])
        energies[0, Energy.KINETIC] = 0.5 * np.sum(mass * (np.sum(particles.velocities**2, axis=1) + affine))
        energies[0, Energy.POTENTIAL] = -np.sum(mass * (particles.positions @ scene.gravity_vector))

    def empty_record(self, index: int) -> dict[str, NDArray[np.float32]]:
        """Room for the records of the particles of one scene; for a single frame if they go to a file."""
        features, count = self.features, int(self.offsets[index, Offset.PARTICLES])
        kept = 1 if self.file is not None else len(self.kept(index))
        if self.in_kernel:
            first = self.offsets[index, Offset.RECORD] * features.dimension
            return {"positions": self.positions[first:][: kept * count * features.dimension].reshape(kept, count, -1)}
        shapes: dict[str, tuple[int, ...]] = {"positions": (features.dimension,)}
        if self.recording.fields:
            shapes |= {"velocities": (features.dimension,), "stress": (features.stresses,), "plastic_strain": ()}
        shapes |= {"pore_pressure": ()} if self.recording.state and features.pores else {}
        return {name: np.zeros((kept, count, *shape), np.float32) for name, shape in shapes.items()}

    def store(self, index: int, slot: int) -> None:
        """Record the present state of one scene as kept frame `slot`, or as the next one of the file."""
        features, order = self.features, self.order_of(index)
        first = {"positions": 0, "velocities": features.state.velocity, "stress": features.state.stress}
        first |= {"plastic_strain": features.state.plastic_strain, "pore_pressure": features.state.pore_pressure}
        for name, array in self.record[index].items():
            numbers = self.numbers(index, first[name], math.prod(array.shape[2:]))
            array[0 if self.file is not None else slot, order] = numbers.T.reshape(array.shape[1:])
        if self.file is not None:
            self.file.append(positions=self.record[index]["positions"])

    def keep(self, first: int) -> None:
        """Record the computed frames from `first` on that are kept and that the kernel does not record."""
        for index in range(0 if self.in_kernel else len(self.scenes)):
            last = int(self.offsets[index, Offset.REST]) or self.computed
            for slot, frame in enumerate(self.kept(index)):
                if first <= frame <= min(last, self.computed):
                    self.store(index, slot)

    def sort(self, index: int) -> None:
        """Sort the particles of one scene by cell, in 3D tile by tile, so that neighbours are close in memory."""
        state, features, cell = self.state_of(index), self.features, self.scenes[index].domain.cell
        x, y, *z = (np.floor(state[:, axis].ravel() / cell).astype(np.int64) for axis in range(features.dimension))
        key = np.zeros_like(x)
        for number in (x // TILE, z[0] // TILE, x % TILE, z[0] % TILE, y) if z else (x, y):
            key = key * (number.max() + 1) + number
        count = len(self.particles[index].positions)
        key[count:] = np.iinfo(np.int64).max
        order = np.argsort(key, kind="stable")
        for vector in range(features.state.size):
            state[:, vector] = state[:, vector].ravel()[order].reshape(-1, features.lanes)
        first = self.offsets[index, Offset.BLOCK] * features.lanes
        self.order[first : first + len(order)] = self.order[first : first + len(order)][order]

    def put_contacts_first(self, index: int) -> None:
        """Put particles of one scene that touch a solid first in each worker's part: few blocks compute contact."""
        state, order, lanes = self.state_of(index), self.order_of(index), self.features.lanes
        touch = state[:, self.features.state.contacts + Contact.DELTA].ravel()[: len(order)] > 0.0
        for worker in self.workers[self.workers[:, Worker.SCENE] == index]:
            first, last = (worker[Worker.FIRST : Worker.LAST + 1] - self.offsets[index, Offset.BLOCK]) * lanes
            behind = first + int(np.count_nonzero(touch[first:last]))
            here = np.flatnonzero(~touch[first:behind]) + first
            there = np.flatnonzero(touch[behind:last]) + behind
            new, old = np.concatenate([here, there]), np.concatenate([there, here])
            state[new // lanes, :, new % lanes] = state[old // lanes, :, old % lanes]
            order[new] = order[old]

    @property
    def arguments(self) -> dict[str, Array]:
        """The arrays by name, in the order of the kernel's parameters; memory with two views appears twice."""
        return arguments(STEP | RECORD | DEVICE, vars(self), self.features.lanes)

    def state_of(self, index: int) -> Array:
        """Blocks of one scene, shape [blocks, vectors, lanes]; a view."""
        first = self.offsets[index, Offset.BLOCK]
        return self.state[first : first - (-self.offsets[index, Offset.PARTICLES] // self.features.lanes)]

    def numbers(self, index: int, first: int, count: int) -> Array:
        """`count` vectors, from `first` on, of the particles of one scene in the order of memory, shape [count, N]."""
        flat = np.moveaxis(self.state_of(index)[:, first : first + count], 1, 0).reshape(count, -1)
        return flat[:, : self.offsets[index, Offset.PARTICLES]]

    def order_of(self, index: int) -> NDArray[np.int32]:
        """The particle of one scene at each place in memory, shape [N]; a view."""
        first = self.offsets[index, Offset.BLOCK] * self.features.lanes
        return self.order[first : first + self.offsets[index, Offset.PARTICLES]]

    def kept(self, index: int) -> list[int]:
        """The numbers of the frames of one scene that are kept."""
        return self.recording.kept(self.scenes[index].frames)

    def recorded(self, index: int) -> NDArray[np.float32]:
        """Positions of one scene in the kept frames [m], shape [T, N, D]; a view."""
        return self.record[index]["positions"] if self.file is None else self.file.frames("positions")

    def ended(self, frame: int) -> NDArray[np.bool_]:
        """Which scenes have ended before `frame`, shape [scenes]."""
        return np.asarray((self.offsets[:, Offset.FRAMES] <= frame) | (self.offsets[:, Offset.REST] > 0))

    def energies(self, index: int) -> NDArray[np.float64]:
        """`Energy` of one scene in all of its frames, kept or not, shape [frames, len(Energy)]; a view."""
        first = self.offsets[index, Offset.ENERGY]
        return self.energy[first : first + self.scenes[index].frames]

    def present(self, index: int) -> NDArray[np.float64]:
        """Share of the mass of one scene that is in its box, in all of its frames, at least PRESENT, shape [frames]."""
        return np.maximum(1.0 - self.energies(index)[:, Energy.ABSENT], PRESENT)

    def impulses(self, index: int) -> NDArray[np.float64]:
        """Momentum that solids have taken up to each frame [N s, per metre of width in 2D], shape [frames, solids, D].

        The solids come in the order of the scene, baffles first; then, if asked for, the sides of the box, in the order
        of `datasets.scene.DOMAIN_SIDES`, and the barriers."""
        frames, first = self.scenes[index].frames, self.offsets[index, Offset.IMPULSE]
        solids = int(self.offsets[index, Offset.SOLIDS])
        recorded_impulse = self.recorded_impulse[first : first + frames * solids]
        return np.cumsum(recorded_impulse.reshape(frames, solids, self.features.dimension), axis=0)


def particles_of(scenes: Sequence[Scene]) -> list[Particles]:
    """The particles of each scene at the start."""
    return [initial_particles(scene) for scene in scenes]


def put_vectors(blocks: Array, first: int, rows: Array) -> None:
    """Put the K numbers of each lane, shape [blocks * lanes, K], in the vectors of its block from `first` on."""
    columns = rows.reshape(len(blocks), blocks.shape[2], -1)
    blocks[:, first : first + columns.shape[2]] = np.moveaxis(columns, 1, 2)
