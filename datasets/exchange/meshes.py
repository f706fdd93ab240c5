"""Meshes of triangles: read by pyvista, written by meshio."""

import io
import os
import subprocess
import sys
import tempfile
import warnings
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np

from datasets.errors import InputError, require
from datasets.files import LARGEST, decoded, file_size, reading, replacing
from datasets.geometry.ground import Floats, Integers
from datasets.geometry.surface import surface_of
from datasets.processes import end_with_parent
from datasets.scene import Scene

MESHES = (".stl", ".obj", ".ply", ".off", ".msh", ".vtk", ".vtu")
"""Endings of meshes: those that hold all they need and name no other file."""
IN_PROCESS = (".stl", ".obj")
"""Those whose readers survive any file."""
REFUSED = 2
"""Exit status of a process that says what is wrong with a mesh."""
SAME = (1.0e-9, 1.0e-7, 1.0e-6, 1.0e-5)
"""Distances of vertices that are one, over the extent of the mesh: the first with which its surface is closed."""


def read_mesh(path: Path) -> tuple[Floats, Integers]:
    """Vertices [V, 3] and triangles [T, 3] of the outer surface of a mesh, those at one place one vertex.

    Vertices further apart are one where the surface is open without. Raises InputError, which names the file.
    """
    file_size(path, "a mesh", most=LARGEST)
    if path.suffix.lower() not in MESHES:
        raise InputError(f"expected a mesh, a file that ends in {' '.join(MESHES)}", where=str(path))
    with reading(path, "a readable mesh"):
        return triangles_in(path) if path.suffix.lower() in IN_PROCESS else read_apart(path)


def triangles_in(path: Path) -> tuple[Floats, Integers]:
    """What `read_mesh` returns. Raises InputError, and whatever the libraries raise."""
    import pyvista

    output = io.StringIO()
    # Readers warn of normals that are none of a vertex's, and print what they leave out.
    with warnings.catch_warnings(), redirect_stdout(output), redirect_stderr(output), pyvista.vtk_verbosity("off"):
        warnings.simplefilter("ignore")
        mesh = pyvista.PolyData(*read_obj(path)) if path.suffix.lower() == ".obj" else pyvista.read(path)
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


def read_obj(path: Path) -> tuple[Floats, Integers]:
    """Vertices [V, 3] of a Wavefront OBJ, and its polygons end to end: how many corners each has, then these from 0.

    Corners may name texture and normals, and count from the end.

    Raises InputError for corners that are no vertices, ValueError for what is no number.
    """
    text = decoded(path.read_bytes(), errors="replace").replace("\\\r\n", " ").replace("\\\n", " ")
    vertices, polygons = list[list[float]](), list[list[int]]()
    for line in text.splitlines():
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
    """`triangles_in` in a process of its own, which a damaged file may end: VTK trusts the numbers in it."""
    with tempfile.TemporaryDirectory() as folder:
        kept = Path(folder) / "mesh.npz"
        work = "from datasets.exchange.meshes import leave; leave()"
        command = [sys.executable, "-P", "-c", work, str(path), str(kept)]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(entry or str(Path.cwd()) for entry in sys.path)}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, errors="replace", check=False)
        if done.returncode == REFUSED:
            raise InputError(done.stderr.splitlines()[-1])
        if done.returncode != 0 or not kept.exists():
            raise InputError("expected a readable mesh, its reader broke off")
        with np.load(kept, allow_pickle=False) as arrays:
            return arrays["vertices"], arrays["triangles"]


def leave() -> None:
    """Write what `triangles_in` returns of the first argument of this process to the second, for `read_apart`."""
    end_with_parent()
    source, target = map(Path, sys.argv[1:])
    try:
        with reading(Path(), "a readable mesh"):
            vertices, triangles = triangles_in(source)
    except InputError as error:
        print(error.message, file=sys.stderr)
        sys.exit(REFUSED)
    np.savez(target, vertices=vertices, triangles=triangles)


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
