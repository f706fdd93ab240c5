"""python -m validation.vtk TRAJECTORY --out DIR: converts a trajectory for ParaView, and draws one of its frames."""

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
    frames: int = 1,
    colour: Literal["velocity", "displacement", "pressure", "plastic_strain", "material"] = "displacement",
    time: float | None = None,
) -> None:
    """Convert a trajectory for ParaView into OUT/trajectory.pvd, a series of VTK files.

    Args:
        trajectory: A trajectory (NPZ), or the folder of a run that holds one.
        out: Folder for the results.
        picture: Also draw a frame: OUT/picture.png.
        frames: Write every n-th frame, and always the last one.
        colour: Quantity that the colours of the picture show.
        time: Time of the picture [s], to the nearest frame; default: the end.
    """
    from datasets.exchange.vtk import SERIES, frames_of, write_vtk
    from datasets.flow.fields import Colour
    from validation.rendering import require_recorded, write_picture

    require(frames >= 1, "--frames", "an integer of at least 1", frames)
    flow = read_trajectory(trajectory)
    end = float(flow.time[-1])
    require(time is None or 0.0 <= time <= end, "--time", f"a time from 0 to {end:g} s", time)
    with naming(trajectory_file(trajectory)):
        require_recorded(flow, Colour(colour))
    make_folder(out)
    print(f"{len(frames_of(flow, frames))} frames of {flow.positions.shape[1]} particles")
    write_vtk(flow, out, every=frames, progress=True)
    print(f"written to {out / SERIES}")
    if picture:
        nearest = int(abs(flow.time - (end if time is None else time)).argmin())
        write_picture(out / "picture.png", flow, Colour(colour), nearest)
        print(f"t = {flow.time[nearest]:.3f} s, drawn into {out / 'picture.png'}")


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.vtk"))
