"""`efficiency.md` and its pictures, from the parts that were measured."""

from pathlib import Path

from matplotlib.axes import Axes

from validation.bench.efficiency import gradients
from validation.bench.efficiency.columns import SOLID
from validation.bench.efficiency.findings import PAPER_BYTES, PAPER_NODES, best_of, conclusion, costs_of, gradient_curve
from validation.bench.efficiency.records import (
    AD,
    AD_LONG,
    ADJOINT,
    FD_GNS,
    FD_MPM,
    JITTERS,
    LONG_STEPS,
    MethodResult,
    OverParticles,
    OverUnknowns,
    Parts,
    ProblemResult,
)
from validation.bench.paper import read_paper
from validation.report.page import Page, Row
from validation.report.plots import BLUE, GREEN, INK, ORANGE, RED, figure, pane

COMMAND = "python -m validation.bench efficiency"
COLOURS = {AD: BLUE, ADJOINT: RED, FD_GNS: GREEN, FD_MPM: ORANGE}
MARKERS = "os^Dv*PX"
PICTURES = "pictures"
PROBLEM_TEXT = """
    A method by differences has its bounds a step narrower, so that no difference leaves them. A surrogate's seconds
    include its start. The loss is that of an MPM run at the answer, with a jitter that neither target nor search used;
    it is not among the MPM runs; nor are the adjoint's replays and reverses, which are in its seconds. A search by
    Optuna is one draw of its random numbers. Secants take their first Jacobian from runs over the box, which are
    counted before the "+" (`inverse.secants`). "≈": seconds per iteration times the iterations that the problem
    allows, where the search ran out of time before.
"""
PARTICLES_TEXT = f"""
    The paper's tall column on the same cells, longer and higher with its box, and `{SOLID}` as it ships; a second of
    flow. Each case is a process of its own; its memory is the greatest resident size above what it held before. "≈" is
    multiplied from what was run: two rollouts for each unknown and one more; runs of the MPM side by side, with their
    memory. The passes of AD and of the adjoint are the same for any number of unknowns. Of
    AD a step leaves its state, its activations are computed again in the backward pass, except for the last steps that
    half a GiB holds. "{LONG_STEPS} steps": AD through a longer flow, no activations kept, beside the paper's stated
    limit. Cases that a folder of `--keep` holds are not measured again.
"""


def write(out: Path, parts: Parts) -> str:
    """Write OUT/efficiency.md with its pictures; returns the conclusion."""
    for result in parts.problems.values():
        draw_problem(out / PICTURES / f"efficiency-{result.problem}.png", result)
    if parts.unknowns is not None:
        draw_unknowns(out / PICTURES / "efficiency-unknowns.png", parts.unknowns)
    if parts.particles is not None:
        draw_particles(out / PICTURES / "efficiency-particles.png", parts.particles)
    return page(parts).write(out / "efficiency.md")


def page(parts: Parts) -> Page:
    """The page, of the parts that there are, at least one."""
    origins = [each.origin for each in parts.all()]
    found = Page(
        "What a gradient costs",
        command=COMMAND,
        conclusion=conclusion(parts),
        measured="; ".join(dict.fromkeys(f"{each.date}, on {each.machine}" for each in origins)),
        quick=any(each.quick for each in origins),
    )
    if parts.problems:
        found.section("Problems")
        found.text(PROBLEM_TEXT)
    for result in parts.problems.values():
        problem_section(found, result)
    if parts.unknowns is not None:
        unknowns_section(found, parts.unknowns)
    if parts.particles is not None:
        particles_section(found, parts.particles)
    return found


def problem_section(found: Page, result: ProblemResult) -> None:
    """One problem: its outcome in a sentence, table, picture."""
    found.section(result.problem, level=3)
    found.text(f"{best_of(result)}\n\nStart: {result.start}. Stop: {result.rule}, or after {result.limit:g} s.")
    found.table([problem_row(each) for each in result.methods])
    if any(each.paper is not None for each in result.methods):
        phi = read_paper().fd_gns_phi_estimated
        found.text(
            "The paper's seconds: AD on one GPU, the MPM on 56 cores. Its angle by differences with its GNS:"
            f" {phi:.2f} deg."
        )
    found.picture(f"{PICTURES}/efficiency-{result.problem}.png", "MPM loss over seconds")


def problem_row(row: MethodResult) -> Row:
    """One method as a line."""
    # A search without gradients has no iterations of its own to count.
    cut = row.ended == "out of time" and row.backward > 0.0
    return {
        "method": row.method,
        "optimiser": row.optimiser,
        "s per iteration": f"{row.per_iteration:.2f}",
        "forward, backward [s]": f"{row.forward:.2f}, " + (f"{row.backward:.2f}" if row.backward else "-"),
        "the paper's [s]": None if row.paper is None else f"{row.paper:g}",
        "iterations": f"{row.sample} + {row.iterations}" if row.sample else row.iterations,
        "ended": row.ended,
        "all iterations": f"≈ {row.per_iteration * row.allowed:.0f} s for {row.allowed}" if cut else None,
        "MPM runs": row.mpm_runs,
        "seconds": f"{row.seconds:.1f}",
        "rms error of the unknowns": ", ".join(f"{value:.3g} {unit}" for unit, value in row.error.items()),
        "MPM loss": f"{row.loss:.1e}",
    }


def unknowns_section(found: Page, over: OverUnknowns) -> None:
    """The cuts of the same sand."""
    steps = ", ".join(f"{step:g} m/s at {number}" for number, step in over.steps.items())
    cuts = ", ".join(f"{x} x {y}" for x, y in gradients.CUTS)
    found.section("Over the unknowns")
    found.text(f"""
        The paper's sand of ten layers, {over.particles:,} particles, cut into {cuts} blocks between its particles; the
        velocity of each along x is unknown. True ones fall from {gradients.AT_FLOOR:g} m/s at the floor to
        {gradients.AT_TOP:g} at the top; the gradient of the deposit's loss is evaluated at {gradients.FRACTION:g} of
        them. Step of the differences: {steps} unknowns. "≈": the differences of some unknowns were run and their
        seconds multiplied; there, cosine and error are over those unknowns. Both are to the mean of the MPM's
        differences over {JITTERS} jitters, beside which its own rows show their scatter. The adjoint is on one thread,
        its seconds for {JITTERS} jitters those of one after the other.
    """)
    found.table(
        [
            {
                "unknowns": each.unknowns,
                "method": each.method,
                "seconds": f"{'≈ ' if each.extrapolated else ''}{each.seconds:.2f}",
                "differences run": f"{each.columns} of {each.unknowns}" if each.extrapolated else "all",
                "cosine": each.cosine,
                "error": each.error,
            }
            for each in over.gradients
        ],
        formats={"cosine": ".4f", "error": ".1%"},
    )
    found.picture(f"{PICTURES}/efficiency-unknowns.png", "seconds over unknowns")


def particles_section(found: Page, over: OverParticles) -> None:
    """The sizes of one column."""
    found.section("Over the particles")
    found.text(PARTICLES_TEXT)
    found.table(
        [
            {
                "particles": f"{each.particles:,}{' in 3D' if each.dimension == 3 else ''}",
                "method": each.method,
                "nodes or particles": f"{each.nodes:,}",
                "unknowns": each.unknowns,
                "seconds": f"{'≈ ' if each.measured else ''}{each.seconds:.1f}",
                "memory [MB]": f"{each.memory / 1.0e6:,.0f}",
                "run": each.measured or "all",
            }
            for each in over.costs
        ]
    )
    found.picture(f"{PICTURES}/efficiency-particles.png", "seconds and memory over particles")


def draw_problem(path: Path, result: ProblemResult) -> None:
    """MPM loss at each method's best iterate over the seconds."""
    with figure(path, size=(8.0, 4.5)) as axes:
        axis = pane(axes)
        for number, row in enumerate(result.methods):
            seconds, losses = [each.seconds for each in row.curve], [each.loss for each in row.curve]
            # An answer stays until there is a better one, or the search ends.
            ends = [*seconds, max(row.seconds, seconds[-1])]
            (line,) = axis.plot(ends, [*losses, losses[-1]], drawstyle="steps-post", linewidth=1.2)
            marker = MARKERS[number % len(MARKERS)]
            axis.plot(seconds, losses, marker, color=line.get_color(), markersize=5, label=row.method)
        if result.floor:
            axis.axhline(result.floor, color=INK, linewidth=0.8, linestyle=":", label="the truth")
        axis.set_title(result.problem)
        logarithmic(axis, "seconds", "MPM loss at the best iterate")


def draw_unknowns(path: Path, over: OverUnknowns) -> None:
    """Seconds per gradient over the unknowns; a ring where they were multiplied."""
    multiplied = {(each.method, float(each.unknowns)) for each in over.gradients if each.extrapolated}
    with figure(path, size=(7.0, 4.5)) as axes:
        axis = pane(axes)
        for method, colour in COLOURS.items():
            curve = gradient_curve(over, method)
            axis.plot(*zip(*curve, strict=True), color=colour, linewidth=1.2, label=method)
            for unknowns, seconds in curve:
                fill = "none" if (method, unknowns) in multiplied else colour
                axis.plot(unknowns, seconds, "o", color=colour, mfc=fill)
        logarithmic(axis, "unknowns", "seconds per gradient")


def draw_particles(path: Path, over: OverParticles) -> None:
    """Seconds and memory of a gradient over the particles; a ring where they were multiplied."""
    with figure(path, columns=2, size=(5.5, 4.5)) as axes:
        left, right = pane(axes), pane(axes, 0, 1)
        for unknowns, style in zip(sorted({each.unknowns for each in over.costs}), ("-", "--", ":"), strict=False):
            for method, colour in COLOURS.items():
                costs = costs_of(over, method, unknowns)
                label = f"{method}, {unknowns} unknown{'s' if unknowns > 1 else ''}"
                for axis, values in (
                    (left, [each.seconds for each in costs]),
                    (right, [each.memory / 1.0e9 for each in costs]),
                ):
                    particles = [each.particles for each in costs]
                    axis.plot(particles, values, style, color=colour, linewidth=1.2, label=label)
                    for each, value in zip(costs, values, strict=True):
                        fill = "none" if each.measured else colour
                        axis.plot(each.particles, value, "o", color=colour, mfc=fill, markersize=5)
        long = costs_of(over, AD_LONG, 1)
        right.plot(
            [each.particles for each in long], [each.memory / 1.0e9 for each in long], "o:", color=INK, label=AD_LONG
        )
        right.plot(PAPER_NODES, PAPER_BYTES / 1.0e9, "x", color=INK, label="the paper's code fails, 400 steps")
        logarithmic(left, "particles", "seconds per gradient")
        logarithmic(right, "particles", "peak memory above the start [GB]")


def logarithmic(axis: Axes, x: str, y: str) -> None:
    """Logarithmic axes with labels and a legend."""
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xlabel(x)
    axis.set_ylabel(y)
    axis.legend()
