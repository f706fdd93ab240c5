"""`python -m validation.bench.problems.bench --runs DIR --out DIR`: every inverse problem that ships, gathered in one document."""

import shlex
import subprocess
import sys
from pathlib import Path

from datasets.command_line import WorkFailed, run
from datasets.errors import InputError
from datasets.library import find
from inverse.problem import PROBLEMS, Problem, read_problem
from validation.bench.columns.paper import read_paper
from validation.bench.problems import page as problems_page
from validation.bench.problems import targets as bars
from validation.loop import outcomes
from validation.loop.outcomes import Origin, Outcome

SOLVED = (0, 1)
"""Exit statuses of a loop that came to an end: confirmed, and not."""


def main(*, runs: Path = Path("out/problems"), out: Path = Path("docs"), only: tuple[str, ...] = ()) -> None:
    """Solve every shipped problem that has no result yet, and write OUT/problems.md with its pictures.

    Each problem is a `python -m validation.loop` of its own in RUNS/NAME. What was solved is kept, unless the problem
    or the surrogate's weights have changed since; a command that was interrupted goes on where it stopped. Exit status
    1 where a problem could not be run; an answer that the MPM does not confirm is part of the document.

    Parameters
    ----------
    runs
        Folder of the results, one more for each problem.
    out
        Folder for the document.
    only
        Solve these shipped problems alone; the document has all that is there.
    """
    for name in only:
        if find(name, PROBLEMS, "problem").parent != PROBLEMS:
            raise InputError("expected the name of a shipped problem", where=name, key="--only")
    problems = {name: read_problem(name) for name in sorted(path.stem for path in PROBLEMS.glob("*.toml"))}
    found, failed = {}, []
    for name, problem in problems.items():
        outcome = current(problem, runs / name)
        if outcome is None and (not only or name in only):
            outcome = solve(problem, runs / name)
            failed += [name] if outcome is None else []
        if outcome is not None:
            found[name] = outcome
    problems_page.write(out, bars.read_families(), problems, found, read_paper())
    print(f"{len(found)} of {len(problems)} problems, gathered in {out / 'problems.md'}")
    if failed:
        raise WorkFailed(f"not solved: {', '.join(failed)}")


def current(problem: Problem, folder: Path) -> Outcome | None:
    """The outcome in `folder`, if it is of `problem` as it is now and, as far as is known, of today's surrogate."""
    outcome = outcomes.read(problem, folder)
    if outcome is None or outcome.origin is None:
        return outcome
    return outcome if outcome.origin.same(Origin.of(problem, "", folder)) else None


def solve(problem: Problem, folder: Path) -> Outcome | None:
    """Run the loop on a shipped problem in a process of its own; None where it failed."""
    arguments = ["-m", "validation.loop", problem.name, "--out", str(folder)]
    origin = Origin.of(problem, f"python {shlex.join(arguments)}", folder)
    # An older result is not this one's, should this one fail.
    (folder / outcomes.RESULT).unlink(missing_ok=True)
    print(f"\n{origin.command}", flush=True)
    if run_loop(arguments) not in SOLVED:
        return None
    origin.write(folder)
    return outcomes.read(problem, folder)


def run_loop(arguments: list[str]) -> int:
    """Run Python with `arguments` and return its exit status: memory and seconds are those of one problem alone."""
    return subprocess.run([sys.executable, *arguments], check=False).returncode


if __name__ == "__main__":
    sys.exit(run(main, "python -m validation.bench.problems.bench"))
