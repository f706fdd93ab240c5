"""Meshes of any writer: corners with normals and texture, marks of an encoding, shells, damage."""

import warnings
from contextlib import nullcontext
from pathlib import Path

import meshio
import numpy as np
import pytest

from datasets.exchange.meshes import read_mesh
from datasets.geometry.shells import manifold, outward
from tests.datasets.geometry.solids import CUBE, QUADS, sphere
from tests.refusals import refused


def volume_of(path: Path) -> float:
    vertices, triangles = outward(*read_mesh(path), "")
    return float(manifold(vertices, triangles).volume())


def obj(corner: str = "{0}", ending: str = "\n") -> str:
    """A cube of 8 m^3 by quads whose corners are `corner`, of the number of a vertex and that from the end."""
    lines = ["mtllib cube.mtl", "o cube", *(f"v {x} {y} {z}" for x, y, z in 2.0 * CUBE), "vn 0 1 0", "vt 0 0", "s off"]
    lines += ["f " + " ".join(corner.format(number, number - 9) for number in quad) for quad in QUADS]
    return ending.join([*lines, ""])


@pytest.mark.parametrize("corner", ["{0}", "{0}//1", "{0}/1", "{0}/1/1", "{0}/", "{0}//", "{1}", "{1}//-1"])
def test_an_obj_with_normals_and_texture(tmp_path: Path, corner: str) -> None:
    (tmp_path / "cube.obj").write_text(obj(corner))
    assert volume_of(tmp_path / "cube.obj") == pytest.approx(8.0, rel=1e-6)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "latin-1"])
def test_an_obj_of_any_encoding_and_end_of_line(tmp_path: Path, encoding: str) -> None:
    """Its first line a vertex, which must not be lost with the mark in front of it."""
    text = obj(ending="\r\n").removeprefix("mtllib cube.mtl\r\no cube\r\n")
    (tmp_path / "cube.obj").write_bytes(f"{text}# W\u00fcrfel\r\n".replace("f 1 2 ", "f 1 2 \\\r\n").encode(encoding))
    assert volume_of(tmp_path / "cube.obj") == pytest.approx(8.0, rel=1e-6)


def test_a_face_of_many_corners(tmp_path: Path) -> None:
    """A prism of 1 m over an L of 3 m^2, whose ends are hexagons that are not convex."""
    level = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
    lines = [f"v {x} {y} {z}" for y in (0, 1) for x, z in level]
    sides = [(k + 1, k + 7, (k + 1) % 6 + 7, (k + 1) % 6 + 1) for k in range(6)]
    for face in (range(1, 7), range(12, 6, -1), *sides):
        lines.append(" ".join(["f", *map(str, face)]))
    (tmp_path / "prism.obj").write_text("\n".join(lines) + "\n")
    assert volume_of(tmp_path / "prism.obj") == pytest.approx(3.0, rel=1e-6)


PLY = """\
ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
3 0 1 {0}
"""


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("cube.obj", obj().replace("f 1 2", "f 1 900"), "faces of three or more of the 8 vertices"),
        ("cube.obj", obj().replace("f 1 2 3 4", "f 1 2"), "faces of three or more of the 8 vertices"),
        ("cube.obj", obj().replace("f ", "l "), "a mesh with faces"),
        ("cube.obj", obj().replace("v 2.0", "v 2,0"), "a readable mesh, could not convert"),
        ("cube.ply", PLY.format(2_000_000_000), "a readable mesh, its reader broke off"),
        ("cube.ply", PLY.replace("3 0 1 {0}\n", ""), "a mesh with triangles"),
        ("cube.vtu", "<VTKFile/>", ""),
        ("cube.off", "hello", "a mesh with triangles"),
        ("cube.msh", "hello", "a readable mesh, "),
    ],
)
def test_damaged_meshes_are_one_line(tmp_path: Path, name: str, text: str, said: str) -> None:
    """Readers of VTK trust the numbers in a file: corners that are no vertices ended the process."""
    (tmp_path / name).write_text(text)
    assert refused(read_mesh, tmp_path / name, said=said).where == str(tmp_path / name)


@pytest.mark.parametrize(("name", "kind"), [("ball.off", "off"), ("ball.vtk", "vtk"), ("ball.msh", "gmsh22")])
def test_other_formats(tmp_path: Path, name: str, kind: str) -> None:
    vertices, triangles = sphere((0.0, 0.0, 0.0), 1.0, 32)
    meshio.Mesh(vertices, [("triangle", triangles.astype(np.int32))]).write(tmp_path / name, file_format=kind)
    assert volume_of(tmp_path / name) == pytest.approx(4.0 / 3.0 * np.pi, rel=0.03)


def test_faces_of_four_corners_with_colours(tmp_path: Path) -> None:
    corners = "".join("{} {} {}\n".format(*corner) for corner in 2.0 * CUBE)
    faces = "".join("4 {} {} {} {} 255 0 0\n".format(*(np.array(quad) - 1)) for quad in QUADS)
    (tmp_path / "cube.off").write_text(f"OFF\n8 6 0\n{corners}{faces}")
    assert volume_of(tmp_path / "cube.off") == pytest.approx(8.0)


def test_triangles_that_face_both_ways_are_turned(tmp_path: Path) -> None:
    vertices, triangles = sphere((0.0, 0.0, 0.0), 1.0, 32)
    triangles[::3] = triangles[::3, ::-1]
    meshio.Mesh(vertices, [("triangle", triangles.astype(np.int32))]).write(tmp_path / "ball.msh", file_format="gmsh")
    assert volume_of(tmp_path / "ball.msh") == pytest.approx(4.0 / 3.0 * np.pi, rel=0.03)


def test_a_mesh_of_gmsh() -> None:
    """As Gmsh 4.13 writes it (format 4.1, no physical groups), with the points, lines and triangles of its geometry."""
    assert volume_of(Path(__file__).with_name("tetrahedron.msh")) == pytest.approx(1.0 / 6.0, rel=1e-6)


@pytest.mark.parametrize(("name", "turn"), [("corner.vtu", 1), ("corner.vtk", -1)])
def test_only_cells_of_the_highest_dimension_count(tmp_path: Path, name: str, turn: int) -> None:
    """The triangles beside a tetrahedron are its boundary once more, whichever way they face."""
    corners, faces = np.eye(4, 3), np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])[:, ::turn]
    corners[3] = 0.0
    cells = [("vertex", [[0]]), ("line", [[0, 1]]), ("triangle", faces), ("tetra", [[3, 0, 1, 2]])]
    meshio.Mesh(corners, cells).write(tmp_path / name)
    with warnings.catch_warnings(action="error"):
        assert volume_of(tmp_path / name) == pytest.approx(1.0 / 6.0, rel=1e-6)


def test_coarse_coordinates_of_single_precision_are_said(tmp_path: Path) -> None:
    stl(tmp_path / "wall.stl", CUBE + np.array([2_600_000.0, 1_000.0, 1_200_000.0]), binary=True)
    with pytest.warns(UserWarning, match=r"wall.stl: single precision has steps of 0.25 .* which is 1 long"):
        read_mesh(tmp_path / "wall.stl")


def stl(path: Path, *corners: np.ndarray, apart: float = 0.0, binary: bool = False) -> None:
    """Cubes whose triangles have vertices of their own, up to `apart` from each other."""
    halves = (np.array(QUADS) - 1)[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    places = np.concatenate([cube[halves].reshape(-1, 3) for cube in corners])
    places = places + apart * np.random.default_rng(0).uniform(-0.5, 0.5, places.shape)
    triangles = np.arange(len(places)).reshape(-1, 3)
    meshio.Mesh(places, [("triangle", triangles)]).write(path, file_format="stl", binary=binary)
    if binary:
        # Writers of binary files begin with `solid` as well.
        path.write_bytes(b"solid cubes".ljust(80) + path.read_bytes()[80:])


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("edge", [0.01, 1.0, 1000.0])
@pytest.mark.parametrize("apart", [0.0, 1e-8, 1e-6])
def test_near_vertices_are_merged(tmp_path: Path, apart: float, edge: float, binary: bool) -> None:
    """How near is a share of the extent, in whatever unit the file is."""
    stl(tmp_path / "cube.stl", edge * CUBE, apart=apart * edge, binary=binary)
    assert volume_of(tmp_path / "cube.stl") == pytest.approx(edge**3, rel=1e-5)


@pytest.mark.parametrize(
    ("second", "volume", "said"),
    [
        (CUBE + np.array([0.5, 0.0, 0.0]), 1.5, True),
        (CUBE + np.array([1.0, 0.0, 0.0]), 2.0, False),
        (CUBE + np.array([1.0, 1.0, 0.0]), 2.0, False),
        (CUBE + np.array([3.0, 0.0, 0.0]), 2.0, False),
        ((CUBE - np.array([2.0, 0.0, 0.0]))[[3, 2, 1, 0, 7, 6, 5, 4]], 2.0, True),
        (0.5 * CUBE + 0.25, 1.0, True),
        ((0.5 * CUBE + 0.25)[[3, 2, 1, 0, 7, 6, 5, 4]], 0.875, False),
    ],
    ids=["half over each other", "touching", "at an edge", "apart", "apart, inside out", "one inside", "a cavity"],
)
def test_what_shells_of_a_mesh_share_counts_once(tmp_path: Path, second: np.ndarray, volume: float, said: bool) -> None:
    stl(tmp_path / "blocks.stl", CUBE, second)
    with pytest.warns(UserWarning, match="shells of the mesh are united") if said else nullcontext():
        assert volume_of(tmp_path / "blocks.stl") == pytest.approx(volume, rel=1e-6)
