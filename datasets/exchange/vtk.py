"""Trajectory -> a time series that ParaView opens: particles with fields, the surface of all solids, the box."""

import re
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from datasets.errors import WorkFailed
from datasets.files import replacing
from datasets.flow.fields import FlowFields
from datasets.flow.trajectory import Trajectory
from datasets.forces import momentum
from datasets.geometry.surface import surface_in_box
from datasets.scene import Baffle, Mass, Scene

if TYPE_CHECKING:  # VTK takes half a second to import: only who writes or draws pays for it
    import pyvista

SERIES = "trajectory.pvd"
PARTS = re.compile(r"(particles-\d+|solids(-\d+)?|domain)\.vtp")
"""Names of the files of a series."""
UNITS = {"velocity": "m/s", "displacement": "m", "friction_deg": "deg", "impulse": "N s", "force": "N"}
UNITS |= dict.fromkeys(("stress", "pressure", "pore_pressure"), "Pa")
UNITS |= dict.fromkeys(("plastic_strain", "material", "solid", "friction"), "1")
"""Array -> unit; impulse and force in 2D are per metre of width."""
MOVING = "particles"  # the part whose geometry changes
ACTIVE = {MOVING: "velocity", "solids": "force"}
"""Part -> default vectors for glyphs in ParaView."""


class Meshes:
    """The parts of a trajectory as VTK meshes, all in three dimensions; a 2D trajectory is at z = 0."""

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory, self.fields, scene = trajectory, FlowFields(trajectory), trajectory.scene
        self.momentum = momentum(trajectory)
        solids = ("solids",) if scene.baffles or scene.solids else ()
        self.parts: tuple[str, ...] = (MOVING, *solids, "domain")  # the same in every frame

    def part(self, name: str, frame: int, since: int | None = None) -> "pyvista.PolyData":
        """The part `name` at `frame`: particles with their fields, a vertex each, the edges of the box, or the solids.

        The faces of solids have the number of their solid, baffles first, its friction, infinite without slip, and,
        where it was recorded, the `impulse` [N s] that the whole solid has got until `frame`, and the mean `force` [N]
        on it since the frame `since`, or the start, both in 2D per metre of width.
        """
        import pyvista

        trajectory, scene = self.trajectory, self.trajectory.scene
        if name == "domain":
            return edges((0.0,) * scene.dimension, scene.domain.size)
        if name == MOVING:
            here = trajectory.entered(float(trajectory.time[frame]))
            mesh = pyvista.PolyData(spatial(trajectory.positions[frame][here]))
            arrays = {key: values[here] for key, values in self.fields.at_frame(frame).items()}
            data = mesh.point_data
        else:
            surface = surface_in_box(scene)
            assert surface is not None
            count, width = surface.corners.shape[:2]
            faces = np.insert(np.arange(count * width).reshape(count, width), 0, width, axis=1).ravel()
            points = spatial(surface.corners.reshape(-1, surface.dimension))
            mesh = pyvista.PolyData(points, lines=faces) if width == 2 else pyvista.PolyData(points, faces)
            arrays = {"solid": surface.solid, "friction": surface.friction.mean(axis=1).astype(np.float32)}
            data, impulse, taken = mesh.cell_data, trajectory.solid_impulse, self.momentum
            if impulse is not None and taken is not None:
                gained, elapsed = taken[frame], trajectory.time[frame]
                if since is not None:
                    gained, elapsed = gained - taken[since], elapsed - trajectory.time[since]
                arrays["impulse"] = impulse[frame][surface.solid]
                arrays["force"] = (gained / elapsed if elapsed > 0.0 else 0.0 * gained)[surface.solid]
        for key, values in arrays.items() if mesh.n_points else ():
            data[key] = values if values.ndim == 1 else spatial(values, 6 if key == "stress" else 3)
            per_width = scene.dimension == 2 and key in ("impulse", "force")
            mesh.field_data[f"{key}_units"] = [UNITS[key] + ("/m" if per_width else "")]
        if (active := ACTIVE[name]) in data:
            data.active_vectors_name = active
        return mesh


def spatial(vectors: NDArray[Any], width: int = 3) -> NDArray[Any]:
    """Vectors of any dimension with three components, shape [N, D] -> [N, 3]; of a stress with six. VTK orders a
    symmetric tensor as we do: xx, yy, zz, xy, yz, zx."""
    return np.pad(vectors, ((0, 0), (0, width - vectors.shape[1])))


def edges(lower: tuple[float, ...], size: tuple[float, ...]) -> "pyvista.PolyData":
    """The edges of a box; in 2D of a rectangle."""
    import pyvista

    given, flat = len(size), 3 - len(size)
    dimensions, spacing, origin = (2,) * given + (1,) * flat, (*size, *(1,) * flat), (*lower, *(0,) * flat)
    box: Any = pyvista.ImageData(dimensions=dimensions, spacing=spacing, origin=origin)
    lines: pyvista.PolyData = box.extract_all_edges()
    return lines


def extent(scene: Scene, positions: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Corners [m], shape [3] each, of what is drawn with some air, up to walls that are near: the flow at `positions`
    [m], [T, N, D], masses, baffles and solids but for terrain, which is everywhere."""
    size = np.array(scene.domain.size)
    boxes: list[Mass | Baffle] = [*scene.masses, *scene.baffles]
    corners = [np.array(box.lower) for box in boxes] + [np.add(box.lower, box.size) for box in boxes]
    for solid in scene.solids:
        if solid.lower is not None and solid.size is not None:
            corners += [np.array(solid.lower), np.add(solid.lower, solid.size)]
        corners += [np.array(vertex) for vertex in solid.vertices or ()]
    lower, upper = np.min(corners, axis=0).clip(0.0, size), np.max(corners, axis=0).clip(0.0, size)
    # These pass over particles that a failed simulation has lost (NaN).
    lower = np.fmin(lower, np.fmin.reduce(positions, axis=(0, 1)).clip(0.0, size))
    upper = np.fmax(upper, np.fmax.reduce(positions, axis=(0, 1)).clip(0.0, size))
    air = 0.06 * float(np.max(upper - lower))
    lower[1] = 0.0
    lower = np.where(lower < 3.0 * air, 0.0, lower - air)
    upper = np.where(upper > size - 3.0 * air, size, upper + air)
    return np.pad(lower, (0, 3 - len(lower))), np.pad(upper, (0, 3 - len(upper)))


def frames_of(trajectory: Trajectory, every: int) -> list[int]:
    """Every `every`-th frame from the first on, and the last."""
    last = len(trajectory.time) - 1
    return sorted({*range(0, last, every), last})


def write_vtk(trajectory: Trajectory, folder: str | Path, *, every: int = 1, progress: bool = False) -> None:
    """Write `folder/trajectory.pvd` and its files: every `every`-th frame, and the last; in map coordinates, in double
    precision, where the box has an origin. An older series stays whole until the new one is written, then goes with all
    its frames. Raises WorkFailed."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    series = ElementTree.Element("VTKFile", type="Collection", version="0.1", byte_order="LittleEndian")
    collection = ElementTree.SubElement(series, "Collection")
    meshes, since, corner = Meshes(trajectory), None, trajectory.scene.domain.corner
    # Parts that change in every frame.
    changing = {MOVING, *(("solids",) if trajectory.solid_impulse is not None else ())}
    with tempfile.TemporaryDirectory(dir=folder, prefix=".vtk-") as name:
        beside = Path(name)
        for frame in tqdm(frames_of(trajectory, every), desc="vtk", unit="frame", disable=not progress):
            for number, part in enumerate(meshes.parts):
                file = f"{part}-{frame:04d}.vtp" if part in changing else f"{part}.vtp"
                if not (beside / file).exists():
                    mesh = meshes.part(part, frame, since)
                    if corner.any():
                        mesh.points = mesh.points.astype(np.float64) + spatial(corner[None])
                    _write(mesh, beside / file)
                time = repr(float(trajectory.time[frame]))
                ElementTree.SubElement(collection, "DataSet", timestep=time, part=str(number), file=file)
            since = frame
        # The remaining steps take only moments.
        remove_series(folder)
        for new in list(beside.iterdir()):
            new.replace(folder / new.name)
    ElementTree.indent(series)
    with replacing(folder / SERIES) as index:
        ElementTree.ElementTree(series).write(index, encoding="utf-8", xml_declaration=True)


def remove_series(folder: Path) -> None:
    """Remove the series in a folder, first what refers to its files, and nothing else."""
    (folder / SERIES).unlink(missing_ok=True)
    for old in [path for path in folder.glob("*.vtp") if PARTS.fullmatch(path.name)]:
        old.unlink()


def _write(mesh: "pyvista.PolyData", path: Path) -> None:
    """Write a VTP: compressed, all arrays as they are behind the XML. Raises WorkFailed."""
    from pyvista.core.utilities.writer import XMLPolyDataWriter

    writer: Any = XMLPolyDataWriter(path, mesh).writer
    writer.SetDataModeToAppended()
    writer.EncodeAppendedDataOff()
    if not writer.Write():
        raise WorkFailed(f"{path.name} could not be written: is the disk full?")
