"""python -m validation.bench.accuracy.bench mpm --out DIR: what an error costs, and what --tolerance reads."""

import sys
from pathlib import Path
from typing import Literal

from datasets.command_line import run
from datasets.files import write_text
from mpm.resolution import MEASURED
from validation.bench.accuracy import page as accuracy_report
from validation.bench.accuracy import studies


def command(
    what: Literal["mpm"],
    /,
    *,
    out: Path,
    keep: Path = Path("runs/accuracy"),
    dimension: Literal[2, 3] | None = None,
    ship: bool = False,
    quick: bool = False,
) -> None:
    """Error and cost of the MPM over cell, step and particles per cell, against a much finer grid.

    Parameters
    ----------
    what
        Whose accuracy.
    out
        Folder for accuracy.md, its pictures and resolution.toml.
    keep
        Folder for the deposits; what is there is not run again.
    dimension
        2 or 3: only the scenes of this dimension; both by default.
    ship
        Put resolution.toml where --tolerance reads it, not into the folder.
    quick
        A few coarse runs, to try the command; their figures mean nothing.
    """
    tried = studies.quick() if quick else studies.full()
    findings = [studies.carry_out(study, keep) for study in tried if dimension in (None, study.dimension)]
    measured = studies.measured(findings)
    accuracy_report.write(out, findings, measured)
    write_text(MEASURED if ship else out / MEASURED.name, accuracy_report.toml(measured))


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.bench.accuracy.bench"))
