"""The section about columns: errors by angle and by aspect ratio, beside the bars and the MPM's own scatter."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from inverse.report.markdown import table
from validation.bench.accuracy.page import paragraph
from validation.bench.columns.paper import read_paper
from validation.bench.surrogate.courses import Comparison
from validation.bench.surrogate.figures import bold, holds, mean, off, per_cent, rms, worst
from validation.bench.surrogate.held_out import by_way
from validation.bench.surrogate.scenes import TRAINED, Column, paper_columns

BARS = {True: 0.03, False: 0.06}
"""Front error [-] inside and outside the training range of angles."""
ENERGY_BAR = 0.05
PAPER_SURROGATE = {"short-21": 0.7154, "short-42": 0.6067, "tall-21": 0.8783, "tall-42": 0.5942}
"""Largest x [m] of the paper's surrogate (its table of friction problems)."""
Found = Mapping[Column, Sequence[Comparison]]


def text(found: Found, seeds: int) -> list[str]:
    """The section."""
    walls = [column.name for column, (each, *_) in found.items() if each.at_wall]
    held = (
        f"""The far wall holds the furthest points of {len(walls)} of these flows (height / length, angle:
        {"; ".join(walls)}), whose front errors are small for that reason."""
        if walls
        else ""
    )
    return [
        "## Columns in 2D",
        "",
        *paragraph(f"""
            Columns of 0.08 m² at the left wall, of {aspects(found)} times their length in height, at angles of friction
            of {angles(found)} degrees; all else as in the paper's four, which are among them. The heaps of the
            training data that lean on a wall keep a distance from them (`datasets/definitions/releases2d.py`), and their angles are
            {TRAINED[0]:g} to {TRAINED[1]:g}°. **Front error**: the x
            that 99.5 % of the surrogate's points are behind, less that of all the MPM's points ("all points") or of
            those that the surrogate has, too ("same points"), over it. Scatter: standard deviation of the MPM's front
            over {seeds} jitter seeds, over the front. Mean and worst are of absolute values, the latter with its sign.
            The bar is {100 * BARS[True]:g} % inside the training range and {100 * BARS[False]:g} % outside; what is
            beyond it is bold. {held}
        """),
        "![front error over the angle of friction](gns-front.png)",
        "",
        *summary(found),
        *verdict(found),
        *others(found),
        *papers(found),
        "### By angle",
        "",
        *grouped(found, "angle", lambda column: f"{column.friction_deg:g}°"),
        "### By aspect ratio, angles of the training range",
        "",
        *grouped(inside(found, True), "height / length", lambda column: f"{column.aspect:g}"),
    ]


def aspects(found: Found) -> str:
    """The aspect ratios."""
    return ", ".join(dict.fromkeys(f"{each.aspect:g}" for each in found))


def angles(found: Found) -> str:
    """The angles of friction."""
    return ", ".join(dict.fromkeys(f"{each.friction_deg:g}" for each in found))


def inside(found: Found, trained: bool) -> Found:
    """Those of angles in the training range, or those outside it."""
    return {column: each for column, each in found.items() if column.trained is trained}


def joined(found: Found) -> list[Comparison]:
    """All comparisons."""
    return [each for group in found.values() for each in group]


def summary(found: Found) -> list[str]:
    """Front errors over all scenes of a range."""
    rows = []
    for trained, bar in BARS.items():
        for (model, start), group in by_way(joined(inside(found, trained))).items():
            whole = [each.front_error for each in group]
            thinned = [each.thinned_front_error for each in group]
            within = sum(abs(error) <= bar for error in whole)
            rows.append(
                [
                    f"`{model}`",
                    start,
                    "inside" if trained else "outside",
                    *(per_cent(measure(whole), bar) for measure in (mean, rms)),
                    off(worst(whole), bar),
                    f"{within} of {len(group)}",
                    *(per_cent(measure(thinned), bar) for measure in (mean, rms)),
                    off(worst(thinned), bar),
                    per_cent(float(np.mean([each.scatter for each in group]))),
                ]
            )
    head = ["model", "start", "angles", "all points: mean", "rms", "worst", "within the bar"]
    return [*table([*head, "same points: mean", "rms", "worst", "MPM's scatter"], rows), ""]


def verdict(found: Found) -> list[str]:
    """Which bars hold, in words."""
    lines = []
    for trained, bar in BARS.items():
        for (model, start), group in by_way(joined(inside(found, trained))).items():
            errors = [each.front_error for each in group]
            where = "inside" if trained else "outside"
            verdicts = [
                f"{name} {holds(abs(measure(errors)), bar)}"
                for name, measure in (("mean", mean), ("rms", rms), ("worst", worst))
            ]
            lines.append(f"- `{model}` {start}, {where} ({100 * bar:g} %): {', '.join(verdicts)}.")
    return [*lines, ""]


def others(found: Found) -> list[str]:
    """Everything but the front, mean and worst."""
    rows = []
    for trained in BARS:
        for (model, start), group in by_way(joined(inside(found, trained))).items():
            rmse = 1000.0 * np.mean([each.rmse for each in group], axis=0)
            rows.append(
                [
                    f"`{model}`",
                    start,
                    "inside" if trained else "outside",
                    both([each.runout_error for each in group]),
                    both([each.profile_error for each in group]),
                    *(f"{each:.1f}" for each in rmse),
                    both([each.kinetic_error for each in group], ENERGY_BAR),
                    both([each.potential_error for each in group], ENERGY_BAR),
                ]
            )
    head = ["model", "start", "angles", "runout", "profile", "points at 1/4 [mm]", "1/2", "end"]
    return [
        *paragraph(f"""
            Mean and, in brackets, worst of: the error of the **runout** (largest x, all points), of the **profile**
            (area between the two deposits' height profiles over that under the MPM's), the root mean square distance of
            the points, and of the **energy curves**: the largest difference over time over the energy at the start
            (potential above the floor, and kinetic); bar {100 * ENERGY_BAR:g} %. Velocities are means over a step.
        """),
        *table([*head, "kinetic energy", "potential energy"], rows),
        "",
    ]


def both(errors: Sequence[float], bar: float = float("inf")) -> str:
    """Mean and worst."""
    return f"{per_cent(mean(errors), bar)} ({per_cent(abs(worst(errors)), bar)})"


def papers(found: Found) -> list[str]:
    """The paper's four columns, by the largest x as there and by the front."""
    stated = {scenario.name: scenario.runout for scenario in read_paper().scenarios}
    rows, ways = [], list(by_way(joined(found)))
    for name, column in paper_columns().items():
        if column not in found:
            continue
        cells = [f"{off(each.runout_error)}, {off(each.front_error)}" for each in found[column]]
        rows.append([name, off(PAPER_SURROGATE[name] / stated[name] - 1.0), *cells])
    if not rows:
        return []
    return [
        "### The paper's four",
        "",
        "Runout (largest x, the paper's measure; one point's fate) and front, all points.",
        "",
        *table(["column", "the paper's surrogate: runout", *(f"`{model}` {start}" for model, start in ways)], rows),
        "",
        "![height profiles of the paper's columns](gns-profiles.png)",
        "",
    ]


def grouped(found: Found, title: str, label: Callable[[Column], str]) -> list[str]:
    """Front errors, all points, of the columns that have the same label."""
    rows, ways = [], list(by_way(joined(found)))
    for group_label in dict.fromkeys(map(label, found)):
        some = {column: each for column, each in found.items() if label(column) == group_label}
        bar = max(BARS[column.trained] for column in some)
        cells = []
        for group in by_way(joined(some)).values():
            errors = [each.front_error for each in group]
            cells.append(f"{per_cent(mean(errors), bar)} ({off(worst(errors), bar)})")
        rows.append([group_label, *cells, per_cent(float(np.mean([each.scatter for each in joined(some)])))])
    head = [title, *(f"`{model}` {start}: mean (worst)" for model, start in ways), "MPM's scatter"]
    return [*table(head, rows), ""]


def everything(found: Found) -> list[str]:
    """A line per rollout."""
    lines = ["## Every column", ""]
    for model, start in by_way(joined(found)):
        rows = []
        for column, group in found.items():
            each = next(each for each in group if (each.model, each.start) == (model, start))
            bar = BARS[column.trained]
            rows.append(
                [
                    column.name,
                    f"{each.front:.4f} ({per_cent(each.scatter)})",
                    off(each.front_error, bar),
                    off(each.thinned_front_error, bar),
                    off(each.runout_error),
                    per_cent(each.profile_error),
                    " / ".join(f"{1000.0 * moment:.0f}" for moment in each.rmse),
                    per_cent(each.kinetic_error, ENERGY_BAR),
                    per_cent(each.potential_error, ENERGY_BAR),
                ]
            )
        head = ["height / length, angle", "MPM's front [m] (scatter)", "front, all points", "same points", "runout"]
        tail = ["profile", "points at 1/4, 1/2, end [mm]", "kinetic energy", "potential energy"]
        lines += [bold(f"`{model}` {start}", True), "", *table([*head, *tail], rows), ""]
    return lines
