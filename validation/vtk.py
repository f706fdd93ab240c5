"""python -m validation.vtk TRAJECTORY --out DIR: a trajectory for ParaView, as a picture and as a movie."""

import sys
from enum import StrEnum
from pathlib import Path
from time import perf_counter

import numpy as np

from datasets.command_line import listed, run
from datasets.errors import InputError
from datasets.exchange import vtk, vtkhdf, xdmf
from datasets.exchange.vtk import frames_of, write_vtk
from datasets.exchange.vtkhdf import write_vtkhdf
from datasets.exchange.xdmf import write_xdmf
from datasets.files import make_folder
from datasets.trajectory import Trajectory, read_trajectory, trajectory_file
from validation.report.rendering import Colour, require, write_movie, write_picture


class Format(StrEnum):
    """How a trajectory is stored for ParaView."""

    PVD = "pvd"
    VTKHDF = "vtkhdf"
    XDMF = "xdmf"
    VTU = "vtu"


def written(format: Format, flow: Trajectory, out: Path, every: int) -> str:
    """Write `flow` into the folder `out`, and return what that took, in one line."""
    clock = perf_counter()
    match format:
        case Format.PVD:
            write_vtk(flow, out, every=every, progress=True)
            path, files = out / vtk.SERIES, [each for each in out.iterdir() if vtk.PARTS.fullmatch(each.name)]
        case Format.VTKHDF:
            path, files = out / vtkhdf.FILE, []
            write_vtkhdf(flow, path, every=every, progress=True)
        case Format.XDMF:
            write_xdmf(flow, out, every=every, progress=True)
            path, files = out / xdmf.FILE, [out / xdmf.NUMBERS]
        case Format.VTU:
            path = out / "vtu" / vtk.SERIES
            write_vtk(flow, path.parent, every=every, suffix=".vtu", progress=True)
            files = [each for each in path.parent.iterdir() if each != path]
    took, size = perf_counter() - clock, sum(each.stat().st_size for each in (path, *files))
    return f"{format}: {1 + len(files)} file{'s' if files else ''}, {size / 1e6:.1f} MB in {took:.1f} s, {path}"


def command(
    trajectory: Path,
    /,
    *,
    out: Path,
    picture: bool = False,
    movie: bool = False,
    format: str = Format.PVD,
    frames: int = 1,
    colour: Colour | None = None,
    time: float | None = None,
    rate: int = 25,
) -> None:
    """Write a trajectory for ParaView; leaves OUT/trajectory.pvd, a series of VTK files, unless asked for others.

    Says of each format how many files it takes, how large they are and how long it took.

    Parameters
    ----------
    trajectory
        A trajectory (NPZ), or the folder of a run that holds one.
    out
        Folder for the results.
    picture
        Draw the last frame, too: OUT/picture.png.
    movie
        Draw all frames, too: OUT/movie.mp4.
    format
        Any of pvd (VTP files and their index), vtkhdf (one file), xdmf (XML and HDF5) and vtu (a series of unstructured
        grids in OUT/vtu), separated by commas.
    frames
        Take every how many frames, into the series and the movie; the last frame always.
    colour
        What the colours tell; displacement in a picture and velocity in a movie, unless named.
    time
        Time of the picture [s], to the nearest frame; the end, unless given.
    rate
        Frames of the movie a second.
    """
    for key, number in (("--frames", frames), ("--rate", rate)):
        if number < 1:
            raise InputError(f"expected an integer of at least 1, got {number}", key=key)
    chosen = [Format(name) for name in listed(format, list(Format), "--format")]
    flow = read_trajectory(trajectory)
    end = float(flow.time[-1])
    if time is not None and not 0.0 <= time <= end:
        raise InputError(f"expected a time from 0 to {end:g} s, got {time:g}", key="--time")
    if colour is not None:
        try:
            require(flow, colour)
        except InputError as error:
            raise error.at(str(trajectory_file(trajectory))) from None
    make_folder(out)
    shown = frames_of(flow, frames)
    print(f"{len(shown)} frames of {flow.positions.shape[1]} particles")
    for each in chosen:
        print(written(each, flow, out, frames))
    if picture:
        nearest = int(np.argmin(np.abs(flow.time - (end if time is None else time))))
        write_picture(out / "picture.png", flow, colour or Colour.DISPLACEMENT, nearest)
        print(f"t = {flow.time[nearest]:.3f} s, drawn into {out / 'picture.png'}")
    if movie:
        drawn = write_movie(out / "movie.mp4", flow, colour or Colour.VELOCITY, shown, rate=rate, progress=True)
        print(f"{len(shown)} frames, drawn into {drawn}")


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.vtk"))
