"""`python -m validation.bench problems`: every shipped inverse problem, solved where it has no result yet."""

import shlex
import subprocess
import sys
from pathlib import Path

from datasets.command_line import WorkFailed
from datasets.errors import InputError
from datasets.processes import parent_environment
from inverse.problem import PROBLEMS, Problem, read_problem
from validation.bench.paper import read_paper
from validation.bench.problems.outcome import RESULT, Origin, Outcome, is_current, read, write_origin
from validation.bench.problems.page import page
from validation.bench.problems.targets import read_families

ENDED = (0, 1)
"""Exit statuses of a loop that came to an end: confirmed, and not."""
QUICK = ("friction-short-21",)
"""Problems of a quick page."""


def bench(out: Path, *, quick: bool, keep: Path, only: tuple[str, ...] = ()) -> str:
    """Solve every shipped problem that has no result in `keep`, write OUT/problems.md, and return its conclusion.

    Each problem is a `python -m validation.loop` of its own in KEEP/NAME: memory and seconds are its own. A result is
    kept unless the problem or the surrogate's weights have changed since. An answer that the MPM does not confirm is
    part of the page. only: solve these alone; the page has all that there are. Raises WorkFailed, once the page is
    written, where a problem could not be run.
    """
    names = sorted(path.stem for path in PROBLEMS.glob("*.toml"))
    for name in only:
        if name not in names:
            raise InputError("expected the name of a shipped problem", where=name, key="--only")
    requested = only or (QUICK if quick else tuple(names))
    found, failed = {}, []
    for name in names:
        problem = read_problem(name)
        outcome = read(problem, keep / name)
        if outcome is not None and not is_current(outcome):
            outcome = None
        if outcome is None and name in requested:
            outcome = solve(problem, keep / name)
            failed += [name] if outcome is None else []
        if outcome is not None:
            found[name] = outcome
    result = page(out, read_families(), found, read_paper(), quick=quick)
    conclusion = result.write(out / "problems.md")
    if failed:
        raise WorkFailed(f"could not be run: {', '.join(failed)}")
    return conclusion


def solve(problem: Problem, folder: Path) -> Outcome | None:
    """Run the loop on a shipped problem in a process of its own; None where it failed."""
    arguments = ["-m", "validation.loop", problem.name, "--out", str(folder)]
    origin = Origin.from_problem(problem, f"python {shlex.join(arguments)}", folder)
    # An older result is not this one's, should this one fail.
    (folder / RESULT).unlink(missing_ok=True)
    print(f"\n{origin.command}", flush=True)
    if run_loop(arguments) not in ENDED:
        return None
    write_origin(origin, folder)
    return read(problem, folder)


def run_loop(arguments: list[str]) -> int:
    """Run Python with `arguments` and return its exit status."""
    return subprocess.run([sys.executable, *arguments], check=False, env=parent_environment()).returncode
