"""`efficiency.md`: every table with the command and the machine that made it, every sentence from its numbers."""

from collections.abc import Sequence

from inverse.report.markdown import table
from validation.bench.accuracy.page import paragraph
from validation.bench.columns.paper import Paper
from validation.bench.efficiency.crossing import leaders, points_said, race_said, unknowns_said
from validation.bench.efficiency.kept import Parts
from validation.bench.efficiency.rows import Made, OverPoints, OverUnknowns, Race, Row

TIMES = (1.0, 3.0, 10.0, 30.0, 100.0)
"""When it is asked who leads [s]."""
UNKNOWNS_PICTURE, POINTS_PICTURE = "pictures/efficiency-unknowns.png", "pictures/efficiency-points.png"


def race_picture(problem: str) -> str:
    """The picture of a problem, beside the page."""
    return f"pictures/efficiency-{problem}.png"


def page(parts: Parts, paper: Paper) -> str:
    """The whole page, of the parts that there are."""
    lines = ["# What a gradient costs, and what it is worth", "", *conclusion(parts)]
    for race in parts.races.values():
        lines += race_lines(race, paper)
    if parts.unknowns is not None:
        lines += unknowns_lines(parts.unknowns)
    if parts.points is not None:
        lines += points_lines(parts.points)
    return "\n".join(lines).rstrip() + "\n"


def conclusion(parts: Parts) -> list[str]:
    """Where each method wins: sentences made of the numbers below."""
    lines = ["## Where each method wins", ""]
    if parts.unknowns is not None:
        lines += paragraph(" ".join(["**Unknowns.**", *unknowns_said(parts.unknowns.gradients)]))
    if parts.points is not None:
        lines += paragraph(" ".join(["**Points.**", *points_said(parts.points.costs)]))
    for race in parts.races.values():
        problem, *rest = " ".join(race_said(race)).split(": ", 1)
        lines += paragraph(f"**{problem}.** {' '.join(rest)}")
    return lines


def made_line(made: Made) -> list[str]:
    """How a table was made."""
    trial = " **A trial of the program (`--quick`): these figures say nothing.**" if made.quick else ""
    return paragraph(f"`{made.command}`, {made.date}, on {made.machine}.{trial}")


def race_lines(race: Race, paper: Paper) -> list[str]:
    """One problem: table, picture, who leads when."""
    several = any(row.ended == "out of time" and row.allowed > row.iterations for row in race.rows)
    lines = [
        f"## {race.problem}",
        "",
        *made_line(race.made),
        *paragraph(f"""
            Start: {race.start}. Stop: {race.rule}, or after {race.limit:g} s, within which the next iteration must end.
            The bounds of a method by differences are a step nearer, so that no difference leaves them. A surrogate's
            seconds include its start. The loss is that of an MPM run at the answer, whose jitter neither target nor
            search used; it is not among the MPM runs. A search by Optuna is one draw of its random numbers.
            {floor_said(race)}
        """),
        *table(HEAD, [race_row(row) for row in race.rows]),
        "",
    ]
    if several:
        lines += paragraph("""
            "≈" is extrapolated: seconds per iteration times the iterations that the problem allows, where the search
            ran out of time before.
        """)
    if any(row.paper is not None for row in race.rows):
        lines += paragraph(f"""
            The paper's seconds: AD on one GPU, the MPM on 56 cores. Its angle by differences with its GNS:
            {paper.fd_gns_phi_estimated:.2f} deg.
        """)
    lines += [f"![loss over seconds]({race_picture(race.problem)})", ""]
    rows = [
        [f"{time:g} s", *(("-", "-") if leader is None else (leader[0], f"{leader[1]:.1e}"))]
        for time, leader in leaders(race, TIMES).items()
        if time <= max(row.seconds for row in race.rows) or time == TIMES[0]
    ]
    return [*lines, *table(["after", "best answer by", "its loss in the MPM"], rows), ""]


HEAD = [
    "method",
    "optimiser",
    "seconds per iteration",
    "forward, backward",
    "the paper's",
    "iterations",
    "ended",
    "all iterations",
    "MPM runs",
    "seconds",
    "rms error of the unknowns",
    "loss in the MPM",
]


def race_row(row: Row) -> list[str]:
    """One method as a line."""
    # A search without gradients has no iterations of its own to count.
    cut = row.ended == "out of time" and row.backward > 0.0
    return [
        row.method,
        row.optimiser,
        f"{row.per_iteration:.2f}",
        f"{row.forward:.2f}, {row.backward:.2f}" if row.backward else f"{row.forward:.2f}, -",
        "-" if row.paper is None else f"{row.paper:g}",
        str(row.iterations),
        row.ended,
        f"≈ {row.per_iteration * row.allowed:.0f} s for {row.allowed}" if cut else "-",
        str(row.mpm_runs),
        f"{row.seconds:.1f}",
        ", ".join(f"{value:.3g} {unit}" for unit, value in row.error.items()) or "-",
        f"{row.loss:.1e}",
    ]


def floor_said(race: Race) -> str:
    """What the truth shows."""
    return "" if race.floor is None else f"At the truth such a run shows {race.floor:.1e}: the MPM's own scatter."


def unknowns_lines(over: OverUnknowns) -> list[str]:
    """The cuts of one heap."""
    steps = ", ".join(f"{step:g} m/s at {number}" for number, step in over.steps.items())
    rows = []
    for each in over.gradients:
        rows.append(
            [
                str(each.unknowns),
                each.method,
                f"{'≈ ' if each.multiplied else ''}{each.seconds:.2f}",
                f"{each.columns} of {each.unknowns}" if each.multiplied else "all",
                "-" if each.cosine is None else f"{each.cosine:.4f}",
                "-" if each.error is None else f"{100.0 * each.error:.1f} %",
            ]
        )
    return [
        "## Over the unknowns",
        "",
        *made_line(over.made),
        *paragraph(f"""
            The paper's heap of 0.35 x 0.28 m, {over.points:,} points, cut into 1, 2 and 10 layers and 10 x 10 blocks,
            between its points; the velocity of each along x is unknown. True ones fall from 1.5 m/s at the floor to
            0.15 at the top; the gradient of the deposit's loss is taken at half of them. Step of the differences:
            {steps} unknowns. "≈": the differences of some unknowns were run and their seconds multiplied; there, cosine
            and distance from the MPM's differences are over those unknowns. The last row of each tells how well the MPM
            itself knows its gradient.
        """),
        *table(["unknowns", "method", "seconds", "differences run", "cosine", "off by"], rows),
        "",
        f"![seconds over unknowns]({UNKNOWNS_PICTURE})",
        "",
    ]


def points_lines(over: OverPoints) -> list[str]:
    """The sizes of one column."""
    rows = [
        [
            f"{each.points:,}",
            each.method,
            f"{each.followed:,}",
            str(each.unknowns),
            f"{'≈ ' if each.measured else ''}{each.seconds:.1f}",
            f"{each.memory / 1.0e6:,.0f}",
            each.measured or "all",
        ]
        for each in over.costs
    ]
    return [
        "## Over the points",
        "",
        *made_line(over.made),
        *paragraph("""
            The paper's tall column on the same cells, as large as its points ask for, its box with it; a second of
            flow. Each case is a process of its own; its memory is the greatest resident size above what it held before.
            "≈" is multiplied from what was run: two rollouts for each unknown and one more; steps to a second's, and
            the states that the missing ones leave behind are added to the memory; runs of the MPM side by side, and
            their memory with them. AD's pass is the same for any number of unknowns.
        """),
        *table(["points", "method", "it computes with", "unknowns", "seconds", "memory [MB]", "run"], rows),
        "",
        f"![seconds and memory over points]({POINTS_PICTURE})",
        "",
    ]


def started(names: Sequence[str], values: Sequence[float]) -> str:
    """The start in words; equal values of many unknowns once."""
    if len(names) > 2 and len(set(values)) == 1:
        return f"all {len(names)} unknowns at {values[0]:g}"
    return ", ".join(f"{name} = {value:g}" for name, value in zip(names, values, strict=True))
