"""`python -m validation.loop.coverage PROBLEM --out DIR`: how often the truth lies within the half-widths that are stated.

The same twin experiment over and over, each with another jitter seed of its hidden flow and, if asked, other noise on
what is observed of it; the whole loop solves each.
"""

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from datasets import files
from datasets.command_line import run
from datasets.errors import InputError
from gns.inference import shipped
from gns.model import checkpoint
from inverse.forward.gns import GnsSource
from inverse.forward.interface import Simulate, SurrogateSource
from inverse.observations import deposit as observations
from inverse.observations.deposit import OfDeposit
from inverse.observations.target import Target, read_target
from inverse.problem import Observable, Problem, read_problem
from inverse.report.markdown import quantity, table
from inverse.result import Result
from mpm import simulate_many
from validation.loop.__main__ import solve
from validation.loop.runs import KeptRuns

FIRST_SEED = 1001
"""Jitter seed of the first hidden flow, then upwards; no problem of ours has such a one."""


def main(problem: str, /, *, out: Path, seeds: int = 10, noise: float = 0.0, model: Path | None = None) -> None:
    """Solve the twin experiment PROBLEM once for each of several hidden flows; leaves OUT/coverage.md.

    Running the same command again after a kill uses the MPM runs that are there.

    Parameters
    ----------
    problem
        Path of a problem in TOML with a hidden target, or the name of a shipped one.
    out
        Folder for the results, one more for each experiment.
    seeds
        How many experiments.
    noise
        Standard deviation of the noise on each number observed, as a fraction of how far the true deposit reaches
        (its front); of a share that passed, as a fraction of the share. The loop is told it.
    model
        Weights of the surrogate; unless given, those that ship for 2D or for 3D.
    """
    asked = read_problem(problem)
    if not asked.target.hidden:
        raise InputError("expected hidden = true, the truth must be known", where=problem, key="target")
    if asked.observations:
        raise InputError("expected one [observation]", where=problem, key="observations")
    if seeds < 1 or noise < 0.0:
        raise InputError(f"expected at least one seed and no negative noise, got {seeds} and {noise:g}")
    simulator = checkpoint.load(model or shipped(asked.scene.dimension)).simulator
    results = []
    for number in range(seeds):
        folder = out / f"{number + 1:02d}"
        twin = dataclasses.replace(asked, target=dataclasses.replace(asked.target, seed=FIRST_SEED + number))
        observation = observations.build(twin.observation, twin.scene)
        noisy, target = hidden(twin, observation, noise, folder, simulate_many)
        source: SurrogateSource = GnsSource(simulator, noisy, observation)
        result = solve(noisy, target, observation, folder, source, simulate_many).result
        result.write(folder)
        results.append(result)
        told = f"inside {len(result.inside)} of {len(result.unknowns)}"
        print(f"{number + 1}/{seeds}: {result.verdict}, {told}", flush=True)
    lines = page(asked, results, noise)
    files.write_text(out / "coverage.md", "\n".join(lines) + "\n")
    print("\n".join(lines))


def hidden(
    problem: Problem, observation: OfDeposit, noise: float, folder: Path, simulate: Simulate
) -> tuple[Problem, Target]:
    """`problem` that knows of its noise, and its target: the observation of a hidden flow, with that noise on it.

    Of the flow itself the target keeps nothing: a verdict that looked at it would know what was not observed.
    """
    kept = KeptRuns(folder / "mpm", simulate, prefix="target-", deposit_only=True)
    target = read_target(problem, observation, lambda scene: kept([scene])[0])
    share = problem.observation.kind is Observable.PASSED
    sigma = noise * float(target.values[0] if share else target.edge)
    chance = np.random.default_rng([problem.target.seed, 2]).normal(size=len(target.values))
    values = target.values + sigma * chance
    known = dataclasses.replace(problem, target=dataclasses.replace(problem.target, noise=sigma))
    return known, Target(values=values, edge=observation.edge(values), truth=target.truth, noise=sigma)


def page(problem: Problem, results: Sequence[Result], noise: float) -> list[str]:
    """The table and what it comes to, in Markdown."""
    rows = []
    for result in results:
        truth, widths = result.target.truth or {}, result.certainty or {}
        cells = [
            f"{quantity(name, value)} (truth {quantity(name, truth[name])}, "
            + (f"± {quantity(name, widths[name])})" if widths else "no half-width)")
            for name, value in result.unknowns.items()
        ]
        rows.append(
            [
                str(result.problem.target.seed),
                "<br>".join(cells),
                f"{len(result.inside)} of {len(result.unknowns)}",
                f"{len(result.checks)} (+ {len(result.mpm_runs) - len(result.checks)})",
                f"{result.total_seconds:.0f}",
                str(result.verdict),
            ]
        )
    count = len(problem.unknowns)
    every = [name for result in results for name in result.inside]
    by_name = [f"`{name}` {every.count(name)}" for name in problem.names if count > 1]
    return [
        f"# {problem.name}: does the half-width hold?",
        "",
        f"{len(results)} hidden flows that differ in their jitter seed"
        + (f", with noise of {100.0 * noise:g} % on what is observed" if noise else "")
        + ". Each half-width is meant to hold the truth 95 times in 100.",
        "",
        *table(["seed", "found", "truth inside", "MPM runs (and ensemble)", "seconds", "verdict"], rows),
        "",
        f"The truth lies within the half-width {len(every)} times of {count * len(results)}"
        + (f"; per unknown, of {len(results)}: {', '.join(by_name)}." if by_name else "."),
    ]


if __name__ == "__main__":
    sys.exit(run(main, "python -m validation.loop.coverage"))
