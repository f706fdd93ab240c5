"""Trajectory -> one VTKHDF file that ParaView opens: all times of the particles, the baffles, the solids and the box.

The parts are temporal PolyData in a MultiBlockDataSet, as VTKHDF 2.6 has them
(https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/vtkhdf_specifications.html): the frames of an array
lie one behind the other, `Steps` says where each begins; what never changes is there once.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from datasets.command_line import WorkFailed
from datasets.exchange.vtk import ACTIVE, MOVING, UNCHANGING, Meshes, frames_of, spatial
from datasets.files import replacing
from datasets.trajectory import Trajectory

if TYPE_CHECKING:
    import h5py
    import pyvista

FILE = "trajectory.vtkhdf"
VERSION = (2, 6)
"""Of the format; its minor number is that of the active attributes."""


class Block:
    """A part of the trajectory in the file, one frame of it at a time."""

    def __init__(self, group: "h5py.Group", meshes: Meshes, name: str, times: NDArray[np.float64]) -> None:
        self.group, self.meshes, self.name, self.count = group, meshes, name, len(times)
        self.steps = group.create_group("Steps")
        group.attrs["Version"] = np.array(VERSION)
        group.attrs.create("Type", np.bytes_("PolyData"))
        self.steps.attrs["NSteps"] = len(times)
        self.steps["Values"] = times
        self.steps["NumberOfParts"], self.steps["PartOffsets"] = np.ones(len(times), np.int64), np.arange(len(times))
        shape, kind = meshes.shape(name, 0), "PointData" if name == MOVING else "CellData"
        self._describe_cells(shape)
        self.changing: dict[str, h5py.Dataset] = {}
        group["NumberOfPoints"] = np.full(len(times), shape.n_points)
        self.steps["PointOffsets"] = self._make("Points", np.asarray(shape.points), changes=name == MOVING)
        group.create_group(kind)
        offsets = self.steps.create_group(f"{kind}Offsets")
        for array, values in meshes.arrays(name, 0, 0).items():
            key = f"{kind}/{array}"
            offsets[array] = self._make(key, values, changes=array not in UNCHANGING)
            group[key].attrs["units"] = meshes.unit(array)
            if array == ACTIVE.get(name):
                group[key].attrs.create("Attribute", np.bytes_("Vectors"))

    def write(self, step: int, frame: int, since: int) -> None:
        """Put what changes of `frame` in its place, at the time of number `step`; `since` as for `Meshes.part`."""
        if not self.changing:
            return
        arrays = self.meshes.arrays(self.name, frame, since)
        if self.name == MOVING:
            arrays["Points"] = spatial(self.meshes.trajectory.positions[frame])
        for name, dataset in self.changing.items():
            values = arrays[name]
            dataset[step * len(values) : (step + 1) * len(values)] = values

    def _make(self, key: str, values: NDArray[Any], *, changes: bool) -> NDArray[np.int64]:
        """Make an array for all times; one that does not change is written at once. Returns where each time begins."""
        if changes:
            shape = (len(values) * self.count, *values.shape[1:])
            self.changing[key.split("/")[-1]] = self.group.create_dataset(key, shape, values.dtype)
        else:
            self.group[key] = values
        return np.arange(self.count) * (len(values) if changes else 0)

    def _describe_cells(self, mesh: "pyvista.PolyData") -> None:
        """Which points make up vertices, lines and polygons; the same at all times."""
        import pyvista

        kinds = {"Vertices": mesh.GetVerts(), "Lines": mesh.GetLines(), "Polygons": mesh.GetPolys()}
        for name, cells in (kinds | {"Strips": mesh.GetStrips()}).items():
            group, count = self.group.create_group(name), cells.GetNumberOfCells()
            offsets = pyvista.convert_array(cells.GetOffsetsArray()) if count else np.zeros(1)
            connectivity = pyvista.convert_array(cells.GetConnectivityArray()) if count else np.zeros(0)
            group["NumberOfCells"] = np.full(self.count, count)
            group["NumberOfConnectivityIds"] = np.full(self.count, len(connectivity))
            group["Offsets"], group["Connectivity"] = offsets.astype(np.int64), connectivity.astype(np.int64)
        for name in ("CellOffsets", "ConnectivityIdOffsets"):
            self.steps[name] = np.zeros((self.count, 4), np.int64)


def write_vtkhdf(trajectory: Trajectory, path: str | Path, *, every: int = 1, progress: bool = False) -> None:
    """Write every `every`-th frame of `trajectory`, and the last, into the VTKHDF file `path`.

    The same parts and arrays as `datasets.exchange.vtk.write_vtk` writes as a series; the unit of an array is its HDF5
    attribute `units`, since VTK's reader passes over the field data of a part. Raises WorkFailed.
    """
    import h5py

    path, meshes, frames = Path(path), Meshes(trajectory), frames_of(trajectory, every)
    times = trajectory.time[frames]
    try:
        with replacing(path) as part, h5py.File(part, "w") as file:
            root = file.create_group("VTKHDF", track_order=True)
            root.attrs["Version"] = np.array(VERSION)
            root.attrs.create("Type", np.bytes_("MultiBlockDataSet"))
            whole, assembly = root.create_group("Steps"), root.create_group("Assembly", track_order=True)
            whole.attrs["NSteps"], whole["Values"] = len(frames), times
            blocks = {}
            for index, name in enumerate(meshes.parts):
                blocks[name] = Block(root.create_group(name), meshes, name, times)
                blocks[name].group.attrs["Index"] = index
                assembly[name] = h5py.SoftLink(blocks[name].group.name)
            since = 0
            for step, frame in enumerate(tqdm(frames, desc="vtkhdf", unit="frame", disable=not progress)):
                for block in blocks.values():
                    block.write(step, frame, since)
                since = frame
    except OSError as error:
        raise WorkFailed(f"{path.name} could not be written: {error.strerror or error.args[0]}") from None
