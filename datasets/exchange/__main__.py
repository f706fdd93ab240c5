"""python -m datasets.exchange DATASET --to LAYOUT, or SOURCE --from LAYOUT: datasets in the layouts of other codes."""

import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from datasets.command_line import run
from datasets.errors import InputError

LayoutName = Literal["geoelements", "lagrangebench"]


def command(
    dataset: Path,
    /,
    *,
    out: Path,
    to: LayoutName | None = None,
    from_: Annotated[LayoutName | None, Parameter(name="--from")] = None,
    scene: str | None = None,
    up: Literal["y", "z"] = "y",
) -> None:
    """Write a dataset of Talus in the layout of another code, or one of theirs as a dataset of Talus.

    One trajectory is in memory at a time. Running the same command again finishes what is missing. Their files are
    read without executing anything they hold.

    Parameters
    ----------
    dataset
        With --to a folder from python -m mpm.generate; with --from one of theirs: train, valid, test in .npz or .h5
        and metadata.json.
    out
        Folder of the result; empty, or begun by the same command.
    to
        Layout to write: geoelements (NPZ of geoelements/gns) or lagrangebench (HDF5 of LagrangeBench).
    from_
        Layout to read.
    scene
        With --from: the scene of all trajectories, a path or a shipped name: their box, obstacles, and the friction
        where the set has no tan(phi). Not needed for what --to has written, which keeps its scenes.
    up
        With --from: the axis that points up, y or z.
    """
    from datasets.exchange.conversion import export, import_dataset
    from datasets.library import read_scene

    if (to is None) == (from_ is None):
        raise InputError("expected one of --to and --from")
    if not dataset.is_dir():
        raise InputError("expected the folder of a dataset, there is none", where=str(dataset))
    if to is not None:
        if scene is not None or up != "y":
            raise InputError("expected --scene and --up with --from alone")
        export(dataset, to, out)
    elif from_ is not None:
        import_dataset(dataset, from_, out, scene=None if scene is None else read_scene(scene), up=up)


if __name__ == "__main__":
    sys.exit(run(command, "python -m datasets.exchange"))
