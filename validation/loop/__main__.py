"""`python -m validation.loop PROBLEM --out DIR`: an inversion that the MPM has confirmed, with its uncertainty."""

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

    Leaves OUT/result.json, OUT/posterior.npz, OUT/report.md, pictures, OUT/mpm. Running the same command again after a
    kill uses the MPM runs that are there. Exit status 1 where the MPM confirms no answer.

    Args:
        problem: Path of a problem in TOML, or the name of a shipped one.
        out: Folder for the results.
        targets: A folder of deposits, trajectories or CSV files of what PROBLEM observes: each is inverted in its
            place, into OUT/NAME; all share the runs of the MPM; leaves OUT/series.csv, OUT/series.json and
            OUT/report.md besides.
        model: Weights of the surrogate or the folder of `inverse.adapt`, whose runs of the MPM are then known; unless
            given, the weights that ship for 2D or for 3D. One that is given is asked unless the problem says "none".
        surrogate: "gns": the learned surrogate is always used; "coarse": the MPM on cells twice as large; "none": the
            MPM alone; "auto", the default of a problem: the learned one where a run of the MPM costs more than five of
            its predictions. It leads the search: the MPM starts at its answers.
        scheduler: Address of a Dask scheduler, such as tcp://10.0.0.1:8786, or its JSON file, whose workers run the MPM
            instead: the runs of a wave side by side.
    """
    # Imported here: torch takes seconds to load, and help has no use for it.
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
