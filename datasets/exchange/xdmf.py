"""Trajectory -> XDMF: all times of the particles in trajectory.xdmf, numbers in trajectory.h5 beside it, by meshio.

Each time is a grid of its own, since particles move; meshio's reader, which expects a mesh that stays, takes the first
one's for that and the arrays of all. XDMF has neither units nor active vectors.
"""

import copy
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import h5py
import numpy as np
from tqdm import tqdm

from datasets.command_line import WorkFailed
from datasets.exchange.vtk import MOVING, UNCHANGING, Meshes, frames_of, spatial
from datasets.files import replacing
from datasets.trajectory import Trajectory

# meshio takes a while to import: only who writes with it pays for it.
if TYPE_CHECKING:
    from meshio.xdmf import TimeSeriesWriter

FILE, NUMBERS = "trajectory.xdmf", "trajectory.h5"


def write_xdmf(trajectory: Trajectory, folder: Path, *, every: int = 1, progress: bool = False) -> None:
    """Write every `every`-th frame of `trajectory`, and the last, into `folder`. Raises WorkFailed.

    While the numbers of an older file are replaced, no trajectory.xdmf refers to them.
    """
    from meshio.xdmf import TimeSeriesWriter

    meshes = Meshes(trajectory)
    writer = TimeSeriesWriter(folder / FILE)
    # Entered as a context, it would put the numbers into the current folder.
    writer.h5_filename = NUMBERS
    try:
        with replacing(folder / NUMBERS) as part:
            with h5py.File(part, "w") as writer.h5_file:
                # What is the same at all times is there once.
                shared: dict[str, ElementTree.Element] = {}
                for frame in tqdm(frames_of(trajectory, every), desc="xdmf", unit="frame", disable=not progress):
                    _write_frame(writer.collection, writer, meshes, frame, shared)
            (folder / FILE).unlink(missing_ok=True)
        ElementTree.indent(writer.xdmf_file)
        with replacing(folder / FILE) as index:
            ElementTree.ElementTree(writer.xdmf_file).write(index, encoding="utf-8", xml_declaration=True)
    except OSError as error:
        raise WorkFailed(f"{FILE} could not be written: {error}") from None


def _write_frame(
    collection: ElementTree.Element,
    writer: "TimeSeriesWriter",
    meshes: Meshes,
    frame: int,
    shared: dict[str, ElementTree.Element],
) -> None:
    """Add the grid of a frame to the collection; `shared` holds the elements that it has in common with the others."""
    trajectory = meshes.trajectory
    grid = ElementTree.SubElement(collection, "Grid", Name=MOVING, GridType="Uniform")
    ElementTree.SubElement(grid, "Time", Value=repr(float(trajectory.time[frame])))
    writer.points(grid, spatial(trajectory.positions[frame]))
    if "" in shared:
        grid.append(copy.deepcopy(shared[""]))
    else:
        writer.cells([("vertex", np.arange(trajectory.positions.shape[1])[:, None])], grid)
        shared[""] = grid[-1]
        # Without it a reader has to guess.
        shared[""].set("NodesPerElement", "1")
    for name, values in meshes.arrays(MOVING, frame, frame).items():
        if name in shared:
            grid.append(copy.deepcopy(shared[name]))
            continue
        writer.point_data({name: values}, grid)
        if name in UNCHANGING:
            shared[name] = grid[-1]
