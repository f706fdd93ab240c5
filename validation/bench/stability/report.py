"""Verdicts -> `stability.md`."""

import os
import platform
from collections.abc import Sequence
from textwrap import fill

from validation.bench.stability import deposit, invariants
from validation.bench.stability.critical_height import Bracket
from validation.bench.stability.exact_cases import EXACT_CASES
from validation.bench.stability.expectations import FAILED
from validation.bench.stability.finding import Finding
from validation.bench.stability.probes import FORGETFUL, Probe
from validation.bench.stability.verdict import PRECISIONS, Verdict

COLUMNS = {
    "energy": "energy rise",
    "momentum": "momentum error",
    "volume": "volume",
    "slope": "slope [°]",
    "f32 to f64": "fronts, f32 to f64 [cells]",
}
"""Checks that have a column in the first table; the place, the mass and the numbers themselves are told below it."""
WIDTH = 118
"""Letters in a line of text."""
ALWAYS = {"not finite", "outside the box", "inside a baffle", "mass", "motion left", *COLUMNS}


def document(
    verdicts: Sequence[Verdict], probes: Sequence[Probe], heights: Sequence[Bracket], command: str, seconds: float
) -> str:
    """The whole page; `heights` of the cuts whose critical height was bracketed."""
    red = [verdict for verdict in verdicts if not verdict.all_green]
    lines = [
        "# Hard cases",
        "",
        *conclusion(verdicts, red, heights),
        "",
        fill(
            f"`{command}`: {len(verdicts)} scenes, each in f32 and in f64; {os.cpu_count()} cores "
            f"({platform.machine()}), {seconds:.0f} s with compilation.",
            WIDTH,
        ),
        "",
        *verdict_table(verdicts),
        "",
        *extremes(verdicts),
        "",
        "What a row has to show besides:",
        "",
        *own_table(verdicts),
        "",
        *remarks(verdicts),
        *critical_heights(heights),
        *without_correction(verdicts, [probe for probe in probes if probe.change == FORGETFUL]),
        *explanation(),
    ]
    if red:
        lines += ["", "## Red rows", ""]
        for cause in dict.fromkeys(verdict.case.cause for verdict in red if verdict.case.cause):
            names = ", ".join(f"`{verdict.case.name}`" for verdict in red if verdict.case.cause == cause)
            lines += [fill(f"{names}: {cause}", WIDTH), ""]
        for verdict in red:
            lines += red_row(verdict, [probe for probe in probes if probe.verdict.case.name == verdict.case.name])
    return "\n".join(lines) + "\n"


def outcome(verdicts: Sequence[Verdict], red: Sequence[Verdict]) -> str:
    """The verdict on all rows in one sentence."""
    if not red:
        return "All rows are green."
    return f"Red, and explained below: {', '.join(each.case.name for each in red)}; all others are green."


def conclusion(verdicts: Sequence[Verdict], red: Sequence[Verdict], heights: Sequence[Bracket]) -> list[str]:
    """What the page comes to, in five lines at the most."""
    exact = [verdict for verdict in verdicts if verdict.case in EXACT_CASES]
    lines = [outcome(verdicts, red)]
    if exact:
        agreed = sum(verdict.all_green for verdict in exact)
        lines.append(f"Of {len(exact)} rows with an exact solution {agreed} agree with it in both precisions.")
    if heights:
        found = ", ".join(f"{each.holds:.2f} to {each.fails:.2f} (phi = {each.friction_deg:g}°)" for each in heights)
        lines.append(f"Vertical cuts with little tension fail at {found} of the critical height of soil without.")
    worst = [value for each in verdicts if (value := each.worst("energy")) is not None]
    if worst:
        lines.append(f"No flow gains more than {max(finding.value for finding in worst):.1e} of its energy.")
    return bullets(lines)


def critical_heights(heights: Sequence[Bracket]) -> list[str]:
    """The section on the heights at which cuts fail."""
    if not heights:
        return []
    text = (
        "Height at which a vertical cut in soil with little tension fails, over the critical height of soil without "
        "any, 2 c / gamma tan(45 + phi / 2) (Drucker 1953), by bisection "
        f"(`python -m validation.bench.stability.critical_height`); failed is a cut of which {100.0 * FAILED:g} % has moved "
        "by a cell; in theory tension T raises the height by t sqrt(2 T gamma H) - t^2 T over gamma, "
        "t = tan(45 + phi / 2), the limit equilibrium of a slice that it holds:"
    )
    return [fill(text, WIDTH), "", *bullets([each.sentence for each in heights]), ""]


def without_correction(verdicts: Sequence[Verdict], probes: Sequence[Probe]) -> list[str]:
    """The section on what volume correction does for the rows that have it, by the name of the row; in f64."""
    forgetful = {probe.verdict.case.name: probe.verdict for probe in probes}
    having = [verdict for verdict in verdicts if verdict.case.name in forgetful]
    if not having:
        return []
    lines = [
        "Volume of the core of the deposit with volume correction (`mpm/physics/volume_correction.py`) and without it, and what fails then, "
        "in f64:",
        "",
        "| scene | volume | without | fails without |",
        "|---|---|---|---|",
    ]
    for verdict in having:
        without = forgetful[verdict.case.name]
        cells = [f"`{verdict.case.name}`", *(of_flow(found_in(each, "volume")) for each in (verdict, without))]
        cells.append("; ".join(told(finding) for finding in without.failures("f64")))
        lines.append("| " + " | ".join(cells) + " |")
    return [*lines, ""]


def found_in(verdict: Verdict, check: str) -> Finding | None:
    """What a check found in f64; None where it does not apply."""
    return next((finding for finding in verdict.findings["f64"] if finding.check == check), None)


def verdict_table(verdicts: Sequence[Verdict]) -> list[str]:
    """A line per row: its verdict in each precision, and the numbers that every row has, of the worse precision."""
    lines = [
        "| scene | what happens | f32 | f64 | " + " | ".join(COLUMNS.values()) + " |",
        "|---|---|---|---|" + "---|" * len(COLUMNS),
    ]
    for verdict in verdicts:
        cells = [f"`{verdict.case.name}`", verdict.case.what]
        cells += ["green" if verdict.green(precision) else "**red**" for precision in PRECISIONS]
        for check in COLUMNS:
            cells.append(of_flow(verdict.worst(check)))
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def of_flow(finding: Finding | None) -> str:
    """A cell of the first table; empty where the check does not apply."""
    if finding is None:
        return ""
    match finding.check:
        case "volume":
            text = f"{100.0 * finding.value:+.1f} %"
        case "slope":
            text = f"{finding.value:.1f} ({finding.most - deposit.REPOSE_MARGIN_DEG:g})"
        case "f32 to f64":
            text = f"{finding.value:.4f}" + ("" if finding.most == deposit.AGREEMENT else f" ({finding.most:.2f})")
        case _:
            text = f"{finding.value:.1e}"
    return text if finding.ok else f"**{text}**"


def extremes(verdicts: Sequence[Verdict]) -> list[str]:
    """The worst over all rows of what has no column."""
    found = [finding for each in verdicts for list_ in each.findings.values() for finding in list_]

    def worst(check: str) -> str:
        values = [finding.value for finding in found if finding.check == check]
        return f"{max(values):.1e}" if values else "none"

    text = (
        f"Worst of all rows: {worst('not finite')} numbers that are not finite, {worst('outside the box')} cells "
        f"outside the box, {worst('inside a baffle')} cells inside a baffle, {worst('mass')} of a mass gone or made, "
        f"{worst('motion left')} of the largest kinetic energy left where a heap has to rest."
    )
    return [fill(text, WIDTH)]


def own_table(verdicts: Sequence[Verdict]) -> list[str]:
    """A line per expectation that single rows have."""
    lines = ["| scene | expected | found in f32 | in f64 |", "|---|---|---|---|"]
    for verdict in verdicts:
        names = [finding.check for each in verdict.findings.values() for finding in each]
        for check in dict.fromkeys(name for name in names if name not in ALWAYS):
            cells, asked = [], ""
            for precision in PRECISIONS:
                of_it = [finding for finding in verdict.findings[precision] if finding.check == check]
                cells.append(", ".join(own_value(finding) for finding in of_it))
                asked = next((f"{check} {finding.range} {finding.unit}".strip() for finding in of_it), asked)
            lines.append(f"| `{verdict.case.name}` | {asked} | " + " | ".join(cells) + " |")
    return lines


def remarks(verdicts: Sequence[Verdict]) -> list[str]:
    """What is to be said of single rows."""
    said = [f"`{verdict.case.name}`: {verdict.case.remark}" for verdict in verdicts if verdict.case.remark]
    return [*bullets(said), ""] if said else []


def own_value(finding: Finding) -> str:
    """A number of the second table."""
    text = f"{finding.value:.4g}"
    return text if finding.ok else f"**{text}**"


def explanation() -> list[str]:
    """What is checked, and why with these bounds."""
    single, double = invariants.MOMENTUM["f32"], invariants.MOMENTUM["f64"]
    every = [
        f"**Place**: no point is more than {invariants.ROUNDING:g} cells (rounding) outside the box or inside a "
        "baffle; the face on which a baffle stands is no way out.",
        "**Mass**: each mass's box holds its volume in points at the start, and each point belongs to one box.",
        "**Momentum**: P(t) - P(0) - M g t + what walls and baffles took, over the larger of M g t and the largest "
        f"|P|; at most {single:g} in f32, {double:g} in f64 (impulses are recorded with six digits). "
        "A damped flow has no such balance: its cell is empty.",
        "**Energy**: kinetic + potential + elastic never rises above that of an earlier frame by more than "
        f"{invariants.ENERGY:g} of the initial kinetic and potential energy, the latter above the lowest corner of the "
        "box: what would lift the whole flow by that part of its mean height. "
        "The rises of all frames count together, not the largest alone. Sand thrown at solids may show half a step of "
        "their power more: stress is half a step ahead of the velocity.",
        f"**Fronts** in f32 and in f64 lie within {deposit.AGREEMENT:g} cells of each other: less than what another "
        "jitter of the points does to a front. Flows that spray amplify rounding until it is another jitter: theirs "
        f"within {deposit.DEVIATIONS:g} standard deviations, in brackets, of the fronts of {deposit.JITTERS} jitters.",
    ]
    heap = [
        f"**Rest**: kinetic energy at the end is below {deposit.REST:g} of its largest.",
        f"**Slope**: planes through the topmost points of {deposit.BASE} columns of one cell (in 3D {deposit.BASE} by "
        f"{deposit.BASE}) are nowhere steeper than the angle of friction, in brackets, and "
        f"{deposit.REPOSE_MARGIN_DEG:g}°: a surface known to a third of a cell leaves 2.6° over that base, and the "
        "steepest of all places is asked for.",
        f"**Volume** of the core: cubes of {deposit.CUBE} cells at least a cube under the surface, their own and their "
        f"neighbours', hold as many points as at the start, within {100 * deposit.VOLUME:g} %; told where there are "
        f"{deposit.FEWEST_CUBES} such cubes or more, for single ones scatter by a tenth.",
    ]
    needs = (
        "Scenes with the same needs run side by side, so each runs in the kernel that it would get alone: a batch "
        "compiles what any of its scenes needs, and one with cohesion, several materials or baffles would "
        "hand its code to all."
    )
    return [
        "What is checked of every flow, in every frame:",
        "",
        *bullets(every),
        "",
        "And of a heap that comes to rest:",
        "",
        *bullets(heap),
        "",
        fill(needs, WIDTH),
    ]


def bullets(items: Sequence[str]) -> list[str]:
    """A list in Markdown, wrapped."""
    return [fill(item, WIDTH, initial_indent="- ", subsequent_indent="  ") for item in items]


def red_row(verdict: Verdict, probes: Sequence[Probe]) -> list[str]:
    """What is wrong with a row, and what becomes of it at a smaller step and on a finer grid."""
    lines = [f"**`{verdict.case.name}`**, {verdict.case.what}:", ""]
    for precision in PRECISIONS:
        if precision in verdict.blown_up:
            lines.append(f"- {precision}: {verdict.blown_up[precision]}")
        lines += [f"- {precision}: {told(finding)}" for finding in verdict.failures(precision)]
    failed = {finding.check for precision in PRECISIONS for finding in verdict.failures(precision)}
    for probe in probes:
        if "f64" in probe.verdict.blown_up:
            lines.append(f"- {probe.change}, f64: {probe.verdict.blown_up['f64']}")
        again = [finding for finding in probe.verdict.findings["f64"] if finding.check in failed]
        lines += [f"- {probe.change}, f64: {told(finding)}" for finding in again]
    return [*lines, ""]


def told(finding: Finding) -> str:
    """A finding in words."""
    return f"{finding.check} {finding.value:.4g} {finding.unit}".strip() + f" (asked for {finding.range})"
