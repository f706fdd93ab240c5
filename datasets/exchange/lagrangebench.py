"""The layout of LagrangeBench: HDF5, one group per trajectory.

A split is one file (`train.h5`, `valid.h5`, `test.h5`) with groups `00000`, `00001`, ... that each hold `position`
[T, N, D] and `particle_type` [N]. Talus adds `material_property` [N], tan(phi), which their reader does not open.
"""

from collections.abc import Container, Iterable, Iterator, Mapping
from enum import IntEnum
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from datasets.arrays import WHOLE_HDF5, open_hdf5, read_array
from datasets.exchange import geoelements
from datasets.exchange.cloud import Cloud, checked_cloud
from datasets.files import replacing
from datasets.reading import reading

SUFFIX = ".h5"


class ParticleType(IntEnum):
    """LagrangeBench's numbers; those that are not here, a moving wall (2) and a rigid body (3), Talus does not have."""

    FLUID = 0
    SOLID_WALL = 1


STATIONARY = {int(kind): kind is ParticleType.SOLID_WALL for kind in ParticleType}


def write(path: Path, clouds: Iterable[Cloud]) -> None:
    """Write a split, one trajectory in memory at a time. Not compressed: their reader slices frames at random."""
    with replacing(path) as part, h5py.File(part, "w") as file:
        for index, cloud in enumerate(clouds):
            group = file.create_group(f"{index:05d}")
            group["position"] = cloud.positions.astype(np.float32, copy=False)
            group["particle_type"] = np.where(cloud.stationary, ParticleType.SOLID_WALL, ParticleType.FLUID).astype(
                np.int32
            )
            if cloud.friction is not None:
                group["material_property"] = cloud.friction


def metadata(shared: dict[str, Any], *, frames: int, particles: int, trajectories: Mapping[str, int]) -> dict[str, Any]:
    """What `metadata.json` says; the length of a sequence leaves out the last frame, which is a target alone.

    shared: the keys that all layouts have; frames: of a trajectory, the start included; particles: most of a
    trajectory, obstacles included; trajectories: how many there are, per split.
    """
    return {
        "case": "TALUS",
        "solver": "MLS-MPM",
        **shared,
        "t_end": (frames - 1) * shared["dt"],
        "write_every": 1,
        "sequence_length_train": frames - 1,
        "num_trajs_train": trajectories["train"],
        "sequence_length_test": frames - 1,
        "num_trajs_test": trajectories["test"],
        "num_particles_max": particles,
        # Three of them in 2D too.
        "periodic_boundary_conditions": [False, False, False],
    }


def names(path: Path) -> list[str]:
    """The trajectories of a split, in order, without reading them. Raises InputError."""
    with open_hdf5(path) as file, reading(path, WHOLE_HDF5):
        return list(file)


def read(path: Path, requested: Container[str]) -> Iterator[Cloud]:
    """The trajectories of a split whose names are `requested`, one in memory at a time. Raises InputError."""
    with open_hdf5(path) as file:
        for name in filter(requested.__contains__, names(path)):
            with reading(path, WHOLE_HDF5, name):
                positions, types = (read_array(file, f"{name}/{key}") for key in ("position", "particle_type"))
                known = "material_property" in file[name]
                material = read_array(file, f"{name}/material_property") if known else None
                # Sets of the original GNS, as LagrangeBench converts them, keep the numbers they had there.
                original = geoelements.ParticleType.SAND in types
                stationary = geoelements.STATIONARY if original else STATIONARY
                cloud = checked_cloud(name, positions, types, material, stationary=stationary)
            yield cloud
