"""What a surrogate can know of a scene, the cohesion of its particles, and which of them it follows."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.particles import mass_counts
from datasets.scene import Scene, keyed
from datasets.trajectory import Floats


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
    shared = np.repeat(np.add.reduceat(weight[order], first) / np.minimum(count, kept), count)
    stays = rank < kept
    ascending = np.argsort(order[stays])
    return Thinned(indices=order[stays][ascending], volumes=shared[stays][ascending].astype(np.float32))
