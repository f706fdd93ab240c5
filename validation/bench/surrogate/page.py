"""`gns.md`: sections and tables, and the conclusion made of them."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from datasets.measures import UPSTREAM
from gns.initial import Start
from validation.bench.columns.paper import read_paper
from validation.bench.surrogate.comparison import Comparison, by_variant
from validation.bench.surrogate.long_rollouts import CREEP, MOTION, LongRollout
from validation.bench.surrogate.rollouts import ShippedModel
from validation.bench.surrogate.scenes import ANGLES, AREA, ASPECTS, TRAINED, HeldOutColumn, paper_columns
from validation.bench.surrogate.speed import MpmRun, WholeSecond
from validation.bench.surrogate.speed_page import speed_said, speed_section
from validation.report.machine import GNS, MPM
from validation.report.page import Page, Row, signed

COLUMN_CRITERIA = {True: 0.03, False: 0.06}
"""Front error [-] inside and outside the training range of angles."""
ENERGY_CRITERION = 0.05
BAFFLES_CRITERION = 0.03
"""Of runout and front [-]."""
PAPER_RUNOUT = {"short-21": 0.7154, "short-42": 0.6067, "tall-21": 0.8783, "tall-42": 0.5942}
"""Largest x [m] of the paper's surrogate (its table of friction problems)."""
PAPER_BAFFLES = {"baffles-5": 0.0087}
"""Runout error [-] of the paper's surrogate (its appendix)."""
PAPER_MSE = {"surrogate": 3.41e-4, "mpm": 8.70e-4}
"""The paper's losses [m^2] at the velocities that it found: its surrogate's, and its MPM's run again with them."""
Columns = Mapping[HeldOutColumn, Sequence[Comparison]]
Scenes = Mapping[str, Sequence[Comparison]]
COMMAND = "python -m validation.bench surrogate"


@dataclass(frozen=True, kw_only=True)
class Measured:
    """All that is on the page."""

    models: Sequence[ShippedModel]
    seeds: int
    columns: Columns
    layers: Scenes
    baffles: Scenes
    long: Sequence[LongRollout]
    seconds: Sequence[WholeSecond]
    runs: Sequence[MpmRun]


def page(found: Measured, *, quick: bool) -> Page:
    """The page; sections without measurements are left out."""
    text = Page(
        "The surrogate beside the MPM", command=COMMAND, conclusion=conclusion(found), packages=GNS | MPM, quick=quick
    )
    text.text("""
        The models on scenes that are in no training set, against the MPM that made the training sets. A rollout begins
        **from rest**, with positions and velocities alone, or **from first frames**, with the MPM's first 0.05 s. What
        exceeds its criterion is bold.
    """)
    models_section(text, found.models)
    if found.columns:
        columns_section(text, found.columns, found.seeds)
    if found.layers:
        layers_section(text, found.layers)
    if found.baffles:
        baffles_section(text, found.baffles)
    if found.long:
        long_section(text, found.long)
    speed_section(text, found.seconds, found.runs)
    return text


def conclusion(found: Measured) -> list[str]:
    """At most five sentences."""
    sentences: list[str] = []
    for name, group in by_variant(joined(found.columns.values())).items():
        if name[1] is Start.FROM_REST and len(sentences) < 2:
            sentences.append(columns_said(name[0], group))
    if found.baffles:
        fronts = [
            f"{signed(each.front_error)} ({scene})"
            for scene, group in found.baffles.items()
            for each in group
            if each.start is Start.FROM_REST
        ]
        sentences.append(f"Front error against baffles in 3D: {', '.join(fronts)}.")
    if found.long:
        bounded = sum(each.bounded for each in found.long)
        creep = max((each.creep[0] for each in found.long), key=abs)
        sentences.append(
            f"{bounded} of {len(found.long)} long rollouts are bounded; their fronts creep by up to {creep:+.2g} mm/s."
        )
    if found.seconds:
        ratios = [
            f"{each.cost.forward.median / each.mpm.median:.1f} times the MPM's seconds, its gradient"
            f" {each.cost.gradient.median / each.mpm.median:.1f} times (`{each.cost.name}`)"
            for each in found.seconds
        ]
        sentences.append(f"On the cells of its data a rollout takes {'; '.join(ratios)}.")
    elif found.runs:
        sentences.append(" ".join(speed_said(found.runs)[:1]))
    return sentences


def columns_said(model: str, group: Sequence[Comparison]) -> str:
    """How many columns meet their criterion, and the mean and worst error inside the training range."""
    within = sum(abs(each.front_error) <= criterion(each) for each in group)
    errors = [each.front_error for each in group if criterion(each) == COLUMN_CRITERIA[True]]
    return (
        f"`{model}` from rest: front error of held-out columns at trained angles {mean(errors):.1%} on average, worst"
        f" {signed(worst(errors))}; {within} of {len(group)} at all angles meet their criterion."
    )


def criterion(each: Comparison) -> float:
    """Of the front error of a column."""
    return COLUMN_CRITERIA[TRAINED[0] <= each.scene.material.friction_deg <= TRAINED[1]]


def joined(groups: Iterable[Sequence[Comparison]]) -> list[Comparison]:
    """All comparisons."""
    return [each for group in groups for each in group]


def mean(errors: Sequence[float]) -> float:
    """Mean of the absolute values."""
    return float(np.mean(np.abs(errors)))


def worst(errors: Sequence[float]) -> float:
    """The error of the largest amount, with its sign."""
    return max(errors, key=abs)


def bold(text: str, whether: bool) -> str:
    """In Markdown."""
    return f"**{text}**" if whether else text


def percent(fraction: float, limit: float = inf) -> str:
    """0.0213 as 2.1 %, bold beyond `limit`; nan as -."""
    return "-" if np.isnan(fraction) else bold(f"{100.0 * fraction:.1f} %", abs(fraction) > limit)


def both(errors: Sequence[float], limit: float = inf) -> str:
    """Mean, and in brackets the worst; of a single one its value with its sign."""
    extreme = bold(signed(worst(errors)), abs(worst(errors)) > limit)
    return f"{percent(mean(errors), limit)} ({extreme})" if len(errors) > 1 else extreme


def metrics(group: Sequence[Comparison], limit: float) -> dict[str, str]:
    """All errors of one comparison, or mean and worst of those of a model from one start."""
    moments = np.mean([each.rmse for each in group], axis=0)
    return {
        "model": f"`{group[0].model}`",
        "start": group[0].start.value,
        "front": both([each.front_error for each in group], limit),
        "front, same particles": both([each.same_front_error for each in group], limit),
        "runout": both([each.runout_error for each in group]),
        "MPM's scatter": percent(float(np.mean([each.scatter for each in group]))),
        "profile": both([each.profile_error for each in group]),
        "particles at 1/4, 1/2, end [mm]": " / ".join(f"{1000.0 * moment:.1f}" for moment in moments),
        "kinetic energy": both([each.kinetic_error for each in group], ENERGY_CRITERION),
        "potential energy": both([each.potential_error for each in group], ENERGY_CRITERION),
    }


METRICS = f"""
    **Front**: the x that 99.5 % of the particles are behind, against all the MPM's particles or the same as the
    surrogate's; **runout**: the largest x; **scatter**: standard deviation of the MPM's front over jitter seeds;
    **profile**: area between the deposits' height profiles over that under the MPM's; root mean square distance of the
    **particles**; **energy**: largest difference over time over all energy at the start, criterion
    {100 * ENERGY_CRITERION:g} % (velocities are means over a step). All are relative to the MPM's value.
"""


def models_section(text: Page, models: Sequence[ShippedModel]) -> None:
    """Sizes, resolution and training of the models, a column each."""
    facts: dict[str, Callable[[ShippedModel], str]] = {
        "dimension": lambda each: f"{each.settings.dimension}D",
        "parameters": lambda each: f"{sum(weight.numel() for weight in each.simulator.parameters()):,}",
        "file": lambda each: f"{each.path.stat().st_size / 1e6:.2f} MB",
        "cell": lambda each: f"{1000 * each.settings.cell:g} mm",
        "nodes per cell": lambda each: str(each.settings.particles_per_cell),
        "step": lambda each: f"{1000 * each.settings.step:g} ms",
        "radius": lambda each: f"{1000 * each.settings.radius:g} mm",
        "width x layers": lambda each: f"{each.settings.width} x {each.settings.layers}",
        "past displacements": lambda each: str(each.settings.history),
        "updates": lambda each: f"{each.updates:,}" if each.updates else "-",
        "data": lambda each: ", ".join(str(name) for name in each.provenance.get("datasets", ())) or "-",
        "seed": lambda each: str(each.provenance.get("seed", "-")),
    }
    text.section("The models")
    text.table([{"": name} | {f"`{each.name}`": fact(each) for each in models} for name, fact in facts.items()])
    text.text("Their cards, with the commands that made them, are beside their weights in `gns/weights`.")


def columns_section(text: Page, found: Columns, seeds: int) -> None:
    """Errors over columns, by range, by angle and by aspect ratio."""
    walls = [f"{each.aspect:g}, {each.friction_deg:g}°" for each, (first, *_) in found.items() if first.at_wall]
    text.section("Columns in 2D")
    text.text(f"""
        Columns of {AREA:g} m² at the left wall, {listed(ASPECTS)} times as high as long, at angles of friction of
        {listed(ANGLES)}°; the paper's four are among them. The training data keep a distance from them
        (`datasets/definitions/held_out.py`) and have angles of {TRAINED[0]:g} to {TRAINED[1]:g}°. Criterion of the
        front: {100 * COLUMN_CRITERIA[True]:g} % inside that range, {100 * COLUMN_CRITERIA[False]:g} % outside. {seeds}
        jitter seeds. Mean and, in brackets, worst.
    """)
    text.text(METRICS)
    if walls:
        text.text(f"At the far wall, which bounds the front (height / length, angle): {'; '.join(walls)}.")
    text.picture("gns-front.png", "front error over the angle of friction")
    text.table(
        [
            summary(group, trained)
            for trained in COLUMN_CRITERIA
            for group in by_variant(
                joined(group for column, group in found.items() if column.trained is trained)
            ).values()
        ]
    )
    papers = {name: found[column] for name, column in paper_columns().items() if column in found}
    if papers:
        text.section("The paper's four", level=3)
        text.text("Runout (the paper's measure) and front, all particles.")
        text.table([paper_row(name, group) for name, group in papers.items()])
        text.picture("gns-profiles.png", "height profiles of the paper's columns")
    text.section("By angle", level=3)
    text.table(front_rows(found, "angle", lambda column: f"{column.friction_deg:g}°"))
    trained_ones = {column: group for column, group in found.items() if column.trained}
    text.section("By aspect ratio, angles of the training range", level=3)
    text.table(front_rows(trained_ones, "height / length", lambda column: f"{column.aspect:g}"))


def listed(values: Iterable[float]) -> str:
    """Numbers with commas."""
    return ", ".join(f"{value:g}" for value in values)


def summary(group: Sequence[Comparison], trained: bool) -> Row:
    """Errors of one model from one start over the columns of a range."""
    limit = COLUMN_CRITERIA[trained]
    within = sum(abs(each.front_error) <= limit for each in group)
    return {"angles": "trained" if trained else "outside", "within": f"{within} of {len(group)}"} | metrics(
        group, limit
    )


def paper_row(name: str, group: Sequence[Comparison]) -> Row:
    """One of the paper's columns."""
    stated = {scenario.name: scenario.runout for scenario in read_paper().scenarios}
    return {"column": name, "the paper's surrogate: runout": signed(PAPER_RUNOUT[name] / stated[name] - 1.0)} | {
        f"`{each.model}`, {each.start}": f"{signed(each.runout_error)}, {signed(each.front_error)}" for each in group
    }


def front_rows(found: Columns, title: str, label: Callable[[HeldOutColumn], str]) -> list[Row]:
    """Front errors, all particles, of the columns that have the same label."""
    rows: list[Row] = []
    for name in dict.fromkeys(map(label, found)):
        some = {column: group for column, group in found.items() if label(column) == name}
        limit = max(COLUMN_CRITERIA[column.trained] for column in some)
        comparisons = joined(some.values())
        cells = {
            f"`{model}`, {start}": both([each.front_error for each in group], limit)
            for (model, start), group in by_variant(comparisons).items()
        }
        scatter = percent(float(np.mean([each.scatter for each in comparisons])))
        rows.append({title: name, **cells, "MPM's scatter": scatter})
    return rows


def layers_section(text: Page, found: Scenes) -> None:
    """Layers of different velocities."""
    text.section("Layers of different velocities")
    text.text(f"""
        `layers-10`, ten layers of 28 mm, 30°, with the paper's velocities (1.5 m/s at the floor to 0.15 m/s at the
        top), with the same from the top down, and with others drawn from 0 to 1.5 m/s. The MSE is that of the deposit's
        particles from the MPM's at the velocities given; the paper's surrogate has {1e4 * PAPER_MSE["surrogate"]:.2f},
        its MPM {1e4 * PAPER_MSE["mpm"]:.2f}, at the velocities that its inversion found. "MPM's own": between deposits
        of the MPM that differ in the jitter.
    """)
    text.table(
        [
            {
                "velocities, lowest layer first": name,
                "MSE [1e-4 m²]": f"{1e4 * each.mse:.2f}",
                "MPM's own": f"{1e4 * each.mpm_mse:.2f}",
                **metrics([each], COLUMN_CRITERIA[True]),
            }
            for name, group in found.items()
            for each in group
        ]
    )
    text.picture("gns-energy.png", "energy over time")


def baffles_section(text: Page, found: Scenes) -> None:
    """Flows against baffles in 3D."""
    wall = [name for name, (each, *_) in found.items() if each.at_wall]
    text.section("Baffles in 3D")
    text.text(f"""
        The paper's two scenes, in boxes that the training data do not have; criterion of front and runout
        {100 * BAFFLES_CRITERION:g} %. {f"In {', '.join(wall)} the far wall bounds the runout." if wall else ""}
        Upstream depth: mean over strips {UPSTREAM:g} m long before each baffle of the first row; its error is the mean
        over time (in brackets the largest) over the MPM's greatest depth. The profile is summed over z.
    """)
    text.table(
        [
            {
                "scene": f"`{name}`",
                "the paper's runout": percent(PAPER_BAFFLES.get(name, float("nan"))),
                "upstream depth": f"{percent(each.depth_errors[0])} ({percent(each.depth_errors[1])})",
                **metrics([each], BAFFLES_CRITERION),
            }
            for name, group in found.items()
            for each in group
        ]
    )
    text.picture("gns-baffles.png", "deposits from above")
    text.picture("gns-baffles-time.png", "front, upstream depth and energy over time")


def long_section(text: Page, found: Sequence[LongRollout]) -> None:
    """Long rollouts."""
    text.section("Long rollouts")
    text.text(f"""
        From rest, with the MPM beside. Bounded: all numbers finite, in every frame no particle outside the box or
        inside a baffle (beyond rounding), motion left (kinetic energy over the last tenth of the time over its
        greatest) at most {MOTION:g}, and in the second half of the time the front creeps by at most {CREEP:g} mm/s.
    """)
    text.table(
        [
            {
                "scene": f"`{each.scene}`, {each.duration:g} s",
                "model": f"`{each.model}`",
                "verdict": bold("bounded" if each.bounded else "not bounded", not each.bounded),
                "outside the box [cells]": each.outside,
                "inside a baffle [cells]": each.inside,
                "motion left (MPM)": f"{bold(f'{each.motion[0]:.1e}', each.motion[0] > MOTION)} ({each.motion[1]:.1e})",
                "creep of the front [mm/s] (MPM)": f"{bold(f'{each.creep[0]:+.2f}', abs(each.creep[0]) > CREEP)}"
                f" ({each.creep[1]:+.2f})",
                "front [m] (MPM; error)": f"{each.front[0]:.4f} ({each.front[1]:.4f};"
                f" {signed(each.front[0] / each.front[1] - 1.0)})",
            }
            for each in found
        ],
        formats={"outside the box [cells]": ".1e", "inside a baffle [cells]": ".1e"},
    )
