"""`python -m validation.design PROBLEM --out DIR`: a barrier design that keeps a limit with a given probability."""

import sys
from pathlib import Path

from datasets.command_line import run
from datasets.errors import WorkFailed


def main(problem: str, /, *, out: Path, scheduler: str | None = None) -> None:
    """Find the cheapest design that keeps a limit with a given probability under uncertainty; the MPM checks it.

    Writes OUT/design.json, OUT/report.md, OUT/design.png and OUT/mpm. An interrupted command, started again, reuses the
    MPM runs that are finished. The exit status is 1 if the MPM does not confirm the design.

    Args:
        problem: Path of a design problem in TOML, or the name of a shipped one.
        out: Folder for the results.
        scheduler: Address of a Dask scheduler, such as tcp://10.0.0.1:8786, or its JSON file. Its workers then run the
            MPM.
    """
    # Imported here: torch takes seconds to load, and --help does not need it.
    from contextlib import nullcontext

    from inverse.answer import Verdict
    from mpm import simulate_many
    from mpm.cluster import connected
    from validation.design.problem import read_design
    from validation.design.solve import find_design, summary

    asked = read_design(problem)
    with nullcontext(simulate_many) if scheduler is None else connected(scheduler) as simulate:
        design = find_design(asked, out, simulate=simulate)
    print("\n  ".join(summary(design)))
    if design.verdict is not Verdict.CONFIRMED:
        raise WorkFailed(f"the design is {design.verdict}; what it gives is in {out}/report.md")


if __name__ == "__main__":
    sys.exit(run(main, "python -m validation.design"))
