"""python -m validation.bench.columns.transfer --out DIR: what stiffness, step and output change of a front, by AFLIP and by APIC."""

import sys
from pathlib import Path

from datasets.command_line import run
from datasets.files import write_text
from validation.bench.columns import transfer_page as transfer_report
from validation.bench.columns.transfer_cases import QUICK, Plan
from validation.runs import Run, RunStore


def command(*, out: Path, keep: Path = Path("runs/transfer"), quick: bool = False) -> None:
    """The front of a dry column over stiffness, step, output interval, cell and relaxation time, beside APIC's.

    Parameters
    ----------
    out
        Folder for transfer.md and transfer.png.
    keep
        Folder for the deposits; what is there is not run again.
    quick
        Coarse grids and few cases, to try the command; their figures mean nothing.
    """
    plan = QUICK if quick else Plan()
    runs = {case: Run(scene=case.scene()) for case in plan.cases()}
    flows = RunStore(keep).run(list(runs.values()))
    found = {case: transfer_report.figures(flow) for case, flow in zip(runs, flows, strict=True)}
    transfer_report.draw(out / "transfer.png", plan, found)
    write_text(out / "transfer.md", transfer_report.text(plan, found))


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.bench.columns.transfer"))
