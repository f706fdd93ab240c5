"""python -m validation.view FLOW [OTHER]: a flow as one HTML page with a time slider, which opens from disk."""

import sys
from pathlib import Path
from typing import Any

from datasets.command_line import run
from datasets.errors import InputError, naming
from datasets.files import make_folder, read_json, reading

FIELDS = ("velocities", "pressure", "plastic_strain", "pore_pressure")  # recorded fields that the page can show
TARGETS = "mpm/target-*.npz"  # file in which `validation.loop` stores the flow of a twin experiment


def source_of(path: Path) -> tuple[Path, str, dict[str, Any]]:
    """File and name of the flow at a path, and its observations (`datasets.exchange.page.Observed`). The path is a
    trajectory, the folder of a run, or the folder of an inversion, for the MPM run at its first answer. Raises
    InputError."""
    from datasets.flow.trajectory import trajectory_file

    result = path / "result.json"
    record = read_json(result) if path.is_dir() else None
    if record is None:
        return trajectory_file(path), path.resolve().name if path.is_dir() else path.stem, {}
    with reading(result, "the result of an inversion"):
        runs = [mpm_run for mpm_run in record["mpm_runs"] if mpm_run["file"]]
        checks = [mpm_run for mpm_run in runs if mpm_run["purpose"] == "check"] or runs
        if not checks:
            raise InputError("expected a run of the MPM, this result has none", key="mpm_runs")
        widths = {name: float(width) or 1.0 for name, width in record["certainty"].items()}

        def away(mpm_run: dict[str, Any]) -> float:
            """Largest distance from the answer, in half-widths."""
            numbers = mpm_run["unknowns"].items()
            return max(float(abs(value - record["unknowns"][name])) / widths[name] for name, value in numbers)

        best = min(checks, key=away)
        seen = record["observation"]
        profile = {key: [float(value) for value in seen.get("profile", {}).get(key, ())] for key in ("x", "height")}
        front = None if seen.get("front") is None else float(seen["front"])
        return path / str(best["file"]), "MPM nearest to the answer", {"front": front, **profile}


def command(flow: Path, other: Path | None = None, /, *, out: Path | None = None) -> None:
    """Write a flow, or two flows superimposed, as one HTML page, which opens from disk, without a network.

    Args:
        flow: A trajectory (NPZ or HDF5), the folder of a run that holds one, or the folder of validation.loop: then the
            MPM run at its answer, with the observations.
        other: A flow to draw over it, such as the surrogate's, the target's or one with another angle.
        out: The page to write; default: view.html in the folder of FLOW.
    """
    # Imported here: --help does not need the libraries for pictures and solids.
    from datasets.compare import labels_of
    from datasets.exchange.page import Observed, write_view
    from datasets.flow.trajectory import open_trajectory

    file, name, observed = source_of(flow)
    files, labels = [file, *sorted(flow.glob(TARGETS))[:1]], [name, "observed"]
    if other is not None:
        files, labels = [file, source_of(other)[0]], [*labels_of(flow, other)]
    page = out or (flow if flow.is_dir() else flow.parent) / "view.html"
    flows = [open_trajectory(path, *FIELDS, sound=True) for path in files]
    make_folder(page.parent)
    with naming(files[-1]):
        write_view(page, *flows, title=flow.resolve().name, labels=labels, observed=Observed(**observed))
    print(f"written to {page}, {page.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.view"))
