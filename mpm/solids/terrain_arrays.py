"""The height fields of the scenes of a batch, as `mpm.solids.terrain` reads them."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.errors import require
from datasets.scene import Scene
from mpm.arrays.features import Features
from mpm.arrays.layout import FIRST_FACE, KEPT, KEPT_NODES, KEPT_NUMBERS, Offset, TerrainNumber, Worker, node_shape
from mpm.solids.obstacles import Obstacles

Array = NDArray[Any]


def terrain_arrays(obstacles: Obstacles, offsets: NDArray[np.int32], real: np.dtype[Any]) -> tuple[Array, Array]:
    """The numbers of all height fields, and of each of their cells bit 0: its triangles meet along the second diagonal,
    bit 1: they are listed as faces. Their places go to `offsets`. Raises InputError for too many triangles.

    Scenes of one terrain share its numbers.
    """
    numbers, cells, known = [np.zeros(1, real)], [np.zeros(1, np.int32)], dict[tuple[int, int], tuple[int, int]]()
    offsets[:, Offset.TERRAIN_FACE] = 2 * FIRST_FACE
    place, place_cells, end = 1, 1, len(obstacles.faces)
    fields = zip(offsets, obstacles.fields, obstacles.frictions, obstacles.triangles, strict=False)
    for offset, field, friction, triangle in fields:
        if field is None:
            continue
        if (id(field), id(friction)) not in known:
            known[id(field), id(friction)] = place, place_cells
            header = np.zeros(len(TerrainNumber), real)
            header[TerrainNumber.X], header[TerrainNumber.Z] = field.x[field.even[0]], field.z[field.even[1]]
            header[TerrainNumber.PER_X], header[TerrainNumber.PER_Z] = 1.0 / np.array(field.spacing)
            header[TerrainNumber.NEARNESS] = 1.0 / math.hypot(1.0, field.steepest)
            parts = header, field.x, field.z, field.heights.ravel(), friction.ravel()
            numbers += [part.astype(real) for part in parts]
            cells.append((field.second + 2 * field.cut.astype(np.int32)).ravel().astype(np.int32))
            place, place_cells = place + sum(map(len, numbers[-5:])), place_cells + field.cut.size
        offset[Offset.TERRAIN], offset[Offset.TERRAIN_CELLS] = known[id(field), id(friction)]
        offset[Offset.TERRAIN_FACE], offset[Offset.TERRAIN_SOLID] = triangle, field.solid
        offset[Offset.TERRAIN_FRICTION] = friction.size > 1
        offset[Offset.POSTS_X], offset[Offset.POSTS_Z] = field.heights.shape
        offset[Offset.EVEN_X], offset[Offset.EVEN_Z] = field.even
        end = max(end, triangle + 2 * field.cut.size)
    require(end <= 2 * FIRST_FACE, "solids", f"at most {2 * FIRST_FACE} faces and triangles of terrain", str(end))
    return np.concatenate(numbers), np.concatenate(cells)


def terrain_kept(
    scenes: Sequence[Scene], offsets: NDArray[np.int32], workers: Array, features: Features, real: np.dtype[Any]
) -> tuple[Array, Array, Array]:
    """Room for what is kept of height fields once it has been needed: their elevation at columns of nodes, and by each
    worker the holds of nodes, in groups of KEPT_NODES of a column: which column, and these. Places go to the tables.

    Memory that nothing is written to is none: a worker uses groups by the number of its columns (`terrain_holds`).
    """
    columns = 1
    for scene, offset in zip(scenes, offsets, strict=True):
        if offset[Offset.POSTS_X] > 0:
            offset[Offset.COLUMNS] = columns
            columns += math.prod(node_shape(scene.domain)[::2])
    groups = 1
    for worker in workers if features.terrain and not features.processor.gpu else workers[:0]:
        count = 2 * int(worker[Worker.LAST] - worker[Worker.FIRST]) * features.lanes
        worker[Worker.KEPT], worker[Worker.GROUPS] = groups, max(count, 256)
        groups += int(worker[Worker.GROUPS])
    kept = np.zeros((groups * KEPT_NODES, 2 + KEPT * KEPT_NUMBERS), real)
    return np.zeros(columns, real), np.zeros(groups, np.int32), kept
