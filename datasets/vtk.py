"""Trajectory -> a time series that ParaView opens: points with their fields, baffles as surfaces, the box's outline."""

import re
import tempfile
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from datasets.command_line import WorkFailed
from datasets.files import replacing
from datasets.material import Material
from datasets.particles import initial_particles
from datasets.trajectory import Trajectory

# VTK takes half a second to import: only who writes or draws pays for it.
if TYPE_CHECKING:
    import pyvista

SERIES = "trajectory.pvd"
PARTS = re.compile(r"(points-\d+|baffles(-\d+)?|domain)\.vtp")
"""The files that a series consists of, whatever its length."""


class Meshes:
    """The parts of a trajectory as VTK's meshes; all in three dimensions, a 2D trajectory at z = 0."""

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory

    @property
    def materials(self) -> list[Material]:
        """The different materials of the scene, in the order of `datasets.particles.initial_particles`."""
        scene = self.trajectory.scene
        return list(dict.fromkeys(map(scene.material_of, scene.masses)))

    @cached_property
    def start(self) -> NDArray[np.float64]:
        """Positions at the start [m], shape [N, D]; the first frame's where the start was not kept and is not known."""
        trajectory = self.trajectory
        if trajectory.time[0] > 0.0:
            known: NDArray[np.float64] = initial_particles(trajectory.scene).positions
            if known.shape == trajectory.positions[0].shape:
                return known
        return np.asarray(trajectory.positions[0], np.float64)

    @cached_property
    def material(self) -> NDArray[np.int32]:
        """Index into `materials` of each point, shape [N].

        Told by the mass that the point is in (or nearest to) at the start, so that it holds for a part of the points.
        """
        scene, start = self.trajectory.scene, self.start
        materials = self.materials
        nearest, index = np.full(len(start), np.inf), np.zeros(len(start), np.int32)
        for mass in scene.masses:
            lower, upper = np.array(mass.lower), np.add(mass.lower, mass.size)
            outside = np.linalg.norm(start - start.clip(lower, upper), axis=1)
            closer = outside < nearest
            nearest[closer], index[closer] = outside[closer], materials.index(scene.material_of(mass))
        return index

    @cached_property
    def friction_deg(self) -> NDArray[np.float32]:
        """Angle of internal friction of each point [deg], shape [N]."""
        return np.degrees(np.arctan(self.trajectory.friction)).astype(np.float32)

    def velocity(self, frame: int) -> NDArray[np.float32] | None:
        """Velocities at `frame` [m/s], shape [N, D]: as recorded, or else finite differences of the frames.

        These are central; at the last frame backward; the first frame has the initial velocities where it is the start,
        else there are none.
        """
        trajectory = self.trajectory
        velocity: NDArray[np.float32] | None = trajectory.velocity0 if trajectory.time[0] == 0.0 else None
        if trajectory.velocities is not None:
            velocity = trajectory.velocities[frame]
        elif frame > 0:
            after, before = min(frame + 1, len(trajectory.time) - 1), frame - 1
            took = trajectory.time[after] - trajectory.time[before]
            velocity = ((trajectory.positions[after] - trajectory.positions[before]) / took).astype(np.float32)
        return velocity

    def fields(self, frame: int) -> dict[str, NDArray[Any]]:
        """What there is to know of the points at `frame`, shape [N] or [N, D] each."""
        trajectory = self.trajectory
        recorded = {key: getattr(trajectory, key) for key in ("stress", "pressure", "density", "plastic_strain")}
        velocity = self.velocity(frame)
        return {
            **({} if velocity is None else {"velocity": velocity}),
            "displacement": trajectory.positions[frame] - self.start.astype(np.float32),
            **{key: values[frame] for key, values in recorded.items() if values is not None},
            "material": self.material,
            "friction_deg": self.friction_deg,
        }

    def points(self, frame: int) -> "pyvista.PolyData":
        """The points at `frame`, a vertex each, with all their fields."""
        import pyvista

        mesh = pyvista.PolyData(spatial(self.trajectory.positions[frame]))
        for key, values in self.fields(frame).items():
            width = 6 if key == "stress" else 3
            mesh.point_data[key] = values if values.ndim == 1 else spatial(values, width)
        return mesh

    def baffles(self, frame: int, since: int) -> "pyvista.PolyData":
        """The baffles, closed surfaces; per face which baffle it belongs to.

        Where it was recorded also the `impulse` [N s] that the baffle has got until `frame`, and the mean `force` [N]
        on it since the frame `since`, both in 2D per metre of width.
        """
        trajectory = self.trajectory
        boxes = [box(baffle.lower, baffle.size) for baffle in trajectory.scene.baffles]
        mesh: pyvista.PolyData = boxes[0].append_polydata(*boxes[1:])
        number = np.repeat(np.arange(len(boxes), dtype=np.int32), [each.n_cells for each in boxes])
        mesh.cell_data["baffle"] = number
        impulse = trajectory.solid_impulse
        if impulse is not None:
            gained, took = impulse[frame] - impulse[since], trajectory.time[frame] - trajectory.time[since]
            mesh.cell_data["impulse"] = spatial(impulse[frame])[number]
            mesh.cell_data["force"] = spatial(gained / took if took > 0.0 else gained)[number]
        return mesh

    def domain(self) -> "pyvista.PolyData":
        """The edges of the box."""
        size = self.trajectory.scene.domain.size
        edges: pyvista.PolyData = box((0.0,) * len(size), size).extract_all_edges()
        return edges


def spatial(vectors: NDArray[Any], width: int = 3) -> NDArray[Any]:
    """Vectors of any dimension with three components, shape [N, D] -> [N, 3]; of a stress with six.

    VTK orders a symmetric tensor as we do: xx, yy, zz, xy, yz, zx.
    """
    return np.pad(vectors, ((0, 0), (0, width - vectors.shape[1])))


def box(lower: tuple[float, ...], size: tuple[float, ...]) -> "pyvista.PolyData":
    """The closed surface of a box; in 2D a rectangle."""
    import pyvista

    x, y, *z = zip(lower, np.add(lower, size).tolist(), strict=True)
    if not z:
        return pyvista.PolyData([(x[0], y[0], 0), (x[1], y[0], 0), (x[1], y[1], 0), (x[0], y[1], 0)], [4, 0, 1, 2, 3])
    return pyvista.Box((*x, *y, *z[0]))


def frames_of(trajectory: Trajectory, every: int) -> list[int]:
    """Every `every`-th frame from the first on, and the last."""
    last = len(trajectory.time) - 1
    return sorted({*range(0, last, every), last})


def write_vtk(trajectory: Trajectory, folder: Path, *, every: int = 1, progress: bool = False) -> None:
    """Write `folder/trajectory.pvd` and the files that it refers to: every `every`-th frame, and the last.

    Velocities that were not recorded are finite differences of the frames. An older series in the folder stays whole
    until all files of the new one are written, then goes, its surplus frames included. Raises WorkFailed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    series = ElementTree.Element("VTKFile", type="Collection", version="0.1", byte_order="LittleEndian")
    collection = ElementTree.SubElement(series, "Collection")
    meshes, since = Meshes(trajectory), 0
    with tempfile.TemporaryDirectory(dir=folder, prefix=".vtk-") as name:
        beside = Path(name)
        for frame in tqdm(frames_of(trajectory, every), desc="vtk", unit="frame", disable=not progress):
            for number, (file, mesh) in enumerate(_parts(meshes, frame, since)):
                if not (beside / file).exists():
                    _write(mesh, beside / file)
                time = repr(float(trajectory.time[frame]))
                ElementTree.SubElement(collection, "DataSet", timestep=time, part=str(number), file=file)
            since = frame
        # From here on it is a matter of moments; while there is no series, nothing refers to files that are not there.
        (folder / SERIES).unlink(missing_ok=True)
        for old in [path for path in folder.iterdir() if PARTS.fullmatch(path.name)]:
            old.unlink()
        for new in list(beside.iterdir()):
            new.replace(folder / new.name)
    ElementTree.indent(series)
    with replacing(folder / SERIES) as part:
        ElementTree.ElementTree(series).write(part, encoding="utf-8", xml_declaration=True)


def _parts(meshes: Meshes, frame: int, since: int) -> Iterator[tuple[str, "pyvista.PolyData"]]:
    """File and mesh of each part of a frame, the same parts in every frame; what never changes has one file."""
    yield f"points-{frame:04d}.vtp", meshes.points(frame)
    if meshes.trajectory.scene.baffles:
        changes = meshes.trajectory.solid_impulse is not None
        yield f"baffles-{frame:04d}.vtp" if changes else "baffles.vtp", meshes.baffles(frame, since)
    yield "domain.vtp", meshes.domain()


def _write(mesh: "pyvista.PolyData", path: Path) -> None:
    """Write a VTP: compressed, all arrays as they are behind the XML. Raises WorkFailed."""
    from pyvista.core.utilities.writer import XMLPolyDataWriter

    writer: Any = XMLPolyDataWriter(path, mesh).writer
    writer.SetDataModeToAppended()
    writer.EncodeAppendedDataOff()
    if not writer.Write():
        raise WorkFailed(f"{path.name} could not be written: is the disk full?")
