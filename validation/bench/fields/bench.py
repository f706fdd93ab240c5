"""`python -m validation.bench fields`: unknown fields from profiles, by the MPM's adjoint, in twin experiments.

Each shipped problem with its own truth, whose structure the prior does not know, and again with truths that are drawn
from the prior, for which 95 % of the bands have to hold the true value.
"""

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from datasets.files import write_json
from inverse.fields import pictures
from inverse.fields.inversion import invert
from inverse.fields.problem import FieldProblem, FieldTarget, read_problem
from inverse.fields.result import IDENTIFIED, FieldResult
from inverse.observations.profile import REPRESENTATION
from validation.report.page import Format, Page

PROBLEMS = ("slope-friction", "slide-velocity")
TITLES = {"slope-friction": "Friction of a slope", "slide-velocity": "Velocities of a slide"}
FIRST = 100
"""Seed of the first truth that is drawn."""
QUICK = 0.04
"""Cell [m] with `--quick`."""

Row = dict[str, Any]


def bench(out: Path, *, quick: bool = False, keep: Path, draws: int = 3) -> str:
    """draws: truths from the prior, of each problem."""
    draws = min(draws, 1) if quick else draws
    tasks = [(name, draw) for draw in [None, *range(FIRST, FIRST + draws)] for name in PROBLEMS]
    rows = [row for name, draw in tqdm(tasks, unit="twin") for row in twin(name, draw, keep, out, quick=quick)]
    own = [row for row in rows if row["draw"] is None]
    drawn = [row for row in rows if row["draw"] is not None]
    page = Page(
        "Unknown fields",
        command=f"python -m validation.bench fields --draws {draws}",
        conclusion=[
            *(sentence(name, [row for row in own if row["problem"] == name]) for name in PROBLEMS),
            *held(drawn),
        ],
        quick=quick,
    )
    for name in PROBLEMS:
        here = [row for row in own if row["problem"] == name]
        problem = read_problem(name)
        page.section(TITLES[name])
        page.text(f"""
            `python -m inverse.fields {name} --out out/fields`: {described(problem)}
        """)
        page.table([shown(row) for row in here], formats=FORMATS)
        for row in here:
            page.text(identified(row))
            page.picture(picture(name, row["name"]), f"{name}, {row['name']}: truth, found, width, share removed")
    page.section("Price")
    page.text("""
        One search with everything that belongs to it: scatter over jitter seeds, draws of the prior, Gauss-Newton, the
        check. Seconds of processors are those of all threads: other work on the machine hardly changes them. A reverse
        pass is the gradient of one combination of the observed numbers with respect to all values; central differences
        of one Jacobian would take two runs of every seed for each value.
    """)
    page.table(
        [
            {
                "problem": name,
                "values": sum(row["values"] for row in own if row["problem"] == name),
                "s": first["seconds"],
                "processor s": first["processor_s"],
                "MPM runs": first["runs"],
                "reverse passes": first["reverses"],
                "combinations": first["combinations"],
                "runs of one Jacobian by differences": 2
                * first["seeds"]
                * sum(row["values"] for row in own if row["problem"] == name),
            }
            for name in PROBLEMS
            for first in [next(row for row in own if row["problem"] == name)]
        ],
        formats={"s": ".0f", "processor s": ".0f"},
    )
    page.section("Does it hold?")
    page.text(f"""
        Truths drawn from the prior, {draws} of each problem, each with its own jitter and noise. Values of one field
        depend on each other: a share within the bands is that of a few independent numbers.
    """)
    page.table([{"truth": f"draw {row['draw']}", **shown(row)} for row in drawn], formats=FORMATS)
    return page.write(out / "fields.md")


def percent(fraction: float) -> str:
    """0.213 as 21 %."""
    return f"{100.0 * fraction:.0f} %"


FORMATS: dict[str, Format] = {
    "error of the prior": ".3g",
    "error": ".3g",
    "error, identified": ".3g",
    "error, elsewhere": ".3g",
    "width": ".3g",
    "identified": percent,
    "within 95 %": percent,
    "check": ".2f",
}


def twin(name: str, draw: int | None, keep: Path, out: Path, *, quick: bool) -> list[Row]:
    """A row for each field of a twin experiment, from `keep` where it was made before."""
    path = keep / f"{name}-{'own' if draw is None else draw}.json"
    if path.exists():
        found: list[Row] = json.loads(path.read_text())
        return found
    problem = read_problem(name)
    if draw is not None:
        target = FieldTarget(twin=True, draw=draw, seed=problem.target.seed + draw)
        problem = dataclasses.replace(problem, target=target)
    if quick:
        problem = coarse(problem)
    result = invert(problem)
    if draw is None:
        for each in result.fields:
            pictures.draw_field(out / picture(name, each.unknown.name), each)
    rows = rows_of(result, draw)
    write_json(path, rows)
    return rows


def coarse(problem: FieldProblem) -> FieldProblem:
    """The problem on few cells, with few runs."""
    domain = dataclasses.replace(problem.scene.domain, cell=QUICK)
    size = tuple(QUICK * round(length / QUICK) for length in domain.size)
    scene = dataclasses.replace(problem.scene, domain=dataclasses.replace(domain, size=size), duration=0.2)
    observations = tuple(
        dataclasses.replace(each, times=None if each.times is None else (0.1,)) for each in problem.observations
    )
    search = dataclasses.replace(problem.search, seeds=1, ensemble=4, iterations=1)
    return dataclasses.replace(problem, scene=scene, observations=observations, search=search)


def rows_of(result: FieldResult, draw: int | None) -> list[Row]:
    """What the page tells of each field."""
    found = []
    for each in result.fields:
        numbers, inside = each.as_json(), each.unknown.inside
        found.append(
            {
                "problem": result.problem.name,
                "draw": draw,
                "name": each.unknown.name,
                "unit": each.unknown.unit,
                "values": int(inside.sum()),
                "identified": int(each.identified.sum()),
                "box": each.identified_box(),
                "error": numbers["error"],
                "deviation": numbers["deviation"],
                "covered": float(numbers["truth_in_band"]["all"]),
                "removed": [float(each.removed[inside].min()), float(each.removed[inside].max())],
                "numbers": len(result.target.values),
                "informative": result.posterior.informative,
                "distance": result.distance,
                "tolerance": result.tolerance,
                "verdict": result.verdict.value,
                "promised": result.promised,
                "seconds": result.price.seconds,
                "processor_s": result.price.processor_s,
                "runs": result.price.runs,
                "reverses": result.price.reverses,
                "combinations": result.price.combinations,
                "seeds": result.problem.search.seeds,
            }
        )
    return found


def elsewhere(row: Row, name: str) -> float:
    """Root mean square error at the values that are not identified: `posterior`, or `prior` of the prior's mean."""
    inside = "identified" if name == "posterior" else "prior_identified"
    known, others = row["identified"], row["values"] - row["identified"]
    squares = row["values"] * row["error"][name] ** 2 - known * (row["error"][inside] or 0.0) ** 2
    return math.sqrt(max(squares, 0.0) / others) if others else math.nan


def shown(row: Row) -> Row:
    """A row of a table."""
    return {
        "field": f"{row['name']} [{row['unit']}]",
        "values": row["values"],
        "error of the prior": row["error"]["prior"],
        "error": row["error"]["posterior"],
        "error, identified": row["error"]["identified"],
        "error, elsewhere": elsewhere(row, "posterior"),
        "width": row["deviation"]["posterior"],
        "identified": row["identified"] / row["values"],
        "within 95 %": row["covered"],
        "directions": row["informative"],
        "check": row["distance"],
    }


def sentence(name: str, rows: list[Row]) -> str:
    """Of the conclusion, of one problem with its own truth."""
    parts = []
    for row in rows:
        error, unit = row["error"], row["unit"]
        text = f"{row['name']} is identified at {percent(row['identified'] / row['values'])} of its values"
        if row["identified"]:
            text += f", there off by {error['identified']:.2g} {unit} (prior {error['prior_identified']:.2g})"
        text += f", elsewhere by {elsewhere(row, 'posterior'):.2g} {unit} ({elsewhere(row, 'prior'):.2g})"
        parts.append(f"{text}; {percent(row['covered'])} of the true values lie within 95 %")
    first = rows[0]
    return (
        f"{TITLES[name]}, {sum(row['values'] for row in rows)} values from {first['numbers']} numbers: "
        f"{first['informative']} informative directions, "
        f"{first['processor_s']:.0f} s of processors; {'; '.join(parts)}."
    )


def held(rows: list[Row]) -> list[str]:
    """Of the conclusion, of truths that are drawn."""
    if not rows:
        return []
    weights = np.array([row["values"] for row in rows], float)
    share = float(weights @ [row["covered"] for row in rows] / weights.sum())
    twins = {(row["problem"], row["draw"]): row["verdict"] for row in rows}
    confirmed = sum(verdict == "confirmed" for verdict in twins.values())
    return [
        f"Truths drawn from the prior, {len(twins)} twins: {percent(share)} of the true values within the bands of "
        f"95 %; a run of the found fields with another jitter reproduces the observation in {confirmed} of "
        f"{len(twins)}."
    ]


def identified(row: Row) -> str:
    """Which part of the field the observation tells, in words made of the numbers."""
    error, (low, high) = row["error"], row["removed"]
    text = f"The observation removes {percent(low)} to {percent(high)} of the prior's variance of `{row['name']}`"
    if row["box"] is None:
        return f"{text}: nowhere more than {percent(IDENTIFIED)}. This field is not identified."
    between = ", ".join(
        f"{axis} {low:.2f} to {high:.2f} m" for axis, (low, high) in zip("xyz", row["box"], strict=False)
    )
    text += f"; more than {percent(IDENTIFIED)} at {row['identified']} of {row['values']} values, within {between}."
    before, after = elsewhere(row, "prior"), elsewhere(row, "posterior")
    change = "below" if after < before else "above"
    return (
        f"{text} There the error is {error['identified']:.3g} {row['unit']} ({error['prior_identified']:.3g} of the "
        f"prior's mean); elsewhere it is {after:.3g}, {change} the {before:.3g} of the prior's mean."
    )


def described(problem: FieldProblem) -> str:
    """What is unknown and observed, in a sentence."""
    unknown = " and ".join(
        f"{each.quantity} on {' x '.join(map(str, found.grid.nodes))} nodes, prior "
        f"{each.mean:g} ± {each.deviation:g} {found.unit}, correlation length {each.length} m"
        for each, found in zip(problem.fields, problem.unknowns, strict=True)
    )
    noise, times = (
        problem.observations[0].noise,
        [f"{each.times[0]:g} s" if each.times else "the end" for each in problem.observations],
    )
    return (
        f"{unknown}; observed: profiles at {', '.join(times)}, each height with a noise of {noise} m and of "
        f"{REPRESENTATION:g} cells for what a height at one x misses."
    )


def picture(problem: str, field: str) -> str:
    """File of the picture of a field."""
    return f"fields-{problem}-{field.replace('.', '-')}.png"
