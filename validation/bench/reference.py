"""The posterior of friction and cohesion by runs of the MPM alone, beside the emulator's: no emulator is in it.

Heights at gauges y* are a flow with noise of covariance N on them. A run i at v_i with a jitter seed of its own has the
weight w_i = N(y*; y_i, N) p(v_i) / q(v_i), whose mean over jitter seeds is the likelihood with the scatter of flows in
it: pseudo-marginal importance sampling (Andrieu & Roberts, The pseudo-marginal approach for efficient Monte
Carlo computations, Ann. Statist. 37 (2009) 697-725). Runs fill the cells of a grid over the box evenly, then those of
large weight: q is a cell's number of runs over its area.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.files import read_json, write_json
from inverse.parameters.prior import JointPrior
from inverse.posterior.sampling import systematic
from inverse.problem import Problem
from inverse.settings import LoopSettings, ObservationSettings
from inverse.target import Target, read_target
from mpm import LAST, simulate_many
from validation.loop.solve import solve
from validation.report.page import Page, between
from validation.runs import RunStore

Floats = NDArray[np.float64]
GAUGES, NOISE = (0.05, 0.15, 0.25, 0.35), 0.01
"""Where heights are measured, and the standard deviation of each [m]."""
CELLS = 10
"""Of the grid, along each axis."""
FIRST, STAGES = 4, ((600, 1.0), (400, 0.25))
"""Runs of each cell; those that follow, and the power of the likelihood by which: at its top, then in its tails."""
MORE = 3
"""Times the runs of the loop, of a second search: what its emulator does not know is part of its widths."""


def compare(
    problem: Problem, keep: Path, *, cells: int = CELLS, stages: Sequence[tuple[int, float]] = STAGES
) -> list[dict[str, Any]]:
    """Mean and deviation of each number by both, with the uniform and the stated prior; runs stay in `keep`."""
    asked = replace(problem, observations=(ObservationSettings(kind="height", x=GAUGES, noise=NOISE),))
    store = RunStore(keep / "mpm", simulate_many)
    target = read_target(asked, lambda scene: store([scene], record=LAST)[0])
    rng = np.random.default_rng(0)
    cell = np.repeat(np.arange(cells**2), FIRST)
    points = within(cell, cells, rng)
    likelihood = weighed(asked, target, store, points, first=0)
    for count, power in stages:
        share = np.bincount(cell, likelihood**power) / np.bincount(cell)
        chosen = systematic(share / share.sum(), count, rng)
        further = within(chosen, cells, rng)
        likelihood = np.concatenate([likelihood, weighed(asked, target, store, further, first=len(points))])
        points, cell = np.concatenate([points, further]), np.concatenate([cell, chosen])
    likelihood = likelihood / np.bincount(cell)[cell]
    rows, budget = [], asked.loop.budget(len(asked.numbers))
    uniform = tuple(replace(each, initial=each.start, prior=None) for each in asked.parameters)
    free, more = replace(asked, parameters=uniform, correlations=()), LoopSettings(mpm_runs=MORE * budget)
    for each in (free, asked, replace(free, loop=more)):
        runs = each.loop.budget(len(each.numbers))
        path = keep / f"{'uniform' if each.prior is None else 'stated'}-{runs}.json"
        if (known := read_json(path)) is None:
            found = solve(each, keep / path.stem)
            assert found.posterior is not None, "of numbers"
            samples = found.posterior.samples
            width = np.sqrt(np.diag(samples.covariance)).tolist()
            known = {"mean": samples.mean.tolist(), "deviation": width, "mpm_runs": len(found.mpm_runs)}
            write_json(path, known)
        rows += compared(each, points, likelihood, known)
    return rows


def within(cell: NDArray[np.int64], cells: int, rng: np.random.Generator) -> Floats:
    """A point of the unit box in each of these cells, shape [n, 2]."""
    corner = np.stack([cell // cells, cell % cells], axis=1)
    return np.asarray((corner + rng.random(corner.shape)) / cells)


def weighed(problem: Problem, target: Target, store: RunStore, points: Floats, *, first: int) -> Floats:
    """N(y*; y_i, N) over its largest value of runs at points [n, U], shape [n]; first: number of the first."""
    seeds = np.random.SeedSequence([problem.scene.seed, 1]).generate_state(first + len(points))[first:]
    scenes = [problem.scene_at(each, int(seed)) for each, seed in zip(problem.box.at(points), seeds, strict=True)]
    shown = np.stack([target.observation.observe(run) for run in store(scenes, record=LAST)])
    return np.asarray(np.exp(-0.5 * (((shown - target.values) / target.deviation) ** 2).sum(axis=1)))


def moments(points: Floats, weights: Floats) -> tuple[Floats, Floats, Floats]:
    """Mean, standard deviation and the standard error of the mean of points [n, U] of weights [n], shape [U] each."""
    share = weights / weights.sum()
    off = points - share @ points
    return share @ points, np.sqrt(share @ off**2), np.sqrt(share**2 @ off**2)


def compared(problem: Problem, points: Floats, likelihood: Floats, known: dict[str, Any]) -> list[dict[str, Any]]:
    prior: JointPrior | None = problem.prior
    weights = likelihood if prior is None else likelihood * np.exp(prior(points))
    effective = float(weights.sum() ** 2 / (weights**2).sum())
    mean, width, error = moments(points, weights)
    rows = []
    for index, each in enumerate(problem.numbers):
        own, size = known["mean"][index], known["deviation"][index]
        scale, text = each.range, each.kind.text
        rows.append(
            {
                "prior": "uniform" if prior is None else "stated",
                "unknown": f"`{each.name}`",
                "emulator": f"{text(each.bounds[0] + scale * own)} ± {text(scale * size)}",
                "runs alone": f"{text(each.bounds[0] + scale * mean[index])} ± {text(scale * width[index])}",
                "standard error of its mean": text(scale * error[index]),
                "difference of means over the width": float((own - mean[index]) / width[index]),
                "ratio of widths": float(size / width[index]),
                "runs of the emulator": known["mpm_runs"],
                "runs": len(points),
                "effective runs": round(effective),
            }
        )
    return rows


def conclusion(rows: Sequence[dict[str, Any]]) -> str:
    parts = []
    for runs in sorted({each["runs of the emulator"] for each in rows}):
        own = [each for each in rows if each["runs of the emulator"] == runs]
        off = max(abs(each["difference of means over the width"]) for each in own)
        widths = between([each["ratio of widths"] for each in own], ".2f")
        parts.append(f"by {runs} runs means differ by up to {off:.2f} standard deviations, widths are {widths} times")
    return f"Beside {rows[0]['runs']} runs without an emulator: {'; '.join(parts)}."


def section(page: Page, rows: Sequence[dict[str, Any]]) -> None:
    page.section("A posterior without an emulator")
    page.text(f"""
        Friction and cohesion of a column by heights at {len(GAUGES)} gauges to {100.0 * NOISE:g} cm, mean ± deviation:
        by the emulator, and by importance sampling with runs of the MPM alone, each of which draws the likelihood
        once (effective runs: (sum w)² / sum w²).
    """)
    page.table([{key: f"{own:.2f}" if isinstance(own, float) else own for key, own in each.items()} for each in rows])
