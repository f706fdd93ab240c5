"""`python -m validation.design PROBLEM --out DIR`: where barriers stand so that a limit is kept as often as asked."""

import sys
from pathlib import Path

from datasets.command_line import run
from datasets.errors import WorkFailed


def main(problem: str, /, *, out: Path, scheduler: str | None = None) -> None:
    """Find the cheapest design that keeps a limit as often as asked, over what is uncertain, checked by the MPM.

    Leaves OUT/design.json, OUT/report.md, OUT/design.png, OUT/mpm. Running the same command again after a kill uses the
    MPM runs that are there. Exit status 1 where the MPM does not confirm the design.

    Args:
        problem: Path of a design problem in TOML, or the name of a shipped one.
        out: Folder for the results.
        scheduler: Address of a Dask scheduler, such as tcp://10.0.0.1:8786, or its JSON file, whose workers run the
            MPM.
    """
    # Imported here: torch takes seconds to load, and help has no use for it.
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
