"""Meshes of triangles: read by pyvista, written by meshio."""

import io
import warnings
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np

from datasets.errors import InputError, require
from datasets.files import file_size, reading, replacing
from datasets.geometry.ground import Floats, Integers
from datasets.geometry.surface import surface_of
from datasets.scene import Scene

MESHES = (".stl", ".obj", ".ply", ".off", ".msh", ".vtk", ".vtu")
"""Endings of meshes: those that hold all they need and name no other file."""
LARGEST = 2**30
"""Bytes of a file."""
SAME = (1.0e-9, 1.0e-7, 1.0e-6, 1.0e-5)
"""Distances of vertices that are one, over the extent of the mesh: the first with which its surface is closed."""


def read_mesh(path: Path) -> tuple[Floats, Integers]:
    """Vertices [V, 3] and triangles [T, 3] of the outer surface of a mesh, those at one place one vertex.

    Vertices further apart are one where the surface is open without. Raises InputError, which names the file.
    """
    import pyvista

    file_size(path, "a mesh", most=LARGEST)
    if path.suffix.lower() not in MESHES:
        raise InputError(f"expected a mesh, a file that ends in {' '.join(MESHES)}", where=str(path))
    output = io.StringIO()
    with (
        reading(path, "a readable mesh"),
        # Readers warn of normals that are none of a vertex's, and print what they leave out.
        warnings.catch_warnings(),
        redirect_stdout(output),
        redirect_stderr(output),
        pyvista.vtk_verbosity("off"),
    ):
        warnings.simplefilter("ignore")
        mesh = pyvista.read(path)
        require(isinstance(mesh, pyvista.DataSet), "", "one mesh", type(mesh).__name__)
        mesh.clear_data()
        require(bool(np.isfinite(mesh.points).all()), "", "vertices of finite coordinates", "others")
        skin = mesh.extract_surface(algorithm="dataset_surface").triangulate()
        for tolerance in SAME:
            merged = skin.clean(tolerance=tolerance)
            if merged.n_open_edges == 0:
                break
        require(merged.n_cells > 0, "", "a mesh with triangles", "none")
        return np.asarray(merged.points, np.float64), np.asarray(merged.regular_faces, np.int64)


def write_surface(scene: Scene, path: Path) -> None:
    """Write the surface of all baffles and solids of a scene in 3D as a mesh: STL, OBJ, PLY, OFF, MSH, VTK or VTU.

    Its coordinates count from the box's lower corner: most of these formats hold single precision. Raises InputError
    for a scene in 2D or without solids, and for another ending.
    """
    import meshio

    surface = surface_of(scene)
    if surface is None or surface.dimension == 2:
        raise InputError("expected a scene in 3D with baffles or solids", where=str(path))
    require(path.suffix in MESHES, "", f"a name that ends in {' '.join(MESHES)}", repr(path.suffix))
    faces = np.arange(3 * len(surface.corners)).reshape(-1, 3)
    with replacing(path) as part:
        meshio.Mesh(surface.corners.reshape(-1, 3), [("triangle", faces)]).write(part)
