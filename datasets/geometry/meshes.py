"""Triangles from mesh files, by meshio."""

import io
import warnings
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.reading import file_size, reading

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SAME = 1.0e-9
"""Distance of vertices that are one, over the extent of the mesh."""
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
"""Faces of a tetrahedron, outwards."""
READ = {
    ".stl": "stl",
    ".obj": "obj",
    ".ply": "ply",
    ".off": "off",
    ".msh": "gmsh",
    ".mesh": "medit",
    ".vtk": "vtk",
    ".vtu": "vtu",
    ".nas": "nastran",
    ".bdf": "nastran",
    ".fem": "nastran",
}
"""Endings of files that are read, as which format of meshio: those that hold all they need and name no other file."""
LARGEST = 2**28
"""Bytes of a file."""
FARTHEST = 1.0e9
"""Coordinates [m] beyond this are none."""
IGNORED = ("vertex", "line", "line3")
"""Cells that bound no solid."""


def read_mesh(path: Path) -> tuple[Floats, Integers]:
    """Vertices [V, 3] and triangles [T, 3] of a surface, or of the boundary of a mesh of tetrahedra.

    Vertices at one place are one, quadrilaterals are two triangles. Raises InputError, which names the file.
    """
    try:
        return surface(*load(path))
    except InputError as error:
        raise error.at(str(path)) from None


def load(path: Path) -> tuple[Floats, dict[str, Integers]]:
    """Points and cells by their kind as they stand in the file. Raises InputError."""
    import meshio

    file_size(path, "a mesh", most=LARGEST)
    if path.suffix.lower() not in READ:
        raise InputError(f"expected a mesh, a file that ends in {' '.join(READ)}")
    output = io.StringIO()
    with (
        reading(path, "a mesh that meshio reads"),
        # Its test for a binary STL overflows on the text of one that is none; it prints what it leaves out.
        warnings.catch_warnings(),
        redirect_stdout(output),
        redirect_stderr(output),
    ):
        warnings.simplefilter("ignore", RuntimeWarning)
        mesh = meshio.read(path, file_format=READ[path.suffix.lower()])
        cells: dict[str, Integers] = {}
        for block in mesh.cells:
            members = np.asarray(block.data, np.int64)
            cells[block.type] = np.concatenate([cells[block.type], members]) if block.type in cells else members
        points = np.asarray(mesh.points, np.float64)
    vertices = len(points)
    for members in cells.values():
        if members.size and (members.ndim != 2 or members.min() < 0 or members.max() >= vertices):
            raise InputError(f"expected cells of the {vertices} vertices in the file, got others")
    return points, cells


def surface(points: Floats, cells: dict[str, Integers]) -> tuple[Floats, Integers]:
    """Vertices and triangles of the boundary of `cells`. Raises InputError."""
    unknown = [kind for kind in cells if kind not in ("triangle", "quad", "tetra", *IGNORED)]
    if unknown:
        raise InputError(f"expected triangles, quadrilaterals or tetrahedra, got {unknown[0]}")
    if points.ndim != 2 or points.shape[1] != 3 or not (np.abs(points) <= FARTHEST).all():
        raise InputError("expected vertices of three finite coordinates")
    parts = [cells[kind] for kind in ("triangle",) if kind in cells and "tetra" not in cells]
    if "quad" in cells and "tetra" not in cells:
        parts += [cells["quad"][:, [0, 1, 2]], cells["quad"][:, [0, 2, 3]]]
    if "tetra" in cells:
        parts.append(skin(points, cells["tetra"]))
    triangles = np.concatenate(parts) if parts else np.empty((0, 3), np.int64)
    if not len(triangles):
        raise InputError("expected a mesh with triangles, it has none")
    extent = float(np.ptp(points, axis=0).max())
    step = SAME * extent or 1.0
    _, first, same = np.unique(np.round(points / step), axis=0, return_index=True, return_inverse=True)
    triangles = same.ravel()[triangles]
    whole = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    used, triangles = np.unique(triangles[whole], return_inverse=True)
    return points[first[used]], triangles.reshape(-1, 3)


def skin(points: Floats, cells: Integers) -> Integers:
    """The faces of tetrahedra [C, 4] that are those of one alone, outwards, shape [T, 3]."""
    corners = points[cells]
    volume = np.einsum(
        "ni,ni->n",
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]),
        corners[:, 3] - corners[:, 0],
    )
    upright = np.where((volume > 0.0)[:, None], cells, cells[:, [0, 2, 1, 3]])
    faces = upright[:, FACES].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return np.asarray(faces[first[count == 1]])
