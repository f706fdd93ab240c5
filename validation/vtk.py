"""python -m validation.vtk TRAJECTORY --out DIR: a trajectory for ParaView, as a picture and as a movie."""

import sys
from pathlib import Path
from typing import Literal

from datasets.command_line import run
from datasets.errors import naming, require
from datasets.files import make_folder
from datasets.flow.trajectory import read_trajectory, trajectory_file


def command(
    trajectory: Path,
    /,
    *,
    out: Path,
    picture: bool = False,
    movie: bool = False,
    frames: int = 1,
    colour: Literal["velocity", "displacement", "pressure", "plastic_strain", "material"] | None = None,
    time: float | None = None,
    rate: int = 25,
) -> None:
    """Write a trajectory for ParaView; leaves OUT/trajectory.pvd, a series of VTK files.

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
    frames
        Take every how many frames, into the series and the movie; the last frame always.
    colour
        What the colours tell; displacement in a picture and velocity in a movie, unless named.
    time
        Time of the picture [s], to the nearest frame; the end, unless given.
    rate
        Frames of the movie a second.
    """
    from datasets.exchange.vtk import SERIES, frames_of, write_vtk
    from datasets.flow.fields import Colour
    from validation.rendering import require_recorded, write_movie, write_picture

    for key, number in (("--frames", frames), ("--rate", rate)):
        require(number >= 1, key, "an integer of at least 1", number)
    flow = read_trajectory(trajectory)
    end = float(flow.time[-1])
    require(time is None or 0.0 <= time <= end, "--time", f"a time from 0 to {end:g} s", time)
    if colour is not None:
        with naming(trajectory_file(trajectory)):
            require_recorded(flow, Colour(colour))
    make_folder(out)
    shown = frames_of(flow, frames)
    print(f"{len(shown)} frames of {flow.positions.shape[1]} particles")
    write_vtk(flow, out, every=frames, progress=True)
    print(f"written to {out / SERIES}")
    if picture:
        nearest = int(abs(flow.time - (end if time is None else time)).argmin())
        write_picture(out / "picture.png", flow, Colour(colour or Colour.DISPLACEMENT), nearest)
        print(f"t = {flow.time[nearest]:.3f} s, drawn into {out / 'picture.png'}")
    if movie:
        write_movie(out / "movie.mp4", flow, Colour(colour or Colour.VELOCITY), shown, rate=rate)
        print(f"{len(shown)} frames, drawn into {out / 'movie.mp4'}")


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.vtk"))
