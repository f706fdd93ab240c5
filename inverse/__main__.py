"""`python -m inverse PROBLEM --out DIR`: one inversion, by the surrogate or by the MPM, and what it cost."""

import sys
from pathlib import Path

from datasets.command_line import run
from inverse.forward.gns import MEMORY_GIB
from inverse.inversion import ForwardModel, Gradient, invert
from inverse.problem import read_problem


def main(
    problem: str,
    /,
    *,
    out: Path,
    gradient: Gradient | None = None,
    forward: ForwardModel | None = None,
    model: Path | None = None,
    memory_gib: float = MEMORY_GIB,
) -> None:
    """Find the unknowns of PROBLEM; leaves OUT/result.json, OUT/report.md and pictures.

    The MPM does not check the answer, so the verdict is "unconfirmed"; `python -m validation.loop` asks it.

    Parameters
    ----------
    problem
        Path of a problem in TOML, or the name of a shipped one.
    out
        Folder for the results.
    gradient
        Reverse mode, of the surrogate by default, of the MPM by its adjoint; central differences, the MPM's default;
        or none, a search without.
    forward
        What predicts the observation: the surrogate, unless the problem asks for none, or the MPM.
    model
        Weights of the surrogate; unless given, those that ship for 2D or for 3D.
    memory_gib
        Activations that the backward pass may find ready, instead of computing them again.
    """
    result = invert(
        read_problem(problem), forward=forward, gradient=gradient, model=model, memory_gib=memory_gib, out=out
    )
    for each in result.problem.parameters:
        print(f"{each.name:<24} {each.kind.text(result.unknowns[each.name])}")


if __name__ == "__main__":
    sys.exit(run(main, "python -m inverse"))
