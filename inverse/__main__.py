"""`python -m inverse PROBLEM --out DIR`: one inversion with one forward model, and its cost."""

import sys
from pathlib import Path

from datasets.command_line import run
from inverse.settings import ForwardModel


def main(problem: str, /, *, out: Path, forward: ForwardModel | None = None, model: Path | None = None) -> None:
    """Find the unknowns of PROBLEM, and write OUT/result.json, OUT/report.md and pictures.

    Unknown numbers are found with one forward model, so the verdict is "unconfirmed"; `python -m validation.loop`
    checks the answer by the MPM. Unknown fields are found with the MPM's adjoint and checked by an MPM run.

    Args:
        problem: Path of a problem in TOML, or the name of a shipped one.
        out: Folder for the results.
        forward: The forward model: the surrogate (default, unless the problem says "none"); the MPM through an emulator
            of its runs; or the MPM with the gradient of its adjoint.
        model: Weights of the surrogate; by default, the weights that ship for 2D or 3D.
    """
    # Imported here: torch takes seconds to load, and neither --help nor a wrong problem needs it.
    from inverse.problem import read_problem

    asked = read_problem(problem)
    from inverse.inversion import invert
    from inverse.report import summary

    result = invert(asked, forward=forward, model=model, out=out)
    print(summary(result))


if __name__ == "__main__":
    sys.exit(run(main, "python -m inverse"))
