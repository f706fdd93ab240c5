"""Meshes of triangles: read by pyvista, MSH by meshio, which writes them all."""

import io
import os
import warnings
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import redirect_stderr, redirect_stdout
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from datasets.errors import InputError, require
from datasets.files import LARGEST, decoded, file_size, reading, replacing
from datasets.geometry.ground import Floats, Integers
from datasets.geometry.surface import surface_in_box
from datasets.processes import end_with_parent, without_main
from datasets.scene import Scene

MESHES = (".stl", ".obj", ".ply", ".off", ".msh", ".vtk", ".vtu")
"""Endings of meshes in formats that refer to no other file."""
SINGLE = (".stl", ".ply")  # formats that are read in single precision
STEPS = 1.0e5  # least steps of single precision over the extent of a mesh; fewer give a warning
IN_PROCESS = (".stl", ".obj")  # formats whose readers survive any file
SAME = (1.0e-9, 1.0e-7, 1.0e-6, 1.0e-5)
"""Distances, over the extent of the mesh, within which vertices are merged: the first that closes the surface."""


def read_mesh(path: Path) -> tuple[Floats, Integers]:
    """Vertices [V, 3] and triangles [T, 3] of the outer surface of a mesh; coincident vertices are merged, and vertices
    farther apart if the surface is open otherwise. Raises InputError, which names the file."""
    file_size(path, "a mesh", most=LARGEST)
    require(path.suffix.lower() in MESHES, "", f"a mesh, a file that ends in {' '.join(MESHES)}", where=str(path))
    with reading(path, "a readable mesh"):
        vertices, triangles = triangles_in(path) if path.suffix.lower() in IN_PROCESS else read_apart(path)
    step, extent = float(np.spacing(np.float32(np.abs(vertices).max()))), float(np.ptp(vertices, axis=0).max())
    if path.suffix.lower() in SINGLE and extent < STEPS * step:
        said = f"single precision has steps of {step:.2g} at the place of this mesh, which is {extent:.3g} long"
        warnings.warn(f"{path}: {said}; let it count from a place nearby and give that as `at`", stacklevel=2)
    return vertices, triangles


def triangles_in(path: Path) -> tuple[Floats, Integers]:
    """What `read_mesh` returns. Raises InputError, and whatever the libraries raise."""
    import pyvista

    output = io.StringIO()
    # Readers warn of normals without a vertex, and print what they leave out.
    with warnings.catch_warnings(), redirect_stdout(output), redirect_stderr(output), pyvista.vtk_verbosity("off"):
        warnings.simplefilter("ignore")
        try:
            if path.suffix.lower() == ".obj":
                mesh: Any = pyvista.PolyData(*read_obj(path))
            elif path.suffix.lower() == ".off":
                from vtkmodules.vtkIOGeometry import vtkOFFReader

                reader = vtkOFFReader()
                reader.SetFileName(str(path))
                reader.Update()
                mesh = pyvista.wrap(reader.GetOutput())
            elif path.suffix.lower() == ".msh":
                import meshio

                given = meshio.read(path)
                # Without the groups of Gmsh, of which pyvista knows physical ones alone.
                mesh = pyvista.from_meshio(meshio.Mesh(given.points, given.cells))
            else:
                mesh = pyvista.read(path)
        except SystemExit:  # meshio has printed why
            why = output.getvalue().strip().splitlines() or ["its format is another one"]
            raise InputError(f"expected a readable mesh, {why[0]}") from None
        require(isinstance(mesh, pyvista.DataSet), "", "one mesh", type(mesh).__name__)
        mesh.clear_data()
        require(bool(np.isfinite(mesh.points).all()), "", "vertices of finite coordinates", "others")
        if isinstance(mesh, pyvista.UnstructuredGrid) and mesh.n_cells > 0:
            # Gmsh writes the triangles, lines and points on the boundary of tetrahedra beside these.
            _, first, kind = np.unique(mesh.celltypes, return_index=True, return_inverse=True)
            dimensions = np.array([mesh.get_cell(number).dimension for number in first])[kind]
            mesh = mesh.extract_cells(dimensions == dimensions.max())
        skin = mesh.extract_surface(algorithm="dataset_surface").triangulate()
        for tolerance in SAME:
            merged = skin.clean(tolerance=tolerance, absolute=False)
            if merged.n_open_edges == 0:
                break
        require(merged.n_cells > 0, "", "a mesh with triangles", "none")
        # Gmsh writes the triangles of a surface facing both ways.
        merged = merged.compute_normals(point_normals=False, non_manifold_traversal=False)
        return np.asarray(merged.points, np.float64), np.asarray(merged.regular_faces, np.int64)


def read_obj(path: Path) -> tuple[Floats, Integers]:
    """Vertices [V, 3] of a Wavefront OBJ, and its polygons in a row: the number of corners of each, then their indices
    from 0. Raises InputError for corners that are no vertices, ValueError for text that is no number."""
    vertices, polygons = list[list[float]](), list[list[int]]()
    for line in decoded(path.read_bytes(), errors="replace").replace("\\\r\n", " ").replace("\\\n", " ").splitlines():
        kind, *words = line.split("#", 1)[0].split() or [""]
        if kind == "v":
            vertices.append([float(word) for word in words[:3]])
        elif kind == "f":
            corners = [int(word.split("/", 1)[0]) for word in words]
            polygons.append([corner - 1 if corner > 0 else len(vertices) + corner for corner in corners])
    require(bool(polygons), "", "a mesh with faces", "none")
    there = all(len(corners) >= 3 and 0 <= min(corners) <= max(corners) < len(vertices) for corners in polygons)
    require(there, "", f"faces of three or more of the {len(vertices)} vertices", "others")
    return np.array(vertices), np.array([number for corners in polygons for number in (len(corners), *corners)])


def read_apart(path: Path) -> tuple[Floats, Integers]:
    """`triangles_in` in its own process, which a damaged file may crash: VTK trusts the numbers in it."""
    reader = ProcessPoolExecutor(max_workers=1, mp_context=get_context("spawn"), initializer=begin_reader)
    with without_main(), reader as process:
        try:
            return process.submit(triangles_in, path).result()
        except BrokenProcessPool:
            raise InputError("expected a readable mesh, its reader broke off") from None


def begin_reader() -> None:
    """Make a process end with its parent, and print nothing."""
    end_with_parent()
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


def write_surface(scene: Scene, path: str | Path) -> None:
    """Write the surface of all baffles and solids of a scene in 3D as a mesh, from the box's lower corner on: most
    formats hold single precision. Solids end at the sides of the box, terrain 8 cells beyond. Raises InputError without
    solids, in 2D, and for another ending."""
    import meshio

    path, surface = Path(path), surface_in_box(scene)
    if surface is None or surface.dimension == 2:
        raise InputError("expected a scene in 3D with baffles or solids", where=str(path))
    require(path.suffix in MESHES, "", f"a name that ends in {' '.join(MESHES)}", repr(path.suffix))
    faces = np.arange(3 * len(surface.corners)).reshape(-1, 3)
    with replacing(path) as part:
        meshio.Mesh(surface.corners.reshape(-1, 3), [("triangle", faces)]).write(part)
