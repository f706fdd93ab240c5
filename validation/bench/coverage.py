"""`python -m validation.bench coverage`: how often the posterior contains the truth, and whether its ranks are uniform.

For each twin a truth v0 is drawn from the prior, its MPM flow (with its own jitter seed) is observed with the stated
noise, and the loop solves for it. If the posterior is right, the share of it denser than v0 is uniform over the twins,
and so is the share of each number's marginal below v0 (Talts, Betancourt, Simpson, Vehtari & Gelman, Validating
Bayesian inference algorithms with simulation-based calibration, arXiv:1804.06788, 2018; Hyndman, Computing and graphing
highest density regions, Am. Stat. 50 (1996) 120-126).
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from scipy.stats import chisquare, kstest
from tqdm import tqdm

from datasets.errors import InputError, suggestion
from datasets.files import read_json, read_toml, write_json
from datasets.processes import processors
from datasets.scene.library import read_scene
from datasets.schema import Record, from_mapping
from inverse.forward import Simulate
from inverse.observations.target import Target
from inverse.parameters.prior import Correlation, Prior
from inverse.problem import Problem, read_problem
from inverse.settings import Surrogate, TargetSettings
from inverse.target import read_target
from mpm import simulate_many
from mpm.cluster import pool
from validation.bench.page import Keep, Many, Out, Row, emphasised, write_page
from validation.forecast.predict import at, numbers_of, quantiles, recording_of, with_peaks
from validation.forecast.solve import forecast_scene
from validation.loop.solve import run, solve
from validation.loop.task import Task
from validation.plots import GREY, figure
from validation.run_store import kept

REGIONS = (0.5, 0.8, 0.95)
WITHIN = {0.5: (0.3, 0.7), 0.95: (0.88, 1.0)}
"""Probability of a region -> allowed share of truths in it: with 40 twins chance leaves a range once in a hundred."""
BINS = 8  # of the ranks, in the test of their uniformity
SIGNIFICANT = 0.01  # p-value below which ranks are not uniform: in so many tests, one in twenty would be below 0.05
FIRST_SEED = 100_000  # jitter seed of the first twin's target, then upwards; inversions have other seeds


@dataclass(frozen=True, kw_only=True)
class Family(Record):
    """Twins of one problem."""

    title: str
    problem: str
    """Name of a problem, or path of one beside this file, whose scene, numbers and observation the twins use."""
    noise: float | str | None = None
    """Noise of each observed number, as in `inverse.observations.ObservationSettings`; default: the problem's."""
    cell: float | None = None  # cells of the inversion [m]; default: those of the problem
    finer: float | None = None
    """Cells of the target's flow over the inversion's, which gives the inversion an error of its cells."""
    outlier: float = 0.0
    """Additional error of one random number, with random sign, in standard deviations of its noise."""
    priors: tuple[Prior, ...] = ()  # of the numbers, in their order; default: uniform
    correlation: float | None = None  # of the priors of the first two
    surrogate: Surrogate = Surrogate.NONE  # the surrogate that leads, if any
    adapted: bool = False  # whether it comes from `inverse.adapt`, whose MPM runs are then reused
    forecast: str | None = None
    """Path beside this file of another scene, which each posterior forecasts and which is then run with the truth."""
    twins: int = 40  # default number of twins; half as many for expensive ones


FAMILIES = {name: from_mapping(Family, each) for name, each in read_toml(Path(__file__).with_suffix(".toml")).items()}
DEFAULT = ("front", "profile")  # default families


@dataclass(frozen=True, kw_only=True)
class Twin(Record):
    """Place of the truth in the posterior."""

    seed: int
    denser: float
    """Share of the posterior that is denser than the truth: above 0.95 the truth is outside the 95 % region."""
    below: dict[str, float]  # share of each number's marginal below the true value
    inside: int  # number of true values within the intervals of the answer that contains most of them
    answers: int
    verdict: str
    runs: int
    seconds: float
    forecast: dict[str, bool] = field(default_factory=dict)
    """Whether the 95 % interval of each number of a forecast contains that of the true flow."""


def bench(
    *,
    out: Out,
    keep: Keep = None,
    twins: Annotated[int | None, Many] = None,
    only: tuple[str, ...] = DEFAULT,
    model: Path | None = None,
    jobs: Annotated[int | None, Many] = None,
) -> str:
    """Solve twin experiments with truths from the prior, in parallel, each on one thread.

    Args:
        twins: Number of twins in each family, instead of its own.
        only: Families of `coverage.toml` to solve; the page shows all results in KEEP.
        model: Folder of `python -m inverse.adapt unseen-friction-square-27`, for front-adapted.
        jobs: Number of processes, each of which solves a twin; default: one per processor.
    """
    if unknown := [name for name in only if name not in FAMILIES]:
        raise InputError(f"expected a family: {suggestion(unknown[0], FAMILIES)}", where=unknown[0], key="--only")
    if model is None and any(FAMILIES[name].adapted for name in only):
        raise InputError("expected the folder of an adaptation", key="--model")
    with kept(keep) as folder:
        missing = [
            (path.absolute(), FAMILIES[name], number, model)
            for name in only
            for number in range(twins or FAMILIES[name].twins)
            if not (path := folder / name / f"{number:03d}.json").exists()
        ]
        os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        with pool(min(jobs or processors(), len(missing) or 1)) as workers:
            solved = workers.finished(store_twin, missing)
            list(tqdm(solved, total=len(missing), unit="twin", leave=False, disable=None))
        groups = {
            family: [from_mapping(Twin, read_json(path) or {}) for path in paths]
            for name, family in FAMILIES.items()
            if (paths := sorted((folder / name).glob("[0-9]*.json")))
        }
    draw(out / "coverage.png", groups)
    flags = "".join(f" --only {name}" for name, family in FAMILIES.items() if family in groups)
    flags += " --model RUN" * any(family.adapted for family in groups)
    rows = [row(family, solved) for family, solved in groups.items()]
    return write_page(out, "coverage", conclusion(groups), flags=flags, bins=BINS, twins=rows)


def store_twin(path: Path, family: Family, number: int, model: Path | None) -> None:
    """Solve a twin and write the place of its truth; a process that is asked to end finishes its twin first."""
    write_json(path, asdict(solve_twin(family, number, model)))


def solve_twin(family: Family, number: int, model: Path | None = None) -> Twin:
    """Solve twin `number` on one thread; model: folder of an adaptation."""
    simulate = partial(simulate_many, threads=1)
    problem = drawn(family, number)
    with kept(None) as folder:
        if family.outlier != 0.0:
            target = misread(read_target(problem, lambda scene: simulate([scene])[0]), family.outlier, number)
            result = run(Task(problem=problem, target=target, folder=folder, simulate=simulate))
        else:
            out = None if family.forecast is None else folder / "loop"
            result = solve(problem, out, simulate=simulate, model=model if family.adapted else None)
        forecast = {} if family.forecast is None else forecasts(family, number, problem, folder / "loop", simulate)
    posterior, values = result.posterior, np.array([problem.target.truth[name] for name in problem.names])
    assert posterior is not None, "of numbers"
    where, samples, point = posterior.region.sampled, posterior.samples, problem.box.shares(values)
    excluded = np.any((point < where.low) | (point > where.high))
    density = -np.inf if excluded else float(posterior.likelihood(point[None])[0])
    return Twin(
        seed=FIRST_SEED + number,
        denser=float(samples.weights[samples.log_likelihood > density].sum()),
        below=problem.named(samples.weights @ (samples.points < point)),
        inside=max(int(answer.holds(values).sum()) for answer in result.answers),
        answers=len(result.answers),
        verdict=result.verdict.value,
        runs=len(result.mpm_runs),
        seconds=result.seconds["total"],
        forecast=forecast,
    )


def forecasts(family: Family, number: int, problem: Problem, result: Path, simulate: Simulate) -> dict[str, bool]:
    """Whether the intervals of a forecast from the posterior in `result` contain the numbers of the true flow."""
    scene = replace(read_scene(Path(__file__).parent / str(family.forecast)), seed=FIRST_SEED + number)
    prediction = forecast_scene(result, scene, simulate=simulate)
    # Jitter seeds other than those of the draws.
    true = at(scene, problem.names, np.array([problem.target.truth[name] for name in problem.names]), number)
    if family.finer is not None:
        true = true.with_cell(family.finer * true.domain.cell)
    flow = with_peaks(simulate([true], record=recording_of(scene))[0])
    ends = {name: quantiles(values, 0.95) for name, values in prediction.predicted.items()}
    return {name: bool(ends[name][0] <= value <= ends[name][-1]) for name, value in numbers_of(flow).items()}


def misread(target: Target, outlier: float, number: int) -> Target:
    """A target in which one random number of twin `number` is off by `outlier` standard deviations of its noise."""
    rng, values = np.random.default_rng([FIRST_SEED, number, 1]), target.values.copy()
    index = int(rng.integers(len(values)))
    values[index] += rng.choice([-1.0, 1.0]) * outlier * target.deviation[index]
    return replace(target, values=values)


def drawn(family: Family, number: int) -> Problem:
    """Twin experiment `number`: the problem of its family with priors, a truth drawn from these, and jitter seeds."""
    beside = Path(__file__).parent / family.problem
    asked = read_problem(beside if beside.exists() else family.problem)
    rng = np.random.default_rng([FIRST_SEED, number])
    if family.priors:
        both = zip(asked.parameters, family.priors, strict=True)
        asked = replace(asked, parameters=tuple(replace(parameter, prior=prior) for parameter, prior in both))
    if family.correlation is not None:
        pair = Correlation(between=(asked.names[0], asked.names[-1]), coefficient=family.correlation)
        asked = replace(asked, correlations=(pair,))
    shares = rng.random(len(asked.names))
    truth = asked.named(asked.box.at(shares if asked.prior is None else asked.prior.at(shares)))
    scene = replace(asked.scene, seed=int(rng.integers(2**31)))
    if family.cell is not None:
        scene = scene.with_cell(family.cell)
    observations = asked.observations
    if family.noise is not None:
        observations = tuple(replace(observation, noise=family.noise) for observation in observations)
    cell = None if family.finer is None else family.finer * scene.domain.cell
    target = TargetSettings(twin=True, seed=FIRST_SEED + number, truth=truth, cell=cell)
    return replace(asked, scene=scene, observations=observations, target=target, surrogate=family.surrogate)


def conclusion(groups: Mapping[Family, Sequence[Twin]]) -> list[str]:
    every = [twin for twins in groups.values() for twin in twins]
    said = [f"{len(every)} inversions with known parameters, of {len(groups)} kinds, test the stated uncertainty."]
    for level, (low, high) in WITHIN.items():
        good = sum(low <= held(twins, level) <= high for twins in groups.values())
        said.append(
            f"The {level:.0%} regions contain the true parameters in {held(every, level):.0%} of all cases;"
            f" {good} of {len(groups)} kinds lie within {low:.0%} to {high:.0%}, as chance allows."
        )
    uneven = "; ".join(family.title for family, twins in groups.items() if uniformity(twins) < SIGNIFICANT) or "none"
    said.append(f"Kinds whose truths are unevenly distributed over the posterior (p below {SIGNIFICANT:g}): {uneven}.")
    return said


def held(twins: Sequence[Twin], level: float) -> float:
    """Share of the truths within the region of `level`."""
    return float(np.mean([twin.denser <= level for twin in twins]))


def uniformity(twins: Sequence[Twin]) -> float:
    """p-value of a test that the share denser than the truth is uniform."""
    return float(kstest([twin.denser for twin in twins], "uniform").pvalue)


def ranks(twins: Sequence[Twin]) -> float:
    """Smallest p-value of tests that each number's ranks are uniform, times the count of numbers."""
    by_name = ([twin.below[name] for twin in twins] for name in twins[0].below)
    counts = [np.histogram(below, bins=BINS, range=(0.0, 1.0))[0] for below in by_name]
    return min(1.0, len(counts) * float(min(chisquare(count).pvalue for count in counts)))


def row(family: Family, twins: Sequence[Twin]) -> Row:
    within = []
    for level in REGIONS:
        share, (low, high) = held(twins, level), WITHIN.get(level, (0.0, 1.0))
        within.append(emphasised(f"{share:.0%}", low <= share <= high))
    inside = sum(twin.inside for twin in twins) / (len(twins[0].below) * len(twins))
    forecast = ", ".join(f"{name} {np.mean([twin.forecast[name] for twin in twins]):.0%}" for name in twins[0].forecast)
    return {
        "inversions": f"{family.title}: {len(twins)}",
        "truths in the " + " / ".join(f"{level:.0%}" for level in REGIONS) + " region": " / ".join(within),
        "p, regions / ranks": f"{uniformity(twins):.2g} / {ranks(twins):.2g}",
        "numbers in their intervals": f"{inside:.0%}",
        **({"numbers in the 95 % intervals of a forecast": forecast} if forecast else {}),
        "confirmed": f"{sum(twin.verdict == 'confirmed' for twin in twins)} of {len(twins)}",
        "MPM runs": f"{np.median([twin.runs for twin in twins]):.0f}",
        "seconds": f"{np.median([twin.seconds for twin in twins]):.0f}",
    }


def draw(path: Path, groups: Mapping[Family, Sequence[Twin]]) -> None:
    """Plot the share of truths in a region over its probability: on the diagonal if the posterior is right."""
    levels = np.linspace(0.0, 1.0, 101)
    with figure(path, size=(5.0, 4.0)) as axes:
        axis = axes[0, 0]
        axis.plot(levels, levels, color=GREY, linewidth=0.8)
        for family, twins in groups.items():
            axis.plot(levels, [held(twins, level) for level in levels], label=family.title, linewidth=1.2)
        axis.set(xlabel="share of the posterior in the region", ylabel="share of the truths in it")
        axis.legend()
