"""`python -m validation.bench coverage`: how often the posterior holds the truth, and whether its ranks are uniform."""

import dataclasses
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from pathlib import Path

import numpy as np
from scipy.stats import chisquare, kstest
from tqdm import tqdm

from datasets.errors import InputError
from datasets.files import write_json
from mpm.cluster import connected
from validation.bench.coverage.twins import FAMILIES, Family, Twin, path_of, read_twin, solve_twin
from validation.report.page import GNS, MPM, Page

REGIONS = (0.5, 0.8, 0.95)
WITHIN = {0.5: (0.4, 0.6), 0.95: (0.9, 0.99)}
"""Shares of truths that a region is to hold."""
BINS = 8
"""Of the ranks, in the test of their uniformity."""
SIGNIFICANT = 0.01
"""p-value below which ranks are not uniform: of so many tests one in twenty would be below 0.05."""


def bench(
    out: Path, *, quick: bool, keep: Path, twins: int = 40, only: tuple[str, ...] = (), scheduler: str = ""
) -> str:
    """Solve twin experiments with truths from the prior; write OUT/coverage.md and return its conclusion.

    Parameters
    ----------
    out
        Folder for coverage.md.
    quick
        Two twins of the first family.
    keep
        Folder of a file for each twin that is solved; those that are there are not solved again.
    twins
        Of each family.
    only
        Families to solve; the page has all that there are.
    scheduler
        Address of a Dask scheduler, such as tcp://10.0.0.1:8786, or its JSON file, whose workers solve a twin each.
    """
    if unknown := [name for name in only if name not in FAMILIES]:
        raise InputError(f"expected {', '.join(FAMILIES)}, got {unknown[0]}", where="--only")
    if twins < 1:
        raise InputError(f"expected at least one twin, got {twins}", where="--twins")
    requested = list(FAMILIES)[:1] if quick else only or FAMILIES
    asked = [(name, number) for name in requested for number in range(2 if quick else twins)]
    missing = [(name, number) for name, number in asked if read_twin(path_of(number, keep / name)) is None]
    tasks = [(FAMILIES[name], number) for name, number in missing]
    with nullcontext() if not scheduler else connected(scheduler) as cluster:
        results: Iterator[tuple[int, Twin]] = (
            enumerate(solve_twin(*task) for task in tasks)
            if cluster is None
            else cluster.finished(solve_twin, [(*task, 1) for task in tasks])
        )
        for index, result in tqdm(results, total=len(tasks), unit="twin", leave=False, disable=None):
            name, number = missing[index]
            write_json(path_of(number, keep / name), dataclasses.asdict(result))
    found = {
        name: [each for path in sorted((keep / name).glob("[0-9]*.json")) if (each := read_twin(path)) is not None]
        for name in FAMILIES
    }
    return page({FAMILIES[name]: each for name, each in found.items() if each}, twins, quick=quick).write(
        out / "coverage.md"
    )


def page(found: dict[Family, Sequence[Twin]], twins: int, *, quick: bool) -> Page:
    """The table and its conclusion."""
    rows = [row(family, each) for family, each in found.items()]
    tested = {
        level: [family.title for family, each in found.items() if not low <= held(each, level) <= high]
        for level, (low, high) in WITHIN.items()
    }
    uneven = [family.title for family, each in found.items() if uniformity(each) < SIGNIFICANT]
    every = [each for twins_of_one in found.values() for each in twins_of_one]
    result = Page(
        "Coverage of the posterior",
        command=f"python -m validation.bench coverage{'' if twins == 40 else f' --twins {twins}'}",
        conclusion=[
            f"{len(every)} twin experiments of {len(found)} kinds, truths drawn from the prior.",
            *(
                f"{100 * level:g} % regions hold {share(held(every, level))} of "
                f"the truths; outside of {100 * WITHIN[level][0]:g} to {100 * WITHIN[level][1]:g} %: "
                f"{', '.join(names) or 'none'}."
                for level, names in tested.items()
            ),
            f"Ranks are not uniform (p below {SIGNIFICANT:g}) for {', '.join(uneven) or 'none'}.",
        ],
        packages=MPM | GNS,
        quick=quick,
    )
    result.text(
        "A truth is drawn from the prior, its flow by the MPM with a jitter seed of its own is observed, and the loop "
        "solves for it (`validation/bench/coverage/twins.py`). A region of highest density holds the truth where less "
        "than its share of the posterior is denser. p-values: Kolmogorov-Smirnov of that share, and chi-square of the "
        f"ranks of all parameters in {BINS} bins. Half-widths are those of the answer nearest to the truth."
    )
    result.table(rows)
    return result


def held(found: Sequence[Twin], level: float) -> float:
    """Share of the truths within the region of `level`."""
    return float(np.mean([each.denser <= level for each in found]))


def uniformity(found: Sequence[Twin]) -> float:
    """p-value of the share that is denser than the truth, if it were uniform."""
    return float(kstest([each.denser for each in found], "uniform").pvalue)


def ranks(found: Sequence[Twin]) -> float:
    """Least p-value over the parameters of their ranks, if these were uniform, times the number of parameters."""
    names = list(found[0].below)
    values = [
        chisquare(np.histogram([each.below[name] for each in found], bins=BINS, range=(0.0, 1.0))[0]).pvalue
        for name in names
    ]
    return min(1.0, len(names) * float(min(values)))


def share(value: float) -> str:
    """0.95 as 95 %."""
    return f"{100.0 * value:.0f} %"


def row(family: Family, found: Sequence[Twin]) -> dict[str, object]:
    """A line of the table."""
    verdicts = [each.verdict for each in found]
    count = len(found[0].below)
    return {
        "twins of": family.title,
        "problem": f"`{family.problem}`",
        "twins": str(len(found)),
        **{f"in the {100 * level:g} % region": share(held(found, level)) for level in REGIONS},
        "p, regions": f"{uniformity(found):.2g}",
        "p, ranks": f"{ranks(found):.2g}",
        "true values within half-widths": share(sum(each.inside for each in found) / (count * len(found))),
        "verdicts": ", ".join(f"{verdicts.count(each)} {each}" for each in dict.fromkeys(verdicts)),
        "MPM runs": f"{np.median([each.runs for each in found]):.0f}",
    }
