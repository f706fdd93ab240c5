"""A series: many deposits of one problem, each inverted with the same surrogate and with shared MPM runs.

An MPM run informs the inversion of every deposit of the same problem. The emulator of each deposit therefore uses the
runs of the adaptation (`inverse.adapt`) and of all earlier deposits, and needs few new runs besides its checks. Each
deposit has its own jitter seeds.
"""

import hashlib
import itertools
import json
import sys
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from datasets.errors import InputError, naming
from datasets.files import make_folder, read_json, write_csv, write_json, write_text
from datasets.flow.trajectory import SUFFIXES, Trajectory
from datasets.markdown import markdown_table
from inverse.answer import Verdict
from inverse.forward import Simulate
from inverse.observations.settings import TabulatedSettings
from inverse.problem import Problem, read_problem
from inverse.search.waves import jitter_seed
from inverse.settings import TargetSettings
from inverse.target import read_target
from mpm import simulate, simulate_many
from validation.loop.solve import Known, solve

RESULT, SERIES = "result.json", "series.json"
ENDS = (" from", " to")  # suffixes of an unknown's name in the columns of its interval


def solve_series(
    problem: Problem | Path | str,
    targets: Path | str,
    out: Path | str,
    *,
    model: Path | None = None,
    simulate: Simulate = simulate_many,
) -> list[dict[str, Any]]:
    """Invert every deposit in the folder `targets`, and return a row of the table for each.

    >>> from validation import solve_series
    >>> rows = solve_series("friction-tall-42", "deposits", "out/series", model="out/tall")

    targets: trajectories as `mpm.run` writes them, or CSV files of the problem's one observation. model: the folder of
    `inverse.adapt`, whose MPM runs are then reused, or other weights. Writes `out`/NAME for each deposit, as
    `validation.solve` does, and `series.csv`, `series.json` and `report.md`. Results that exist for the same problem
    and deposit are kept. Raises InputError, which names the file, before any work.
    """
    asked, out = problem if isinstance(problem, Problem) else read_problem(problem), Path(out)
    deposits = read_deposits(asked, Path(targets))
    make_folder(out)
    solved = (read_json(out / SERIES) or {}).get("digests", {})
    runs, rows, digests = list[Known](), list[dict[str, Any]](), dict[str, str]()
    for number, (name, deposit) in enumerate(deposits.items(), 1):
        folder = out / name
        digests[name] = digest(asked, deposit)
        if not (folder / RESULT).exists() or solved.get(name) != digests[name]:
            print(f"{name}, {number} of {len(deposits)}", file=sys.stderr)
            solve(deposit, folder, model=model, simulate=simulate, known=runs)
        result = json.loads((folder / RESULT).read_text())
        rows.append(row(name, result))
        # Only runs on the problem's own cell size.
        runs += [
            (np.array([run["unknowns"][key] for key in asked.names]), Trajectory.load(folder / run["file"]))
            for run in result["mpm_runs"]
            if run["purpose"] != "cells"
        ]
        write(out, asked, rows, len(deposits), digests)
    return rows


def digest(problem: Problem, deposit: Problem) -> str:
    """A digest of a problem and of a deposit's file: it differs if either has changed."""
    path = deposit.target.trajectory or vars(deposit.observations[0])["csv"]
    return hashlib.sha256(repr(problem).encode() + Path(path).read_bytes()).hexdigest()


def read_deposits(problem: Problem, folder: Path) -> dict[str, Problem]:
    """File name -> problem, for each deposit in a folder. Raises InputError, which names a bad file."""
    every = sorted(folder.glob("[!.]*"))
    files = [path for path in every if path.suffix.lower() in (*SUFFIXES, ".csv")]
    if others := [path.name for path in every if path not in files]:
        print(f"{folder}: not deposits, which are .npz, .h5 or .csv: {', '.join(others)}", file=sys.stderr)
    if not files:
        raise InputError("expected deposits, files in .npz, .h5 or .csv; there are none", where=str(folder))
    for path, other in itertools.pairwise(files):
        if path.stem == other.stem:
            raise InputError(f"expected a name of its own, it is that of {path.name}", where=str(other))
    problems = {}
    for path in files:
        with naming(path):
            problems[path.stem] = deposit = of_deposit(problem, path)
            # This only checks the file: a deposit needs no simulation.
            read_target(deposit, simulate)
    return problems


def of_deposit(problem: Problem, path: Path) -> Problem:
    """The problem with the deposit in a file as its target, and with its own jitter seeds."""
    target, observations = TargetSettings(trajectory=str(path.absolute())), problem.observations
    unmeasured = [replace(entry, **dict[str, Any](dict.fromkeys(entry.sources))) for entry in observations]
    if path.suffix.lower() == ".csv":
        (settings, *others) = unmeasured
        if others or not isinstance(settings, TabulatedSettings):
            message = f"expected a trajectory: the problem observes {', '.join(entry.kind for entry in observations)}"
            raise InputError(message)
        target = TargetSettings()
        unmeasured = [replace(settings, csv=str(path.absolute()))]
    scene = replace(problem.scene, seed=jitter_seed(problem.scene.seed, zlib.crc32(path.stem.encode())))
    return replace(problem, name=path.stem, scene=scene, observations=tuple(unmeasured), target=target)


def row(name: str, result: Mapping[str, Any]) -> dict[str, Any]:
    """The row of a deposit: its first answer with intervals, the verdict and the cost."""
    unknowns = dict[str, float]()
    for key, value in result["unknowns"].items():
        unknowns[key] = value
        unknowns |= {key + name: end for name, end in zip(ENDS, result["interval"][key], strict=True)}
    cost = {"MPM runs": len(result["mpm_runs"]), "seconds": round(result["seconds"]["total"], 2)}
    return {"deposit": name, **unknowns, "verdict": result["verdict"], "answers": len(result["answers"]), **cost}


def write(out: Path, problem: Problem, rows: Sequence[dict[str, Any]], count: int, digests: dict[str, str]) -> None:
    """Write the table of the deposits inverted so far, out of `count`, and their digests."""
    write_csv(out / "series.csv", [*rows[0]], ([*line.values()] for line in rows))
    write_json(out / SERIES, {"problem": problem.name, "deposits": rows, "digests": digests})
    kinds = {number.name + end: number.kind for number in problem.numbers for end in ("", *ENDS)}
    shown = [line | {key: kind.digit_text(line[key]) for key, kind in kinds.items()} for line in rows]
    text = markdown_table(shown, style="github", floatfmt=".1f", disable_numparse=[0])
    write_text(out / "report.md", f"# {problem.name}: a series\n\n{summary(rows, count)}\n\n{text}\n")


def summary(rows: Sequence[Mapping[str, Any]], count: int) -> str:
    """The outcome of a series, in a sentence."""
    confirmed = sum(Verdict(line["verdict"]).confirms for line in rows)
    runs, seconds = (np.mean([line[key] for line in rows]) for key in ("MPM runs", "seconds"))
    return (
        f"{len(rows)} of {count} deposits inverted, {confirmed} of them confirmed by the MPM; "
        f"{runs:.1f} MPM runs and {seconds:.0f} s per deposit."
    )
