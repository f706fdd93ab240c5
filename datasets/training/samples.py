"""Trajectories at a model's time step, read from disk as they are needed, and samples drawn from them."""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from datasets.errors import InputError
from datasets.geometry.ground import ground_raster
from datasets.particles import mass_counts
from datasets.scene import Scene, coefficient, keyed
from datasets.trajectory import Floats, Trajectory, trajectory_files

MOVING = 0.02
"""Root mean square speed [m/s] above which a flow counts as moving."""


@dataclass(frozen=True, kw_only=True)
class Flow:
    """One trajectory, every so many frames; all of its particles."""

    name: str
    """The file it came from."""
    positions: Floats
    """Positions one step apart [m], shape [T, N, D]; may be a map of the file, of which only what is used is read."""
    velocity0: Floats
    """Initial velocities [m/s], shape [N, D]."""
    friction: Floats
    """tan(phi) of each particle [-], shape [N]."""
    cohesion: Floats
    """Cohesion of each particle [Pa], shape [N]."""
    volume: NDArray[np.float64]
    """Initial volume of each particle [m^D], shape [N]."""
    surroundings: "Surroundings"
    """Box, gravity and solids."""
    step: float
    """Time between two positions [s]."""

    @property
    def released(self) -> bool:
        """Whether it starts at rest."""
        return not self.velocity0.any()

    def over(self, length: float, time: float, stress: float) -> "Flow":
        """The same flow in other units: lengths over `length` [m], times over `time` [s], stresses over `stress`."""
        if length == time == stress == 1.0:
            return self
        return dataclasses.replace(
            self,
            positions=(self.positions / length).astype(np.float32),
            velocity0=(self.velocity0 * (time / length)).astype(np.float32),
            cohesion=(self.cohesion / stress).astype(np.float32),
            volume=self.volume / length ** len(self.surroundings.size),
            surroundings=self.surroundings.over(length, time),
            step=self.step / time,
        )

    def moves(self, time: int) -> bool:
        """Whether it moves from index `time` to the next."""
        displacements = self.positions[time + 1] - self.positions[time]
        square = float(np.square(displacements).sum(axis=1).mean())
        return square > (MOVING * self.step) ** 2

    @staticmethod
    def from_trajectory(trajectory: Trajectory, step: float, name: str, *, spacing: float = 0.01) -> "Flow":
        """Every so many frames of `trajectory` that they are `step` [s] apart. Raises InputError.

        spacing: between two elevations of the ground [m].
        """
        scene, count = trajectory.scene, trajectory.positions.shape[1]
        frame_dt = trajectory.frame_dt
        stride = round(step / frame_dt)
        if stride < 1 or abs(stride * frame_dt - step) > 1.0e-6 * step:
            expected = f"expected frames {step:g} s apart or a whole fraction of it, got {frame_dt:g}"
            raise InputError(expected, where=name)
        check_known(scene, "a model", name)
        return Flow(
            name=name,
            positions=trajectory.positions[::stride],
            velocity0=trajectory.velocity0,
            friction=trajectory.friction,
            cohesion=particle_cohesion(scene, count, trajectory.mass, name),
            volume=trajectory.volumes,
            surroundings=Surroundings.of_scene(scene, spacing),
            step=step,
        )


def check_known(scene: Scene, who: str, where: str = "") -> None:
    """Raise InputError for a scene that has what no surrogate knows: the key, and what was expected."""
    densities = {scene.material_of(mass).density for mass in scene.masses}
    refused = [
        (bool(scene.open_sides), "open_sides", "a closed box"),
        (bool(scene.stages), "stages", "a material that stays as it is"),
        (any(mass.release is not None for mass in scene.masses), "masses", "masses that are free from the start"),
        (len(densities) > 1, "masses", "masses of one density"),
    ]
    for place, solid in keyed(scene, "solids").items():
        refused.append((solid.kind != "terrain", f"{place}.kind", "baffles and terrain alone"))
        refused.append((solid.contact != "coulomb", f"{place}.contact", "Coulomb friction alone"))
    for bad, key, expected in refused:
        if bad:
            raise InputError(f"expected {expected}, {who} knows no other", where=where, key=key)


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """What is around a flow: its box, gravity and solids."""

    size: Floats
    """Extent of the domain [m], shape [D]."""
    gravity: Floats
    """Gravitational acceleration in the axes of the box [m/s^2], shape [D]."""
    floor_friction: float
    """Coulomb coefficient of the floor [-]."""
    wall_friction: float
    """Coulomb coefficient of the other walls [-]."""
    damping: float
    """Local damping [-]."""
    baffles: Floats
    """Lower and upper corner of each baffle before its turn [m], shape [K, 2, D]; K may be 0."""
    baffle_turn: Floats
    """Turn of each baffle [rad], in 2D from x to y, in 3D about the vertical from x to z; shape [K]."""
    baffle_friction: Floats
    """Coulomb coefficient of each baffle [-], shape [K]."""
    ground: tuple[Floats, Floats] | None
    """Elevation [m] and Coulomb coefficient [-] of terrain, `spacing` apart from x = 0 (and z = 0) on, [X(, Z)]."""

    def over(self, length: float, time: float) -> "Surroundings":
        """The same in other units: lengths over `length` [m], times over `time` [s]."""
        ground = None if self.ground is None else ((self.ground[0] / length).astype(np.float32), self.ground[1])
        return dataclasses.replace(
            self,
            size=(self.size / length).astype(np.float32),
            gravity=(self.gravity * (time**2 / length)).astype(np.float32),
            baffles=(self.baffles / length).astype(np.float32),
            ground=ground,
        )

    @staticmethod
    def of_scene(scene: Scene, spacing: float) -> "Surroundings":
        """Those of `scene`; spacing: between two elevations of the ground [m]."""
        ground = None
        if scene.solids:
            elevation, friction, _ = ground_raster(scene, spacing)
            ground = elevation.astype(np.float32), friction.astype(np.float32)
        lower, extent = (
            np.array([getattr(each, key) for each in scene.baffles], np.float32).reshape(-1, 1, scene.dimension)
            for key in ("lower", "size")
        )
        frictions = scene.floor_friction, scene.wall_friction, *map(scene.friction_of, scene.baffles)
        # Sand shears above what is rougher than itself.
        known = [coefficient(each, 1.0) for each in frictions]
        return Surroundings(
            size=np.array(scene.domain.size, np.float32),
            gravity=np.array(scene.gravity_vector, np.float32),
            floor_friction=known[0],
            wall_friction=known[1],
            damping=scene.damping,
            baffles=np.concatenate((lower, lower + extent), axis=1),
            baffle_turn=np.radians([each.turned_deg for each in scene.baffles]).astype(np.float32),
            baffle_friction=np.array(known[2:], np.float32),
            ground=ground,
        )


def particle_cohesion(scene: Scene, particles: int, mass: NDArray[np.int32] | None, where: str = "") -> Floats:
    """Cohesion [Pa] of each particle of a trajectory of `scene`, shape [particles].

    mass: the mass that each belongs to, where the particles are not those of `initial_particles`. Raises InputError
    where masses differ and nothing says which particle belongs to which.
    """
    values = np.array([scene.material_of(each).cohesion for each in scene.masses], np.float32)
    if mass is not None:
        return values[mass]
    if len(set(values.tolist())) == 1:
        return np.full(particles, values[0], np.float32)
    counts = mass_counts(scene)
    if sum(counts) != particles:
        message = f"expected the {sum(counts)} particles of masses that differ in cohesion, got {particles}"
        raise InputError(message, where=where, key="positions")
    return np.repeat(values, counts)


class Flows(Sequence[Flow]):
    """Flows on disk, each opened when it is asked for: all that is held of them is the names of their files."""

    def __init__(self, files: Sequence[Path], opened: Callable[[Path], Flow]) -> None:
        self._files, self._opened = tuple(files), opened

    def __len__(self) -> int:
        return len(self._files)

    def __getitem__(self, index: Any) -> Any:
        return self._opened(self._files[index])


def load_flows(dataset: Path, split: str, opened: Callable[[Path], Flow], *, progress: bool = False) -> Flows:
    """All trajectories of a split (`train`, `valid`, `test`), by file name; opened: how one is read.

    Each is opened once to see that it is whole. Raises InputError.
    """
    files = trajectory_files(dataset / split)
    if not files:
        raise InputError(f"expected trajectories in {split}/*.npz or *.h5, there are none", where=str(dataset))
    flows = Flows(files, opened)
    for _ in tqdm(flows, desc=f"{dataset.name}/{split}", unit="file", disable=not progress):
        pass
    return flows


@dataclass(frozen=True, kw_only=True)
class Thinned:
    """The particles that stay, and the volume that each of them stands for."""

    indices: NDArray[np.int64]
    """Indices of the kept particles, ascending, shape [n]."""
    volumes: NDArray[np.float32]
    """Initial volume of each kept particle [m^D], shape [n]; the sum is that of all particles."""


def thin(
    positions: NDArray[np.floating],
    volume: float | NDArray[np.floating],
    *,
    cell: float,
    kept: int,
    rng: np.random.Generator,
) -> Thinned:
    """Keep at random `kept` particles of each cell, those of more volume so much more often.

    positions: initial positions [m], shape [N, D]; volume: of the particles [m^D], one for all or shape [N];
    cell: edge of a cell [m]. The particles of a cell (all of them where it holds no more than `kept`) share its volume
    equally. Two draws from `rng` keep different particles of the same flow, which augments the training data.
    """
    cells = np.floor(positions.astype(np.float64) / cell).astype(np.int64)
    cells -= cells.min(axis=0)
    group = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    weight = np.broadcast_to(np.asarray(volume, np.float64), len(group))
    equal = bool((weight == weight[:1]).all())
    # The first of a cell is each of its particles with a probability in proportion to its volume: these are small at
    # the surface of a body, from which fronts come, and alike often chosen they would be too many there.
    shuffled = rng.permutation(len(group)) if equal else np.argsort(rng.exponential(size=len(group)) / weight)
    order = shuffled[np.argsort(group[shuffled], kind="stable")]
    _, first, count = np.unique(group[order], return_index=True, return_counts=True)
    rank = np.arange(len(order)) - np.repeat(first, count)
    each = weight[order]
    if equal:
        shared = np.repeat(count / np.minimum(count, kept), count) * each
    else:
        shared = np.repeat(np.add.reduceat(each, first) / np.minimum(count, kept), count)
    stays = rank < kept
    ascending = np.argsort(order[stays])
    return Thinned(indices=order[stays][ascending], volumes=shared[stays][ascending].astype(np.float32))


@dataclass(frozen=True, kw_only=True)
class Sample:
    """A thinned stretch of a flow: what a model is given and what it should say."""

    frames: Floats
    """Positions that are given [m], at most history + 1 of them, the last is now; shape [F, n, D]."""
    velocity0: Floats
    """Velocities at the first of these, where it is the flow's first [m/s], shape [n, D]."""
    targets: Floats
    """Positions in the coming steps [m], shape [K, n, D]."""
    friction: Floats
    """tan(phi) of each particle [-], shape [n]."""
    cohesion: Floats
    """Cohesion of each particle [Pa], shape [n]."""
    volume: Floats
    """Initial volume of each particle [m^D], shape [n]."""
    surroundings: Surroundings
    """Box, gravity and solids."""


def cut(flow: Flow, *, now: int, steps: int, history: int, cell: float, kept: int, rng: np.random.Generator) -> Sample:
    """The stretch of `flow` with `steps` after index `now` and, as far as there are, `history` displacements before.

    cell, kept, rng: which particles stay (`thin`). Of a flow on disk it reads these frames alone.
    """
    thinned = thin(flow.positions[0], flow.volume, cell=cell, kept=kept, rng=rng)
    particles = thinned.indices
    first = max(0, now - history)
    return Sample(
        frames=flow.positions[first : now + 1, particles],
        velocity0=flow.velocity0[particles],
        targets=flow.positions[now + 1 : now + 1 + steps, particles],
        friction=flow.friction[particles],
        cohesion=flow.cohesion[particles],
        volume=thinned.volumes,
        surroundings=flow.surroundings,
    )


def reflected(sample: Sample, axis: int | None, spacing: float) -> Sample:
    """The same flow in a mirror: along a horizontal `axis`, or in 3D, where that is None, with x and z exchanged.

    spacing: between two elevations of the ground [m].
    """
    around = sample.surroundings
    order, flip, origin = np.arange(len(around.size)), np.ones_like(around.size), np.zeros_like(around.size)
    if axis is None:
        order = order[::-1]
    else:
        flip[axis], origin[axis] = -1.0, around.size[axis]

    def vectors(values: Floats) -> Floats:
        return flip * values[..., order]

    def points(values: Floats) -> Floats:
        return origin + vectors(values)

    def raster(values: Floats) -> Floats:
        if axis is None:
            return values.T
        along = min(axis, 1)
        plan = spacing * np.arange(values.shape[along])
        mirrored = np.apply_along_axis(lambda line: np.interp(origin[axis] - plan, plan, line), along, values)
        return mirrored.astype(np.float32)

    return dataclasses.replace(
        sample,
        frames=points(sample.frames),
        velocity0=vectors(sample.velocity0),
        targets=points(sample.targets),
        surroundings=dataclasses.replace(
            around,
            size=around.size[order],
            gravity=vectors(around.gravity),
            # What was the lower side is now the upper.
            baffles=np.sort(points(around.baffles), axis=1),
            baffle_turn=-around.baffle_turn,
            ground=None if around.ground is None else (raster(around.ground[0]), raster(around.ground[1])),
        ),
    )
