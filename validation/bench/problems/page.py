"""`docs/problems.md`: every inverse problem, the paper's numbers beside ours, and what was asked of each."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from datasets.files import replacing, write_text
from inverse.problem import Problem
from inverse.report.markdown import table
from validation.bench.columns.paper import Paper
from validation.bench.problems.targets import Bars, Family, Mark, judge
from validation.loop.outcomes import Outcome

PICTURES = "pictures"

HEAD = """\
# The inverse problems

Every problem that ships, solved by `python -m validation.loop`: the surrogate proposes, our MPM confirms or corrects.
Targets of twin experiments are made by our own MPM with another initial jitter than the inversion's. All that is said
of an answer is the MPM's word: loss and front are those of the MPM at the answer, and with "the surrogate alone" those
where it ended before the MPM corrected it. The ± is meant to hold the truth 95 times in 100. "MPM runs" counts those
on the way, and in brackets the ensembles around the answer, for its last step and its half-width.
"""

PAPER = """
The paper's numbers are in `validation/paper.toml`. Its targets come from its own MPM, ours from ours; its front is the
largest x, ours the x that 99.5 % of the points are behind.
"""

RESUMED = "Marked with an asterisk: it was resumed, and its total does not count what had run before."


def write(
    folder: Path,
    families: Sequence[Family],
    problems: Mapping[str, Problem],
    found: Mapping[str, Outcome],
    paper: Paper,
) -> None:
    """Write `problems.md` and `pictures/` into `folder`: all `problems` that were `found`, and those that were not."""
    known = {name for family in families for name in family.problems}
    others = tuple(name for name in problems if name not in known)
    groups = [*families, *([Family(title="Others", problems=others, bars=Bars())] if others else [])]
    lines = [
        HEAD,
        "`python -m validation.bench.problems.bench` made this page, with one `python -m validation.loop` per problem.",
    ]
    lines += [PAPER, *overview(groups, found)]
    missing = [name for name in problems if name not in found]
    if missing:
        lines += ["", f"Not measured yet: {', '.join(f'`{name}`' for name in missing)}."]
    for group in groups:
        here = [found[name] for name in group.problems if name in found]
        if here:
            lines += ["", *section(folder, group, here, paper)]
    lines += ["", *commands(list(found.values()))]
    write_text(folder / "problems.md", "\n".join(lines) + "\n")


def overview(groups: Sequence[Family], found: Mapping[str, Outcome]) -> list[str]:
    """What was asked, by group, and how often it was met."""
    rows = []
    for group in groups:
        here = [found[name] for name in group.problems if name in found]
        if not here:
            continue
        marks = [mark for outcome in here for mark in judge(outcome, group.bars) if mark.met is not None]
        met = sum(bool(mark.met) for mark in marks)
        misses = sorted(
            {f"`{each.problem.name}`" for each in here for mark in judge(each, group.bars) if mark.met is False}
        )
        rows.append([group.title, str(len(here)), f"{met} of {len(marks)}", ", ".join(misses) or "-"])
    return ["## At a glance", "", *table(["", "problems", "of what was asked, met", "misses in"], rows)]


def section(folder: Path, group: Family, here: Sequence[Outcome], paper: Paper) -> list[str]:
    """A group: its table, what was asked, its pictures."""
    twins = any(outcome.truth for outcome in here)
    stated = [papers(outcome.problem.name, paper) for outcome in here]
    head = ["problem", *(["the paper"] if any(stated) else []), "the surrogate alone", "verdict", "found"]
    head += [*(["largest error", "truth inside"] if twins else []), "away from the target", "loss", "MPM runs"]
    head += ["s per iteration", "s in all"]
    rows = []
    for outcome, said in zip(here, stated, strict=True):
        row = [f"`{outcome.problem.name}`", *([said or "-"] if any(stated) else [])]
        row += [alone(outcome), f"**{outcome.verdict}**", answer(outcome), *(truth(outcome) if twins else [])]
        row += [miss(outcome), "-" if outcome.loss is None else f"{outcome.loss:.2e}"]
        star = "\\*" if outcome.origin and outcome.origin.resumed else ""
        row += [f"{outcome.checks} (+ {outcome.ensemble})", f"{outcome.seconds['per_iteration']:.1f}"]
        rows.append([*row, f"{outcome.seconds['total']:.0f}{star}"])
    lines = [f"## {group.title}", "", *table(head, rows), "", *asked(group, here)]
    for outcome in here:
        for picture in group.pictures:
            source = outcome.folder / f"{picture}.png"
            if source.exists():
                name = f"{outcome.problem.name}-{picture}.png"
                with replacing(folder / PICTURES / name) as part:
                    part.write_bytes(source.read_bytes())
                lines += ["", f"`{outcome.problem.name}`, {picture}:", "", f"![{picture}]({PICTURES}/{name})"]
    return lines


def asked(group: Family, here: Sequence[Outcome]) -> list[str]:
    """Every bar of a group, met or not."""
    rows = []
    for outcome in here:
        marks = judge(outcome, group.bars)
        rows.append([f"`{outcome.problem.name}`", "; ".join(map(tell, marks))])
    return table(["", "asked: got"], rows)


def tell(mark: Mark) -> str:
    """A bar in a few words; what is missed stands out."""
    said = f"{mark.asked}: {mark.got}"
    return f"**missed: {said}**" if mark.met is False else said


def answer(outcome: Outcome) -> str:
    """What was found: each of a few unknowns, or how closely many are known."""
    widths = outcome.certainty
    if len(outcome.unknowns) > 4:
        if not widths:
            return f"{len(outcome.unknowns)} unknowns"
        least, most = min(widths, key=widths.__getitem__), max(widths, key=widths.__getitem__)
        ends = [outcome.problem.text(name, widths[name]) for name in (least, most)]
        return f"{len(widths)} unknowns, ± {' to '.join(ends)}"
    said = []
    for name, value in outcome.unknowns.items():
        label = f"`{name}` " if len(outcome.unknowns) > 1 else ""
        width = f" ± {outcome.problem.text(name, widths[name])}" if widths else ""
        said.append(label + outcome.problem.text(name, value) + width)
    return "<br>".join(said)


def alone(outcome: Outcome) -> str:
    """What the surrogate had found before any MPM run corrected it, and the MPM's loss there."""
    run = outcome.alone
    loss = f"loss {run['loss']:.2e}"
    if len(outcome.unknowns) > 1:
        return loss
    ((name, value),) = run["unknowns"].items()
    return f"{outcome.problem.text(name, value)}; {loss}"


def truth(outcome: Outcome) -> list[str]:
    """Largest error of the unknowns, and how many of them lie within their half-widths."""
    if not outcome.truth:
        return ["-", "-"]
    worst = max(outcome.unknowns, key=lambda name: outcome.error(name) / _range(outcome.problem, name))
    error = outcome.problem.text(worst, outcome.error(worst))
    if len(outcome.unknowns) == 1 and math.isfinite(outcome.error_pct(worst)):
        error += f" ({outcome.error_pct(worst):.2f} %)"
    inside = f"{len(outcome.inside)} of {len(outcome.unknowns)}" if outcome.certainty else "-"
    return [error if len(outcome.unknowns) == 1 else f"{error} of `{worst}`", inside]


def miss(outcome: Outcome) -> str:
    """How far from the target the MPM at the answer is."""
    if outcome.loss is None:
        return "-"
    said = outcome.problem.observed.misfit_text(outcome.loss, outcome.problem.scene.domain.cell)
    front = outcome.front_error_pct
    return said if front is None else f"{said}; front {front:.2f} %"


def papers(name: str, paper: Paper) -> str:
    """What the paper reports of a problem, empty where it has none."""
    for scenario in paper.scenarios:
        if name == f"friction-{scenario.name}":
            error = f"{scenario.phi_estimated:.2f} deg ({scenario.phi_error_pct:.2f} %)"
            return f"{error}; runout {scenario.front_error_pct:.2f} %"
    if name == "velocity-layers-10":
        own = paper.velocity
        return _losses(own.mse_mpm, own.mse_surrogate, own.mse_initial, own.iterations)
    if name == "baffles-2":
        own_baffles = paper.baffles
        z = " and ".join(f"{value:.3f}" for value in own_baffles.z)
        losses = (own_baffles.loss_mpm, own_baffles.loss_surrogate, own_baffles.loss_initial)
        return f"z = {z} m; {_losses(*losses, own_baffles.iterations)}"
    return ""


def commands(found: Sequence[Outcome]) -> list[str]:
    """Which command on which machine made each figure."""
    rows = []
    for outcome in found:
        origin = outcome.origin
        made = [f"`{origin.command}`", origin.date, origin.machine] if origin else ["not recorded", "-", "-"]
        rows.append([f"`{outcome.problem.name}`", *made])
    lines = ["## Where the figures come from", "", *table(["", "command", "date", "machine"], rows)]
    if any(outcome.origin and outcome.origin.resumed for outcome in found):
        lines += ["", RESUMED]
    return lines


def _losses(mpm: float, surrogate: float, initial: float, iterations: int) -> str:
    return f"loss {mpm:.2e} (its surrogate {surrogate:.2e}, start {initial:.1e}), {iterations} iterations"


def _range(problem: Problem, name: str) -> float:
    return next(each.range for each in problem.parameters if each.name == name)
