"""Scenes that break other solvers and exact solutions, a verdict for each: stability.md.

`python -m validation.bench stability --out docs`; `--rows NAME`, once or more, runs some of them.
"""

import difflib
from collections.abc import Sequence
from pathlib import Path

from datasets.command_line import WorkFailed
from datasets.errors import InputError
from validation.bench.stability import deposit, invariants
from validation.bench.stability.critical_height import CUTS, Bracket, bracket, bracket_row
from validation.bench.stability.expectations import FAILED
from validation.bench.stability.finding import Finding
from validation.bench.stability.rows import EXACT, ROWS, Row
from validation.bench.stability.verdict import (
    PRECISIONS,
    Variant,
    Verdict,
    half_cell,
    half_step,
    variants,
    verdicts_of,
    without_correction,
)
from validation.report.page import Page

COLUMNS = {
    "energy": "energy rise",
    "momentum": "momentum error",
    "volume": "volume",
    "slope": "slope [°]",
    "f32 to f64": "fronts, f32 to f64 [cells]",
}
"""Checks that have a column in the first table; the worst of position, mass and finite numbers stands below it."""
EVERYWHERE = ("not finite", "outside the box", "inside a baffle", "mass", "motion left")
QUICK = ("one-point", "block-24", "block-35", "far-slow", "thin-body")


def bench(out: Path, *, quick: bool = False, keep: Path | None = None, rows: tuple[str, ...] = ()) -> str:
    """Run the rows in f32 and f64 and check what has to hold; what is wrong with a red row fails the command.

    quick: five short rows, no critical height. keep: nothing is kept; the whole takes twenty minutes.
    rows: names of rows; all unless given.
    """
    chosen = choose(rows or (QUICK if quick else ()))
    verdicts = verdicts_of(chosen)
    red = [each.row for each in verdicts if not each.all_green]
    causes = variants(red, "half the step", half_step) + variants(red, "half the cell", half_cell)
    corrected = [] if quick else variants(chosen, "no volume correction", without_correction)
    heights = [] if quick else [bracket(row.scene) for row in chosen if row.name in CUTS]
    command = " ".join(
        ["python -m validation.bench stability", *(["--quick"] if quick else []), *(f"--rows {name}" for name in rows)]
    )
    page = document(verdicts, causes, corrected, heights, command=command, quick=quick)
    page.write(out / "stability.md")
    if red:
        print(page)
        raise WorkFailed(f"red rows: {', '.join(row.name for row in red)}")
    return page.conclusion


def choose(names: Sequence[str]) -> list[Row]:
    """The rows of these names, all where there are none, and those that they are compared with. Raises InputError."""
    known = {row.name: row for row in ROWS}
    for name in names:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"one of {', '.join(known)}"
            raise InputError(f"expected the name of a row: {hint}", where=name)
    selected = {*names, *(known[name].beside for name in names)} if names else known.keys()
    return [row for row in ROWS if row.name in selected]


def document(
    verdicts: Sequence[Verdict],
    causes: Sequence[Variant],
    corrected: Sequence[Variant],
    heights: Sequence[Bracket],
    *,
    command: str,
    quick: bool = False,
) -> Page:
    """The page. causes: red rows, changed; corrected: rows without volume correction; heights: of bracketed cuts."""
    page = Page("Hard cases", command=command, conclusion=conclusion(verdicts, heights), quick=quick)
    page.text(f"{len(verdicts)} scenes, each in f32 and in f64.")
    page.table([verdict_row(each) for each in verdicts])
    page.text("Worst of all rows: " + "; ".join(f"{check} {worst(verdicts, check)}" for check in EVERYWHERE) + ".")
    page.section("What a row has to show besides")
    page.table([row for each in verdicts for row in own_rows(each)])
    page.text("\n".join(f"- `{each.row.name}`: {each.row.remark}" for each in verdicts if each.row.remark))
    if heights:
        page.section("Critical heights")
        page.text(f"""
            Height at which a vertical cut in soil with little tension fails, over the critical height of soil without
            any, 2 c / gamma tan(45 + phi / 2) (Drucker 1953), by bisection; failed is a cut of which
            {100.0 * FAILED:g} % has moved by a cell. In theory tension T raises the height by t sqrt(2 T gamma H) -
            t^2 T over gamma, t = tan(45 + phi / 2), the limit equilibrium of a slice that it holds.
        """)
        page.table([bracket_row(each) for each in heights], formats=dict.fromkeys(HEIGHT_COLUMNS, ".2f"))
    if corrected:
        page.section("Volume correction")
        page.text("Volume of the core of the deposit with `mpm/physics/volume_correction.py` and without it, in f64.")
        page.table([correction_row(each, verdicts) for each in corrected])
    page.section("What is checked")
    page.text(EXPLANATION)
    for each in verdicts:
        if not each.all_green:
            page.section(f"Red: {each.row.name}")
            page.text("\n".join(red_lines(each, causes)))
    return page


HEIGHT_COLUMNS = ("holds [H / H critical]", "fails [H / H critical]", "in theory, without tension")


def conclusion(verdicts: Sequence[Verdict], heights: Sequence[Bracket]) -> list[str]:
    """What the page comes to, in five sentences at the most."""
    green = [each for each in verdicts if each.all_green]
    red = [each.row.name for each in verdicts if not each.all_green]
    sentences = [f"{len(green)} of {len(verdicts)} rows are green" + (f"; red: {', '.join(red)}." if red else ".")]
    exact = [each for each in verdicts if each.row in EXACT]
    if exact:
        agreed = sum(each.all_green for each in exact)
        sentences.append(f"Of {len(exact)} rows with an exact solution {agreed} agree with it in both precisions.")
    if heights:
        found = ", ".join(f"{each.holds:.2f} to {each.fails:.2f} (phi = {each.friction_deg:g}°)" for each in heights)
        sentences.append(f"Vertical cuts with little tension fail at {found} of the critical height of soil without.")
    rises = [finding.value for each in verdicts if (finding := each.worst("energy")) is not None]
    if rises:
        sentences.append(f"No flow gains more than {max(rises):.1e} of its energy.")
    return sentences


def verdict_row(each: Verdict) -> dict[str, object]:
    """A row's verdict in each precision, and the numbers that every row has, of the worse precision."""
    colours = {str(precision): "green" if each.green(precision) else "**red**" for precision in PRECISIONS}
    cells = {heading: cell(each.worst(check)) for check, heading in COLUMNS.items()}
    return {"scene": f"`{each.row.name}`", "what happens": each.row.what, **colours, **cells}


def cell(finding: Finding | None) -> str:
    """A cell of the first table; empty where the check does not apply."""
    if finding is None:
        return ""
    match finding.check:
        case "volume":
            text = f"{100.0 * finding.value:+.1f} %"
        case "slope":
            text = f"{finding.value:.1f} ({finding.maximum - deposit.REPOSE_MARGIN_DEG:g})"
        case "f32 to f64":
            text = f"{finding.value:.4f}" + (
                "" if finding.maximum == deposit.AGREEMENT else f" ({finding.maximum:.2f})"
            )
        case _:
            text = f"{finding.value:.1e}"
    return text if finding.ok else f"**{text}**"


def worst(verdicts: Sequence[Verdict], check: str) -> str:
    """The largest value of a check over all rows."""
    values = [found.value for each in verdicts if (found := each.worst(check)) is not None]
    return f"{max(values):.1e}" if values else "nowhere"


def own_rows(each: Verdict) -> list[dict[str, object]]:
    """A line per expectation that the row has for itself."""
    names = dict.fromkeys(finding.check for found in each.findings.values() for finding in found)
    lines = []
    for check in (name for name in names if name not in EVERYWHERE and name not in COLUMNS):
        line: dict[str, object] = {"scene": f"`{each.row.name}`", "required": ""}
        for precision in PRECISIONS:
            found = [finding for finding in each.findings[precision] if finding.check == check]
            line["required"] = next((f"{f.check} {f.range} {f.unit}".strip() for f in found), line["required"])
            line[precision] = ", ".join(f"{f.value:.4g}" if f.ok else f"**{f.value:.4g}**" for f in found)
        lines.append(line)
    return lines


def correction_row(without: Variant, verdicts: Sequence[Verdict]) -> dict[str, object]:
    """The volume of a row with volume correction and without, and what fails without."""
    row = without.verdict.row.name
    having = next(each for each in verdicts if each.row.name == row)
    volumes = [
        cell(next((finding for finding in each.findings["f64"] if finding.check == "volume"), None))
        for each in (having, without.verdict)
    ]
    fails = "; ".join(str(finding) for finding in without.verdict.failures("f64"))
    return {"scene": f"`{row}`", "volume": volumes[0], "without": volumes[1], "fails without": fails}


def red_lines(each: Verdict, causes: Sequence[Variant]) -> list[str]:
    """What is wrong with a row, and its findings at a smaller step and on a finer grid."""
    lines = [f"{each.row.what}. {each.row.cause}".strip(), ""]
    for precision in PRECISIONS:
        if precision in each.blown_up:
            lines.append(f"- {precision}: {each.blown_up[precision]}")
        lines += [f"- {precision}: {finding}" for finding in each.failures(precision)]
    failed = {finding.check for precision in PRECISIONS for finding in each.failures(precision)}
    for variant in (variant for variant in causes if variant.verdict.row.name == each.row.name):
        if "f64" in variant.verdict.blown_up:
            lines.append(f"- {variant.change}, f64: {variant.verdict.blown_up['f64']}")
        again = [finding for finding in variant.verdict.findings["f64"] if finding.check in failed]
        lines += [f"- {variant.change}, f64: {finding}" for finding in again]
    return lines


EXPLANATION = f"""
Of every flow, in every frame:

- **Position**: no particle is more than {invariants.ROUNDING:g} cells (rounding) outside the box or inside a baffle; a
  baffle's face on the floor is no way out.
- **Mass**: each mass's box holds its volume in particles at the start, and each particle belongs to one box.
- **Momentum**: P(t) - P(0) - M g t + the impulse on walls and baffles, over the larger of M g t and the largest |P|; at
  most {invariants.MOMENTUM["f32"]:g} in f32, {invariants.MOMENTUM["f64"]:g} in f64 (impulses are recorded with six
  digits). A damped flow has no such balance: its cell is empty.
- **Energy**: kinetic + potential + elastic never rises above that of an earlier frame by more than
  {invariants.ENERGY:g} of the initial kinetic and potential energy, the latter above the lowest corner of the box. Sand
  thrown at solids may show half a step of their power more: stress is half a step ahead of the velocity.
- **Fronts** in f32 and in f64 lie within {deposit.AGREEMENT:g} cells of each other: less than another jitter of the
  particles changes a front. Flows that spray amplify rounding until it is another jitter: theirs within
  {deposit.DEVIATIONS:g} standard deviations, in brackets, of the fronts of {deposit.JITTERS} jitters.

Of a deposit that comes to rest:

- **Rest**: kinetic energy at the end is below {deposit.REST:g} of its largest.
- **Slope**: planes through the topmost particles of {deposit.BASE} columns of one cell (in 3D {deposit.BASE} by
  {deposit.BASE}) are nowhere steeper than the angle of friction, in brackets, and {deposit.REPOSE_MARGIN_DEG:g}°.
- **Volume** of the core: cubes of {deposit.CUBE} cells at least a cube under the surface, their own and their
  neighbours', hold as many particles as at the start, within {100 * deposit.VOLUME:g} %, where there are
  {deposit.MIN_CUBES} such cubes or more.
"""
