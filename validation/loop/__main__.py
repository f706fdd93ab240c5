"""`python -m validation.loop PROBLEM --out DIR`: an inversion with uncertainty, whose answers the MPM checks."""

import sys
from pathlib import Path

from datasets.command_line import run
from datasets.errors import WorkFailed
from inverse.settings import Surrogate


def main(
    problem: str,
    /,
    *,
    out: Path,
    targets: Path | None = None,
    model: Path | None = None,
    surrogate: Surrogate | None = None,
    scheduler: str | None = None,
) -> None:
    """Find all parameters that PROBLEM allows, checked by the MPM.

    Writes OUT/result.json, OUT/posterior.npz, OUT/report.md, pictures and OUT/mpm. An interrupted command, started
    again, reuses the MPM runs that are finished. The exit status is 1 if the MPM confirms no answer.

    Args:
        problem: Path of a problem in TOML, or the name of a shipped one.
        out: Folder for the results.
        targets: A folder of deposits: trajectories, or CSV files of what PROBLEM observes. Each replaces PROBLEM's
            target and is inverted into OUT/NAME; all of them share the MPM runs. Also writes OUT/series.csv,
            OUT/series.json and OUT/report.md.
        model: Weights of the surrogate, or the folder of `inverse.adapt`, whose MPM runs are then reused; by default,
            the weights that ship for 2D or 3D. A model given here is used unless the problem says "none".
        surrogate: "gns": always use the learned surrogate; "coarse": the MPM on cells twice as large; "none": the MPM
            alone; "auto", the default of a problem: the learned surrogate if an MPM run costs more than five of its
            predictions. A surrogate leads the search: the MPM starts at its answers.
        scheduler: Address of a Dask scheduler, such as tcp://10.0.0.1:8786, or its JSON file. Its workers then run the
            MPM, the runs of a wave in parallel.
    """
    # Imported here: torch takes seconds to load, and --help does not need it.
    from contextlib import nullcontext
    from dataclasses import replace

    from inverse.answer import Verdict
    from inverse.problem import read_problem
    from mpm import simulate_many
    from mpm.cluster import connected
    from validation.loop.series import solve_series, summary
    from validation.loop.solve import print_outcome, solve
    from validation.loop.surrogate import estimate

    asked = read_problem(problem)
    if surrogate is not None:
        asked = replace(asked, surrogate=surrogate)
    if not asked.fields:
        print(estimate(asked, model, out), flush=True)
    with nullcontext(simulate_many) if scheduler is None else connected(scheduler) as simulate:
        if targets is None:
            result = solve(asked, out, model=model, simulate=simulate)
            print_outcome(result, out)
            return
        rows = solve_series(asked, targets, out, model=model, simulate=simulate)
    print(summary(rows, len(rows)))
    if others := [row["deposit"] for row in rows if not Verdict(row["verdict"]).confirms]:
        raise WorkFailed(f"not confirmed: {', '.join(others)}; see {out}/report.md")


if __name__ == "__main__":
    sys.exit(run(main, "python -m validation.loop"))
