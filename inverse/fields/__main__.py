"""`python -m inverse.fields PROBLEM --out DIR`: fields by the MPM's adjoint, how certain each value is, and a check."""

import sys
from pathlib import Path

from datasets.command_line import run
from inverse.fields.inversion import invert
from inverse.fields.problem import read_problem
from inverse.fields.report import identified, sentences


def main(problem: str, /, *, out: Path) -> None:
    """Find the fields of PROBLEM; leaves OUT/result.json, field.npz, scene.toml, report.md, pictures, VTK.

    Parameters
    ----------
    problem
        Path of a problem in TOML, or the name of a shipped one (`inverse/fields/problems`).
    out
        Folder for the results.
    """
    result = invert(read_problem(problem), out=out)
    print(f"{result.problem.name}: {result.verdict}")
    for text in sentences(result):
        print(text)
    for each in result.fields:
        print(f"{each.unknown.name}: {identified(each)}")


if __name__ == "__main__":
    sys.exit(run(main, "python -m inverse.fields"))
