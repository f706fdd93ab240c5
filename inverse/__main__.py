"""`python -m inverse PROBLEM --out DIR`: one inversion by one forward model, and what it cost."""

import sys
from pathlib import Path

from datasets.command_line import run
from inverse.settings import ForwardModel


def main(problem: str, /, *, out: Path, forward: ForwardModel | None = None, model: Path | None = None) -> None:
    """Find the unknowns of PROBLEM; leaves OUT/result.json, OUT/report.md and pictures.

    Numbers are found by one forward model alone, so the verdict is "unconfirmed"; `python -m validation.loop` checks
    the answer by the MPM. Fields are found by the MPM's adjoint, and checked by a run of it.

    Args:
        problem: Path of a problem in TOML, or the name of a shipped one.
        out: Folder for the results.
        forward: What predicts the observation: the surrogate, unless the problem asks for none; the MPM, by an emulator
            of its runs; or the MPM with the gradient of its adjoint.
        model: Weights of the surrogate; unless given, those that ship for 2D or for 3D.
    """
    # Imported here: torch takes seconds to load, and help has no use for it, nor a wrong problem for the solver.
    from inverse.problem import read_problem

    asked = read_problem(problem)
    from inverse.inversion import invert
    from inverse.report import summary

    result = invert(asked, forward=forward, model=model, out=out)
    print(summary(result))


if __name__ == "__main__":
    sys.exit(run(main, "python -m inverse"))
