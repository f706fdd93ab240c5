"""python -m datasets.exchange DATASET --to LAYOUT, or SOURCE --from LAYOUT: datasets in the layouts of other codes."""

import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from datasets.command_line import run
from datasets.errors import InputError
from datasets.exchange.conversion import export, import_dataset

LayoutName = Literal["geoelements", "lagrangebench"]


def command(
    dataset: Path,
    /,
    *,
    out: Path,
    to: LayoutName | None = None,
    from_: Annotated[LayoutName | None, Parameter(name="--from")] = None,
    friction_deg: float | None = None,
    spacing: float | None = None,
    up: Literal["y", "z"] = "y",
) -> None:
    """Write a dataset of Talus in the layout of another code, or one of theirs as a dataset of Talus.

    One trajectory is in memory at a time. Running the same command again finishes what is missing. Their files are
    read without executing anything they hold; their scenes are reconstructed, and each trajectory says what was
    assumed.

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
    friction_deg
        With --from: angle of friction [deg], for sets that do not say tan(phi) of their particles.
    spacing
        With --from: spacing of the particles at the start [m]; from the set's dx, or estimated, unless given.
    up
        With --from: the axis that points up, y or z.
    """
    if (to is None) == (from_ is None):
        raise InputError("expected one of --to and --from")
    if not dataset.is_dir():
        raise InputError("expected the folder of a dataset, there is none", where=str(dataset))
    if to is not None:
        if friction_deg is not None or spacing is not None or up != "y":
            raise InputError("expected --friction-deg, --spacing and --up with --from alone")
        export(dataset, to, out)
    elif from_ is not None:
        if spacing is not None and not spacing > 0.0:
            raise InputError(f"expected a positive length in m, got {spacing:g}", key="spacing")
        import_dataset(dataset, from_, out, friction_deg=friction_deg, spacing=spacing, up=up)


if __name__ == "__main__":
    sys.exit(run(command, "python -m datasets.exchange"))
