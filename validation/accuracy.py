"""python -m validation.accuracy mpm --out DIR: what an error costs, and what --tolerance reads."""

import sys
from pathlib import Path
from typing import Literal

from datasets.command_line import run
from datasets.files import write_text
from mpm.resolution import MEASURED
from validation import accuracy_report, bodies, studies


def command(
    what: Literal["mpm"],
    /,
    *,
    out: Path,
    seeds: int = 3,
    keep: Path = Path("runs/accuracy"),
    dimension: Literal[2, 3] | None = None,
    ship: bool = False,
) -> None:
    """Error and price of the MPM over cell, points per cell, step and precision, against a quarter of the cell.

    Parameters
    ----------
    what
        Whose accuracy.
    out
        Folder for accuracy.md, its pictures and resolution.toml.
    seeds
        Jitters of each run.
    keep
        Folder for the deposits; what is there is not run again.
    dimension
        2 or 3: only the scenes of this dimension; both by default.
    ship
        Put resolution.toml where --tolerance reads it, not into the folder.
    """
    findings = [
        studies.carry_out(study, seeds, keep) for study in studies.STUDIES if dimension in (None, study.dimension)
    ]
    spreads = bodies.compare(keep) if dimension != 3 else []
    measured = studies.measured(findings)
    accuracy_report.write(out, findings, spreads, measured, seeds)
    write_text(MEASURED if ship else out / MEASURED.name, accuracy_report.toml(measured))


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.accuracy"))
