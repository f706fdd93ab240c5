"""`python -m validation.bench coverage`: how often the posterior holds the truth, and whether its ranks are uniform.

A truth v0 is drawn from the prior, its flow by the MPM with a jitter seed of its own is observed with noise as stated,
and the loop solves for it. If the posterior is right, the share of it that is denser than v0 is uniform over the twins,
and so is the share of each number's marginal below v0 (Talts, Betancourt, Simpson, Vehtari & Gelman, Validating
Bayesian inference algorithms with simulation-based calibration, arXiv:1804.06788, 2018; Hyndman, Computing and graphing
highest density regions, Am. Stat. 50 (1996) 120-126).
"""

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import KW_ONLY, asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.stats import chisquare, kstest
from tqdm import tqdm

from datasets.errors import InputError
from datasets.files import read_json, write_json
from datasets.records import Record, from_mapping
from inverse.observations.target import Target
from inverse.parameters.prior import Correlation, Prior
from inverse.problem import Problem, read_problem
from inverse.result import Result
from inverse.settings import Surrogate, TargetSettings
from inverse.target import read_target
from mpm import simulate_many
from mpm.cluster import connected
from validation.loop.solve import run, solve
from validation.loop.task import Task
from validation.report.page import GNS, MPM, Page, Row
from validation.report.plots import GREY, figure

REGIONS = (0.5, 0.8, 0.95)
WITHIN = {0.5: (0.3, 0.7), 0.95: (0.88, 1.0)}
"""Shares of truths that a region is to hold: of 40 twins chance leaves each range once in a hundred."""
BINS = 8
"""Of the ranks, in the test of their uniformity."""
SIGNIFICANT = 0.01
"""p-value below which ranks are not uniform: of so many tests one in twenty would be below 0.05."""
FIRST_SEED = 100_000
"""Jitter seed of the first twin's target, then upwards; its inversion has others."""


@dataclass(frozen=True)
class Family:
    """Twins of one problem."""

    title: str
    problem: str
    """Name or path of a problem, whose scene, numbers and observation the twins have."""
    _: KW_ONLY
    noise: float | str | None = None
    """Of each observed number, as in `inverse.observations.ObservationSettings`; unless given the problem's own."""
    cell: float | None = None
    """Cells of the inversion [m]; unless given those of the problem."""
    finer: float | None = None
    """Cells of the target's flow, as a share of the inversion's: what the inversion's own cells get wrong."""
    outlier: float = 0.0
    """Error of one of the numbers besides its noise, in standard deviations of that; which, and its sign, are drawn."""
    priors: tuple[Prior, ...] = ()
    """Of the numbers, in their order; uniform unless given."""
    correlation: float | None = None
    """Of the priors of the first two."""
    surrogate: Surrogate = Surrogate.NONE
    """Whether one leads."""
    adapted: bool = False
    """Whether it is one of `inverse.adapt`, whose runs of the MPM are known."""
    twins: int = 40
    """How many are solved unless another number is asked for; of dear ones half as many."""


TWINS = Path(__file__).parent / "twins"
"""Problems of twins alone, that do not ship."""
FAMILIES = {
    "front": Family("Friction, front", "friction-tall-42"),
    "profile": Family("Friction, profile", "friction-tall-42-profile"),
    "front-noise": Family("Friction, front with 1 % noise", "friction-short-21", noise="1%"),
    "front-fine": Family("Friction, front of half the cells", "friction-tall-42", finer=0.5),
    "profile-fine": Family("Friction, profile of half the cells", "friction-tall-42-profile", finer=0.5),
    "cohesion": Family("Friction and cohesion, profile", "cohesion-friction"),
    "cohesion-fine": Family(
        "Friction and cohesion, profile of half the cells to 1 mm", "cohesion-friction", noise=0.001, finer=0.5
    ),
    "floor": Family("Friction of sand and floor, profile to 1 mm", "floor-friction"),
    "floor-fine": Family("Friction of sand and floor, profile of half the cells to 1 mm", "floor-friction", finer=0.5),
    "terrain": Family(
        "Friction and thickness on a terrain, front and heights of two thirds of the cells to 0.5 and 0.1 m",
        "hillside",
        cell=1.5,
        finer=2.0 / 3.0,
    ),
    "outlier": Family(
        "Velocity and friction of a block, eight fronts, one off by 10 deviations",
        str(TWINS / "sliding-block.toml"),
        outlier=10.0,
    ),
    "cells": Family(
        "Friction, eight fronts of a third of the cells of 20 mm to 2 mm",
        str(TWINS / "friction-tall-42-fronts.toml"),
        cell=0.02,
        finer=1.0 / 3.0,
    ),
    "layers": Family("Friction of four layers, deposit", "slope-layers"),
    "velocities": Family("Velocities of ten layers, deposit", "velocity-layers-10"),
    "baffles": Family("Two baffles, toe", "baffles-2"),
    **{
        f"prior-{prior.kind}": Family(
            f"Friction, {prior.kind} prior, front with 10 % noise", "friction-tall-42", noise="10%", priors=(prior,)
        )
        for prior in (
            Prior(kind="normal", mean=30.0, deviation=5.0),
            Prior(kind="lognormal", mean=28.0, deviation=8.0),
            Prior(kind="triangular", mode=25.0),
        )
    },
    "prior-correlated": Family(
        "Friction, normal, and cohesion, lognormal, correlated by -0.5, profile to 2 cm",
        "cohesion-friction",
        noise=0.02,
        priors=(Prior(kind="normal", mean=30.0, deviation=5.0), Prior(kind="lognormal", mean=600.0, deviation=400.0)),
        correlation=-0.5,
    ),
    "front-gns": Family("Friction, front, the surrogate leads", "friction-tall-42", surrogate=Surrogate.GNS),
    "velocities-gns": Family(
        "Velocities of ten layers, the surrogate leads", "velocity-layers-10", surrogate=Surrogate.GNS, twins=20
    ),
    "baffles-gns": Family("Two baffles, the surrogate leads", "baffles-2", surrogate=Surrogate.GNS, twins=20),
    "front-adapted": Family(
        "Friction, front, an adapted surrogate leads",
        "unseen-friction-square-27",
        surrogate=Surrogate.GNS,
        adapted=True,
    ),
}
RUNS_ALONE = Path(__file__).parent / "frozen" / "coverage.md"
"""A posterior without an emulator, which was measured once."""
DEFAULT = ("front", "profile")
"""Families that are solved where none is named."""


@dataclass(frozen=True, kw_only=True)
class Twin(Record):
    """Where the posterior has the truth."""

    seed: int
    denser: float
    """Share of the posterior that is denser than the truth: above 0.95 it is outside of the 95 % region."""
    below: dict[str, float]
    """Share of each number's marginal below the true value."""
    inside: int
    """Numbers whose interval of the answer that holds most of them holds the true value."""
    answers: int
    verdict: str
    runs: int
    seconds: float


def bench(
    out: Path,
    *,
    quick: bool,
    keep: Path,
    twins: int | None = None,
    only: tuple[str, ...] = DEFAULT,
    model: Path | None = None,
    scheduler: str = "",
) -> str:
    """Solve twin experiments with truths from the prior; write OUT/coverage.md and return its conclusion.

    Parameters
    ----------
    quick
        Two twins of the first family.
    twins
        Of each family, in place of 40, or 20 of velocities-gns and baffles-gns.
    only
        Families to solve (front, profile, front-noise, front-fine, profile-fine, cohesion, cohesion-fine, floor,
        floor-fine, outlier, cells, terrain, layers, velocities, baffles; with stated priors: prior-normal,
        prior-lognormal, prior-triangular, prior-correlated; where the surrogate leads: front-gns, velocities-gns,
        baffles-gns, front-adapted); the page has all that there are in `keep`.
    model
        Folder of `python -m inverse.adapt unseen-friction-square-27`, for front-adapted.
    scheduler
        Address of a Dask scheduler, such as tcp://10.0.0.1:8786, or its JSON file, whose workers solve a twin each.
    """
    if unknown := [name for name in only if name not in FAMILIES]:
        raise InputError(f"expected {', '.join(FAMILIES)}, got {unknown[0]}", where="--only")
    if twins is not None and twins < 1:
        raise InputError(f"expected at least one twin, got {twins}", where="--twins")
    asked = {
        keep / name / f"{number:03d}.json": (FAMILIES[name], number, model)
        for name in (only[:1] if quick else only)
        for number in range(2 if quick else twins or FAMILIES[name].twins)
    }
    missing = [path for path in asked if read_twin(path) is None]
    tasks = [asked[path] for path in missing]
    if model is None and any(family.adapted for family, *_ in tasks):
        raise InputError("expected the folder of an adaptation", key="--model")
    with nullcontext() if not scheduler else connected(scheduler) as workers:
        results: Iterator[tuple[int, Twin]] = (
            enumerate(solve_twin(*task) for task in tasks)
            if workers is None
            else workers.finished(solve_twin, [(*task, 1) for task in tasks])
        )
        for index, result in tqdm(results, total=len(tasks), unit="twin", leave=False, disable=None):
            write_json(missing[index], asdict(result))
    stored = {
        family: [twin for path in sorted((keep / name).glob("[0-9]*.json")) if (twin := read_twin(path))]
        for name, family in FAMILIES.items()
    }
    found = {family: some for family, some in stored.items() if some}
    draw(out / "coverage.png", found)
    flags = "" if twins is None else f" --twins {twins}"
    flags += "" if only == DEFAULT else "".join(f" --only {name}" for name in only)
    flags += "" if model is None else " --model RUN"
    return page(found, flags=flags, quick=quick).write(out / "coverage.md")


def read_twin(path: Path) -> Twin | None:
    """The twin at `path`; None where it was not solved yet."""
    return None if (known := read_json(path)) is None else from_mapping(Twin, known)


def solve_twin(family: Family, number: int, model: Path | None = None, threads: int | None = None) -> Twin:
    """Solve the twin of this number; model: of an adaptation; threads: of the MPM, all cores unless given."""
    simulate = simulate_many if threads is None else partial(simulate_many, threads=threads)
    problem = drawn(family, number)
    if family.outlier == 0.0:
        found = solve(problem, simulate=simulate, model=model if family.adapted else None)
    else:
        with tempfile.TemporaryDirectory() as folder:
            target = misread(read_target(problem, lambda scene: simulate([scene])[0]), family.outlier, number)
            found = run(Task(problem=problem, target=target, folder=Path(folder), simulate=simulate))
    return located(found, problem.target.truth, FIRST_SEED + number)


def misread(target: Target, outlier: float, number: int) -> Target:
    """A target with one number, drawn for the twin of this number, off by so many standard deviations of its noise."""
    rng, values = np.random.default_rng([FIRST_SEED, number, 1]), target.values.copy()
    index = int(rng.integers(len(values)))
    values[index] += rng.choice([-1.0, 1.0]) * outlier * target.deviation[index]
    return replace(target, values=values)


def drawn(family: Family, number: int) -> Problem:
    """The twin experiment of this number, with its truth and its jitter seeds."""
    asked, rng = stated(family), np.random.default_rng([FIRST_SEED, number])
    shares = rng.random(len(asked.names))
    truth = asked.named(asked.box.at(shares if asked.prior is None else asked.prior.at(shares)))
    scene = replace(asked.scene, seed=int(rng.integers(2**31)))
    if family.cell is not None:
        scene = scene.with_cell(family.cell)
    finer = None if family.finer is None else family.finer * scene.domain.cell
    return replace(
        asked,
        scene=scene,
        observations=tuple(
            replace(each, noise=each.noise if family.noise is None else family.noise) for each in asked.observations
        ),
        target=TargetSettings(twin=True, seed=FIRST_SEED + number, truth=truth, cell=finer),
        surrogate=family.surrogate,
    )


def stated(family: Family) -> Problem:
    problem = read_problem(family.problem)
    if not family.priors:
        return problem
    both = zip(problem.parameters, family.priors, strict=True)
    pair = (problem.names[0], problem.names[-1])
    return replace(
        problem,
        parameters=tuple(replace(each, prior=prior) for each, prior in both),
        correlations=() if family.correlation is None else (Correlation(between=pair, coefficient=family.correlation),),
    )


def located(result: Result, truth: Mapping[str, float], seed: int) -> Twin:
    found, box = result.posterior, result.problem.box
    assert found is not None, "of numbers"
    where = found.region.sampled
    values = np.array([truth[name] for name in result.problem.names])
    point, samples = box.shares(values), found.samples
    excluded = np.any((point < where.low) | (point > where.high))
    density = -np.inf if excluded else float(found.likelihood(point[None])[0])
    return Twin(
        seed=seed,
        denser=float(samples.weights[samples.log_likelihood > density].sum()),
        below=result.problem.named(samples.weights @ (samples.points < point)),
        inside=max(int(each.holds(values).sum()) for each in result.answers),
        answers=len(result.answers),
        verdict=result.verdict.value,
        runs=len(result.mpm_runs),
        seconds=result.seconds["total"],
    )


def page(found: Mapping[Family, Sequence[Twin]], *, flags: str, quick: bool) -> Page:
    tested = {
        level: [family.title for family, each in found.items() if not low <= held(each, level) <= high]
        for level, (low, high) in WITHIN.items()
    }
    uneven = [family.title for family, each in found.items() if uniformity(each) < SIGNIFICANT]
    every = [each for twins_of_one in found.values() for each in twins_of_one]
    conclusion = [
        f"{len(every)} twin experiments of {len(found)} kinds, truths drawn from the prior.",
        *(
            f"{level:.0%} regions hold {held(every, level):.0%} of the truths; outside of {WITHIN[level][0]:.0%} "
            f"to {WITHIN[level][1]:.0%}: {', '.join(names) or 'none'}."
            for level, names in tested.items()
        ),
        f"Ranks are not uniform (p below {SIGNIFICANT:g}) for {', '.join(uneven) or 'none'}.",
    ]
    bench = f"coverage{flags} --out docs"
    result = Page("Coverage of the posterior", bench, conclusion, packages=MPM | GNS, quick=quick)
    result.picture("coverage.png", "share of the truths that a region holds over the region's share")
    result.text(f"""
        A truth is drawn from the prior, its flow by the MPM with a jitter seed of its own is observed, and the loop
        solves for it. A region of highest density holds the truth where less than its share of the posterior is denser.
        p-values: Kolmogorov-Smirnov of that share, and chi-square of the ranks of all numbers in {BINS} bins.
        Intervals are those of the answer that holds most of the numbers.
    """)
    result.table([row(family, each) for family, each in found.items()])
    result.frozen(RUNS_ALONE)
    return result


def held(found: Sequence[Twin], level: float) -> float:
    """Share of the truths within the region of `level`."""
    return float(np.mean([each.denser <= level for each in found]))


def uniformity(found: Sequence[Twin]) -> float:
    """p-value of the share that is denser than the truth, if it were uniform."""
    return float(kstest([each.denser for each in found], "uniform").pvalue)


def ranks(found: Sequence[Twin]) -> float:
    """Least p-value over the numbers of their ranks, if these were uniform, times how many there are."""
    counts = [
        np.histogram([each.below[name] for each in found], bins=BINS, range=(0.0, 1.0))[0] for name in found[0].below
    ]
    return min(1.0, len(counts) * float(min(chisquare(each).pvalue for each in counts)))


def row(family: Family, found: Sequence[Twin]) -> Row:
    verdicts, count = [each.verdict for each in found], len(found[0].below)
    return {
        "twins of": family.title,
        "problem": f"`{Path(family.problem).stem}`",
        "twins": len(found),
        **{f"in the {level:.0%} region": f"{held(found, level):.0%}" for level in REGIONS},
        "p, regions": f"{uniformity(found):.2g}",
        "p, ranks": f"{ranks(found):.2g}",
        "true values within intervals": f"{sum(each.inside for each in found) / (count * len(found)):.0%}",
        "verdicts": ", ".join(f"{verdicts.count(each)} {each}" for each in dict.fromkeys(verdicts)),
        "MPM runs": f"{np.median([each.runs for each in found]):.0f}",
        "s": f"{np.median([each.seconds for each in found]):.0f}",
    }


def draw(path: Path, found: Mapping[Family, Sequence[Twin]]) -> None:
    """Share of the truths in the region over the region's share: on the diagonal where the posterior is right."""
    levels = np.linspace(0.0, 1.0, 101)
    with figure(path, size=(5.0, 4.0)) as axes:
        axis = axes[0, 0]
        axis.plot(levels, levels, color=GREY, linewidth=0.8)
        for family, twins in found.items():
            axis.plot(levels, [held(twins, level) for level in levels], label=family.title, linewidth=1.2)
        axis.set(xlabel="share of the posterior in the region", ylabel="share of the truths in it")
        axis.legend()
