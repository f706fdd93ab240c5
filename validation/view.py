"""python -m validation.view FLOW [OTHER]: a flow as one HTML page with a time slider, which opens from disk."""

import sys
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

from datasets.command_line import run
from datasets.errors import InputError, naming
from datasets.files import read_json, reading

FIELDS = ("velocities", "pressure", "plastic_strain")
"""Recorded ones that the page can show."""
TARGETS = "mpm/target-*.npz"
"""Where `validation.loop` leaves the flow of a twin experiment."""


@dataclass(frozen=True, kw_only=True)
class Source:
    """Where a flow is, and what is known of it besides."""

    file: Path
    name: str
    front: float | None = None
    """Of an inversion: x of the front that was observed [m]."""
    profile: Sequence[Sequence[float]] = ((), ())
    """x and height [m] of the profile that was measured."""
    target: Path | None = None
    """The flow that was observed."""


def source_of(path: Path) -> Source:
    """The flow at a path: a trajectory, the folder of a run, or of an inversion the MPM's run at its first answer.

    Raises InputError.
    """
    from datasets.flow.trajectory import trajectory_file

    result = path / "result.json"
    found = read_json(result) if path.is_dir() else None
    if found is None:
        return Source(file=trajectory_file(path), name=path.resolve().name if path.is_dir() else path.stem)
    with reading(result, "the result of an inversion"):
        runs = [each for each in found["mpm_runs"] if each["file"]]
        checks = [each for each in runs if each["purpose"] == "check"] or runs
        if not checks:
            raise InputError("expected a run of the MPM, this result has none", key="mpm_runs")
        # One of the first answer.
        best = min(checks, key=lambda each: (each["unknowns"] != found["unknowns"], each["loss"] or 0.0))
        seen = found["observation"]
        profile = [[float(value) for value in seen.get("profile", {}).get(key, ())] for key in ("x", "height")]
        front = None if seen.get("front") is None else float(seen["front"])
        file = path / str(best["file"])
    target = min(path.glob(TARGETS), default=None)
    return Source(file=file, name="MPM at the answer", front=front, profile=profile, target=target)


def command(flow: Path, other: Path | None = None, /, *, out: Path | None = None) -> None:
    """Write a flow, or two over each other, as one HTML page; it opens from disk, without a network.

    Parameters
    ----------
    flow
        A trajectory (NPZ or HDF5), the folder of a run that holds one, or the folder of validation.loop: the MPM's run
        at its answer over what was observed.
    other
        A flow to draw over it: the surrogate's, the target's, one of another angle.
    out
        The page to write; view.html in the folder of FLOW unless given.
    """
    # Imported here: --help needs neither the pictures' libraries nor the solids'.
    from datasets.compare import labels_of
    from datasets.exchange.page import Observed, write_view
    from datasets.flow.trajectory import open_trajectory

    first = source_of(flow)
    second = None if other is None else source_of(other)
    labels = [first.name, "observed"]
    if second is not None and other is not None:
        labels = [*labels_of(flow, other)]
    elif first.target is not None:
        second = Source(file=first.target, name="observed")
    page = out or (flow if flow.is_dir() else flow.parent) / "view.html"
    flows = [open_trajectory(each.file, *FIELDS) for each in (first, second) if each is not None]
    observed = Observed(front=first.front, x=first.profile[0], height=first.profile[1])
    with nullcontext() if second is None else naming(second.file):
        write_view(page, *flows, title=flow.resolve().name, labels=labels, observed=observed)
    print(f"written to {page}, {page.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.view"))
