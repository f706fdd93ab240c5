"""Where solids meet in a point or along a line alone, which sand passes: refused in one line that names both."""

from itertools import combinations

import manifold3d
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from datasets.errors import InputError
from datasets.geometry.ground import Floats

NARROW = 100.0
"""Width, over the distance by which bodies have grown, up to which what they share is no face."""
MOST_TRIANGLES = 20_000
"""Of two bodies that are looked at, such as boxes and meshes, not terrain: a boolean of more takes seconds."""


def check_corners(vertices: Floats, owner: NDArray[np.int32], keys: list[str], tolerance: float) -> None:
    """Raise InputError where solids in 2D meet in a point alone.

    There the boundary of their union has two corners in one place [m], [V, 2]; owner: the solid of each, [V].
    """
    pairs = cKDTree(vertices).query_pairs(tolerance, output_type="ndarray")
    for first, second in sorted({(min(pair), max(pair)) for pair in owner[pairs].tolist()}):
        if first != second:
            refuse(keys[first], keys[second], "an edge", "in a point")


def check_lines(parts: list[manifold3d.Manifold], keys: list[str], gap: float) -> None:
    """Raise InputError where solids in 3D meet in a point or along a line alone, which no third solid covers.

    parts: the solids, each grown by `gap` [m]. Two that share a face of width w then have a layer of the surface
    2 w L in common, with L the length of its diagonal; of an edge it is 8 gap L.
    """
    bounds = np.array([part.bounding_box() for part in parts]).reshape(-1, 2, 3)
    for first, second in combinations(range(len(parts)), 2):
        apart = (bounds[[first, second], 0].max(axis=0) > bounds[[first, second], 1].min(axis=0)).any()
        if apart or parts[first].num_tri() + parts[second].num_tri() > MOST_TRIANGLES:
            continue
        for shared in (parts[first] ^ parts[second]).decompose():
            low, high = np.array(shared.bounding_box()).reshape(2, 3)
            length = float(np.linalg.norm(high - low))
            if shared.surface_area() > NARROW * gap * length:
                continue
            others = [part for number, part in enumerate(parts) if number not in (first, second)]
            left = manifold3d.Manifold.batch_boolean([shared, *others], manifold3d.OpType.Subtract)
            if left.volume() > 0.5 * shared.volume():
                where = "along a line" if length > NARROW * gap else "in a point"
                refuse(keys[first], keys[second], "a face", where)


def refuse(first: str, second: str, shared: str, where: str) -> None:
    """Raise InputError for a solid that meets another one in less than it should share."""
    raise InputError(f"expected solids that overlap or share {shared}, got one that meets {first} {where}", key=second)
