"""`problems.md`: every inverse problem beside its criteria and the reference paper's numbers."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from datasets.files import replacing
from inverse.parameters import Kind
from validation.bench.paper import Paper
from validation.bench.problems.outcome import Outcome
from validation.bench.problems.targets import Family, compare
from validation.report.page import GNS, MPM, Page

PICTURES = "pictures"
NAMED = 4
"""With more parameters than these the range of their half-widths is given."""


def page(out: Path, families: Sequence[Family], found: Mapping[str, Outcome], paper: Paper, *, quick: bool) -> Page:
    """The page of all problems that were `found`; their pictures are copied into `out`."""
    groups = [(family, [found[each] for each in family.problems if each in found]) for family in families]
    groups = [(family, here) for family, here in groups if here]
    command = f"python -m validation.bench problems{' --quick' if quick else ''}"
    result = Page(
        "The inverse problems", command=command, conclusion=conclusion(groups), packages=MPM | GNS, quick=quick
    )
    result.text(
        "Each problem is solved by one `python -m validation.loop`. Targets of twin experiments are runs of the MPM "
        "with another initial jitter than the inversion's. Loss and front error are those of the MPM at the answer. ± "
        "are 95 % half-widths; of a problem with several separate answers the heaviest is given. The paper's numbers "
        "are in `validation/bench/paper.toml`: "
        "its targets are of its own MPM, its front is the largest x, here the x that 99.5 % of particles are behind."
    )
    missing = sorted(each for family in families for each in family.problems if each not in found)
    if missing:
        result.text(f"Not measured yet: {', '.join(f'`{each}`' for each in missing)}.")
    for family, here in groups:
        result.section(family.title)
        result.table([row(outcome, paper) for outcome in here])
        compared = {name(outcome): compare(outcome, family.criteria) for outcome in here}
        result.table([{"problem": each, "criteria": "; ".join(map(str, found))} for each, found in compared.items()])
        for outcome in here:
            for picture in family.pictures:
                copy(result, outcome, picture, out)
    result.section("Where the figures come from")
    result.table([made(outcome) for _, here in groups for outcome in here])
    return result


def conclusion(groups: Sequence[tuple[Family, Sequence[Outcome]]]) -> list[str]:
    """What was confirmed, which criteria were missed, errors, half-widths, cost."""
    outcomes = [outcome for _, here in groups for outcome in here]
    if not outcomes:
        return ["No problem has been solved yet."]
    compared = [(each, one) for family, here in groups for each in here for one in compare(each, family.criteria)]
    applied = [(each, one) for each, one in compared if one.is_within is not None]
    missed = sorted({name(each) for each, one in applied if not one.is_within})
    expected = sum(one.is_within is True for _, one in compared if one.criterion.startswith("verdict"))
    truths = sum(len(each.errors) for each in outcomes if each.half_widths)
    inside = sum(len(each.inside) for each in outcomes)
    runs = [len(each.result["mpm_runs"]) for each in outcomes]
    seconds = [each.result["seconds"]["total"] for each in outcomes]
    within = len(applied) - sum(not one.is_within for _, one in applied)
    return [
        f"{expected} of {len(outcomes)} problems have the verdict that they should have.",
        f"{within} of {len(applied)} criteria are kept; missed by {', '.join(missed) or 'none'}.",
        f"{inside} of {truths} true values are within their 95 % half-widths.",
        f"MPM runs for a problem: {extent(runs)}; seconds: {extent(seconds)}.",
    ]


def extent(values: Sequence[float]) -> str:
    """The smallest to the largest of `values`."""
    low, high = f"{min(values):.0f}", f"{max(values):.0f}"
    return low if low == high else f"{low} to {high}"


def row(outcome: Outcome, paper: Paper) -> dict[str, object]:
    """The line of a problem."""
    result, cell = outcome.result, outcome.problem.scene.domain.cell
    loss = result["loss"]["mpm"]
    distance = "-" if loss is None else f"{1e3 * math.sqrt(loss):.3g} mm ({math.sqrt(loss) / cell:.2g} cells)"
    star = "\\*" if outcome.origin and outcome.origin.resumed else ""
    return {
        "problem": name(outcome),
        "the paper": of_paper(outcome.problem.name, paper),
        "verdict": f"**{result['verdict']}**",
        "found": of_parameters(outcome),
        "largest error": error(outcome),
        "truth inside": f"{len(outcome.inside)} of {len(outcome.errors)}" if outcome.errors else "-",
        "distance to the target": distance,
        "loss": "-" if loss is None else f"{loss:.2e}",
        "answers": str(len(result["answers"])),
        "MPM runs": str(len(result["mpm_runs"])),
        "s in the MPM": f"{result['seconds']['mpm']:.0f}",
        "s in all": f"{result['seconds']['total']:.0f}{star}",
    }


def name(outcome: Outcome) -> str:
    """Of the problem, in Markdown."""
    return f"`{outcome.problem.name}`"


def kinds(outcome: Outcome) -> dict[str, Kind]:
    """The parameters' kinds by their names."""
    return {each.name: each.kind for each in outcome.problem.parameters}


def of_parameters(outcome: Outcome) -> str:
    """The parameters found, or the range of their half-widths."""
    widths, unknowns, known = outcome.half_widths, outcome.result["unknowns"], kinds(outcome)
    if len(known) > NAMED:
        if not widths:
            return f"{len(known)} parameters"
        low, high = min(widths, key=widths.__getitem__), max(widths, key=widths.__getitem__)
        return f"{len(known)} parameters, ± {known[low].number(widths[low])} to {known[high].text(widths[high])}"
    return "<br>".join(
        (f"`{each}` " if len(known) > 1 else "")
        + kind.text(unknowns[each])
        + (f" ± {kind.text(widths[each])}" if widths else "")
        for each, kind in known.items()
    )


def error(outcome: Outcome) -> str:
    """The largest error of a parameter, by its range."""
    if not outcome.errors:
        return "-"
    ranges = {each.name: each.upper - each.lower for each in outcome.problem.parameters}
    worst = max(outcome.errors, key=lambda each: outcome.errors[each] / ranges[each])
    text = kinds(outcome)[worst].text(outcome.errors[worst])
    if len(outcome.errors) > 1:
        return f"{text} of `{worst}`"
    return f"{text} ({outcome.percent(outcome.errors):.2f} %)" if outcome.result["truth"][worst] else text


def of_paper(problem: str, paper: Paper) -> str:
    """What the paper reports of a problem, empty where nothing."""
    for each in paper.scenarios:
        if problem == f"friction-{each.name}":
            return f"{each.phi_estimated:.2f} deg ({each.phi_error_pct:.2f} %); runout {each.front_error_pct:.2f} %"
    if problem == "velocity-layers-10":
        own = paper.velocity
        return _losses(own.mse_mpm, own.mse_surrogate, own.mse_initial, own.iterations)
    if problem == "baffles-2":
        baffles = paper.baffles
        z = " and ".join(f"{value:.3f}" for value in baffles.z)
        losses = (baffles.loss_mpm, baffles.loss_surrogate, baffles.loss_initial)
        return f"z = {z} m; {_losses(*losses, baffles.iterations)}"
    return ""


def copy(result: Page, outcome: Outcome, picture: str, out: Path) -> None:
    """A picture of an outcome, beside the page."""
    source = outcome.folder / f"{picture}.png"
    if source.exists():
        target = f"{PICTURES}/{outcome.problem.name}-{picture}.png"
        with replacing(out / target) as part:
            part.write_bytes(source.read_bytes())
        result.text(f"{name(outcome)}, {picture}:")
        result.picture(target, picture)


def made(outcome: Outcome) -> dict[str, object]:
    """The command and machine of an outcome."""
    origin = outcome.origin
    command, day, machine = (
        (f"`{origin.command}`", origin.date, origin.machine) if origin else ("not recorded", "-", "-")
    )
    remark = "resumed: the total does not count what had run before" if origin and origin.resumed else ""
    return {"problem": name(outcome), "command": command, "date": day, "machine": machine, "": remark}


def _losses(mpm: float, surrogate: float, initial: float, iterations: int) -> str:
    return f"loss {mpm:.2e} (its surrogate {surrogate:.2e}, start {initial:.1e}), {iterations} iterations"
