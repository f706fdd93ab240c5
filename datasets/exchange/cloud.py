"""A trajectory as other codes store it: sand and obstacles in one cloud of particles, a type for each, and no scene."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.scene import Baffle
from datasets.trajectory import Trajectory

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


def cloud_of(trajectory: Trajectory, name: str) -> Cloud:
    """Sand and, after it, the lattices of particles that stand for the baffles, at the spacing of the sand's."""
    scene, sand = trajectory.scene, np.asarray(trajectory.positions)
    lattices = [obstacle_particles(baffle, scene.particle_spacing) for baffle in scene.baffles]
    obstacles = np.concatenate([np.empty((0, scene.dimension)), *lattices]).astype(np.float32)
    return Cloud(
        name=name,
        positions=np.concatenate([sand, np.broadcast_to(obstacles, (len(sand), *obstacles.shape))], axis=1),
        stationary=np.repeat([False, True], [sand.shape[1], len(obstacles)]),
        friction=np.concatenate([trajectory.friction, np.zeros(len(obstacles), np.float32)]),
    )


def obstacle_particles(baffle: Baffle, spacing: float) -> NDArray[np.float64]:
    """A lattice that fills `baffle`, about `spacing` [m] apart and at least two along each axis: [m], shape [N, D].

    Each particle stands in the middle of its share of the box.
    """
    axes = []
    for low, size in zip(baffle.lower, baffle.size, strict=True):
        count = max(2, round(size / spacing))
        axes.append(low + (np.arange(count) + 0.5) * (size / count))
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def checked_cloud(name: str, positions: Any, types: Any, material: Any, *, stationary: Mapping[int, bool]) -> Cloud:
    """A cloud from what another code's file holds; `stationary` says of each type that is understood whether it is one.

    Raises InputError, which names the trajectory, for anything else than positions [T, N, D], one type per particle or
    for all, and at most one material property, tan(phi), per particle, per particle of sand (the generator of
    geoelements leaves the obstacles out), or for all.
    """

    def require(ok: bool, expected: str, got: object) -> None:
        if not ok:
            raise InputError(f"expected {expected}, got {got}", key=name)

    def numbers(value: Any, what: str, kinds: str) -> NDArray[Any]:
        require(isinstance(value, np.ndarray | np.number | int | float), f"{what} as an array", type(value).__name__)
        array = np.asarray(value)
        require(array.dtype.kind in kinds, f"{what} as {'integers' if kinds == 'iu' else 'numbers'}", array.dtype)
        return array

    positions = numbers(positions, "positions", "f")
    expected = "positions of shape [T, N, 2 or 3] over two frames or more"
    known = positions.ndim == 3 and positions.shape[2] in (2, 3) and len(positions) > 1 and positions.shape[1] > 0
    require(known, expected, positions.shape)
    require(bool((abs(positions) < FARTHEST).all()), f"positions within {FARTHEST:g} m", "others, or nan")
    count = positions.shape[1]
    types = numbers(types, "types", "iu")
    require(types.shape in ((), (count,)), f"one type for all particles or for each of {count}", types.shape)
    found = sorted(set(types.ravel().tolist()))
    require(set(found) <= stationary.keys(), f"particle types of {sorted(stationary)}", found)
    still = np.broadcast_to(np.isin(types, [number for number, fixed in stationary.items() if fixed]), (count,))
    require(not still.all(), "sand that moves", "obstacles alone")
    if material is None:
        return Cloud(name=name, positions=positions, stationary=still, friction=None)
    values = numbers(material, "material properties", "iuf")
    require(bool((abs(values) < STEEPEST).all()), "a material property that is a tan(phi)", "other numbers")
    if values.ndim == 2 and values.shape[1] == 1:
        values = values[:, 0]
    friction = np.zeros(count, np.float32)
    expected = f"one material property, tan(phi), for all particles or for each of {count}"
    require(values.shape in ((), (count,), (int((~still).sum()),)), expected, values.shape)
    friction[~still] = values[~still] if values.shape == still.shape else values
    return Cloud(name=name, positions=positions, stationary=still, friction=friction)
