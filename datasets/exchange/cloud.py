"""What the other codes' formats share: sand and obstacles in one cloud of particles; keys of `metadata.json`."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from inspect import signature
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.exchange.baffle_particles import obstacle_particles
from datasets.records import Record, from_mapping, read_json
from datasets.trajectory import Trajectory

M = TypeVar("M", bound=Record)

FARTHEST = 1.0e6
"""Positions [m] beyond this mean a broken file; single precision would tell them no better than to 6 cm."""
STEEPEST = 1.0e3
"""A tan(phi) beyond this is none."""


@dataclass(frozen=True, kw_only=True)
class Cloud:
    """One trajectory as the other codes store it."""

    name: str
    positions: NDArray[np.floating]
    """Positions [m], shape [T, N, D]."""
    stationary: NDArray[np.bool_]
    """Which particles are obstacles, shape [N]; the others are sand."""
    friction: NDArray[np.float32] | None
    """tan(phi) of each particle [-], shape [N], 0 for obstacles; None where the file does not say."""


@dataclass(frozen=True, kw_only=True)
class ForeignMetadata(Record):
    """What Talus uses of another code's `metadata.json`."""

    bounds: tuple[tuple[float, float], ...]
    """Lower and upper end of the box per axis [m]."""
    dim: int
    dt: float
    """Time between frames [s]; in LagrangeBench of the solver, whose every `write_every`-th step is a frame."""
    default_connectivity_radius: float
    """Radius of their neighbour search [m]."""
    dx: float | None = None
    """Spacing of the particles at the start [m]."""
    write_every: int = 1
    periodic_boundary_conditions: tuple[bool, ...] = ()

    @property
    def frame_dt(self) -> float:
        """Time between two frames [s]."""
        return self.dt * self.write_every

    def __post_init__(self) -> None:
        def require(ok: bool, key: str, expected: str) -> None:
            if not ok:
                raise InputError(f"expected {expected}, got {getattr(self, key)}", key=key)

        require(self.dim in (2, 3), "dim", "2 or 3")
        require(
            len(self.bounds) == self.dim and all(low < high for low, high in self.bounds),
            "bounds",
            f"a lower and an upper end for {self.dim} axes",
        )
        require(self.dt > 0.0, "dt", "a positive time in s")
        require(self.write_every > 0, "write_every", "a positive number of steps")
        require(self.dx is None or self.dx > 0.0, "dx", "a positive length in m")
        require(
            not any(self.periodic_boundary_conditions),
            "periodic_boundary_conditions",
            "walls on all sides, for a scene has no other",
        )


@dataclass(frozen=True, kw_only=True)
class Statistics(Record):
    """What another code's `metadata.json` shares with that of Talus."""

    default_connectivity_radius: float
    """Radius of their neighbour search [m]."""
    vel_mean: tuple[float, ...]
    """[m per frame]"""
    vel_std: tuple[float, ...]
    acc_mean: tuple[float, ...]
    """[m per frame^2]"""
    acc_std: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Described:
    """What another code's `metadata.json` says of a dataset of Talus."""

    size: tuple[float, ...]
    """Extent of the box [m]; its lower corner is the origin."""
    frame_dt: float
    """Time between two frames [s]."""
    frames: int
    """Frames of a trajectory, T, the start included."""
    spacing: float
    """Spacing of the particles at the start [m]."""
    particles: int
    """Most particles of a trajectory, obstacles included."""
    trajectories: dict[str, int]
    """How many there are, per split."""
    statistics: Statistics

    def shared_keys(self) -> dict[str, Any]:
        """The keys that the layouts share."""
        return {
            "bounds": [[0.0, length] for length in self.size],
            "dim": len(self.size),
            "dt": self.frame_dt,
            "dx": self.spacing,
            **asdict(self.statistics),
        }


def read_metadata(path: Path) -> dict[str, Any]:
    """Read a `metadata.json`. Raises InputError, also where there is none."""
    data = read_json(path)
    if data is None:
        raise InputError("expected a JSON file, there is none", where=str(path))
    return data


def known_keys(kind: type[M], data: Mapping[str, Any], where: Path) -> M:
    """Build `kind` from the keys of `data` that it knows; another code's file may have others. Raises InputError."""
    names = signature(kind).parameters
    try:
        return from_mapping(kind, {name: data[name] for name in names if name in data})
    except InputError as error:
        raise error.at(str(where)) from None


def cloud_of(trajectory: Trajectory, name: str) -> Cloud:
    """Sand and, after it, the lattices of particles that stand for the baffles, at the spacing of the sand's cells."""
    scene, sand = trajectory.scene, trajectory.positions
    share = scene.particle_spacing
    obstacles = np.concatenate(
        [np.empty((0, scene.dimension)), *(obstacle_particles(baffle, share) for baffle in scene.baffles)]
    ).astype(np.float32)
    return Cloud(
        name=name,
        positions=np.concatenate([sand, np.broadcast_to(obstacles, (len(sand), *obstacles.shape))], axis=1),
        stationary=np.repeat([False, True], [sand.shape[1], len(obstacles)]),
        friction=np.concatenate([trajectory.friction, np.zeros(len(obstacles), np.float32)]),
    )


def checked_cloud(name: str, positions: Any, types: Any, material: Any, *, stationary: Mapping[int, bool]) -> Cloud:
    """A cloud from what another code's file holds; `stationary` says of each type that is understood whether it is one.

    Raises InputError, which names the trajectory, for anything else than positions [T, N, D], one type per
    particle or for all, and at most one material property per particle, per particle of sand, or for all.
    """

    def require(ok: bool, expected: str, got: object) -> None:
        if not ok:
            raise InputError(f"expected {expected}, got {got}", key=name)

    require(isinstance(positions, np.ndarray), "positions as an array", type(positions).__name__)
    require(positions.dtype.kind == "f", "positions in floating point", positions.dtype)
    require(
        positions.ndim == 3 and positions.shape[2] in (2, 3) and len(positions) > 1 and positions.shape[1] > 0,
        "positions of shape [T, N, 2 or 3] over two frames or more",
        positions.shape,
    )
    require(bool((abs(positions) < FARTHEST).all()), f"positions within {FARTHEST:g} m", "others, or nan")
    count = positions.shape[1]
    require(isinstance(types, np.ndarray | np.integer | int), "types as an array", type(types).__name__)
    types = np.asarray(types)
    require(types.dtype.kind in "iu", "types as integers", types.dtype)
    require(types.shape in ((), (count,)), f"one type for all particles or for each of {count}", types.shape)
    found = sorted(set(types.ravel().tolist()))
    require(set(found) <= stationary.keys(), f"particle types of {sorted(stationary)}", found)
    still = np.broadcast_to(np.isin(types, [number for number, fixed in stationary.items() if fixed]), (count,))
    require(not still.all(), "sand that moves", "obstacles alone")
    return Cloud(
        name=name,
        positions=positions,
        stationary=still,
        friction=None if material is None else checked_friction(name, material, still),
    )


def checked_friction(name: str, material: Any, stationary: NDArray[np.bool_]) -> NDArray[np.float32]:
    """tan(phi) of each particle, shape [N], from the material property of another code's file. Raises InputError."""
    if not isinstance(material, np.ndarray | np.number | int | float):
        raise InputError(f"expected material properties as an array, got {type(material).__name__}", key=name)
    values = np.asarray(material)
    if values.dtype.kind not in "iuf" or not (abs(values) < STEEPEST).all():
        raise InputError("expected a material property that is a tan(phi), got other numbers", key=name)
    if values.ndim == 2 and values.shape[1] == 1:
        values = values[:, 0]
    friction, sand = np.zeros(len(stationary), np.float32), ~stationary
    if values.shape == stationary.shape:
        friction[sand] = values[sand]
    elif values.shape in ((), (int(sand.sum()),)):
        # The generator of geoelements leaves the obstacles out.
        friction[sand] = values
    else:
        raise InputError(
            f"expected one material property, tan(phi), for all particles or for each of {len(stationary)}, "
            f"got shape {values.shape}",
            key=name,
        )
    return friction
