"""python -m datasets.exchange DATASET --to geoelements, or --from geoelements: datasets in the layout of that code."""

import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from datasets.command_line import run
from datasets.errors import InputError


def command(
    dataset: Path,
    /,
    *,
    out: Path,
    to: Literal["geoelements"] | None = None,
    from_: Annotated[Literal["geoelements"] | None, Parameter(name="--from")] = None,
    scene: str | None = None,
    up: Literal["y", "z"] = "y",
) -> None:
    """Write a dataset of Talus in the layout of geoelements/gns, or one of theirs as a dataset of Talus.

    One trajectory is in memory at a time. Their files are read without executing anything they hold.

    Parameters
    ----------
    dataset
        With --to a folder from python -m mpm.generate; with --from one of theirs: train, valid, test in .npz and
        metadata.json.
    out
        Folder of the result; empty.
    to
        Layout to write.
    from_
        Layout to read.
    scene
        With --from: the scene of all trajectories, a path or a shipped name: their box, obstacles, and the friction
        where the set has no tan(phi).
    up
        With --from: the axis that points up, y or z.
    """
    from datasets.exchange.conversion import export, import_dataset
    from datasets.library import read_scene

    if (to is None) == (from_ is None):
        raise InputError("expected one of --to and --from")
    if (scene is None) != (from_ is None) or (to is not None and up != "y"):
        raise InputError("expected --scene with --from, and it and --up with --from alone")
    if not dataset.is_dir():
        raise InputError("expected the folder of a dataset, there is none", where=str(dataset))
    if scene is None:
        export(dataset, out)
    else:
        import_dataset(dataset, out, scene=read_scene(scene), up=up)


if __name__ == "__main__":
    sys.exit(run(command, "python -m datasets.exchange"))
