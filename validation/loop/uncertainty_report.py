"""The section of a report on uncertainty: scatter of the MPM, discrepancy, and what the observation constrains."""

import math

from inverse.parameters import Kind
from inverse.report.markdown import markdown_table
from inverse.result import Combination, Identifiability
from validation.loop.result import Result
from validation.loop.uncertainty import Uncertainty

MAIN = 0.3
"""A parameter with less than this share of the greatest weight is not named as part of a combination."""


def uncertainty_section(result: Result, uncertainty: Uncertainty) -> list[str]:
    """Its paragraphs and tables."""
    observation, count = result.target.observation, len(result.unknowns)
    scatter = observation.distance_text(uncertainty.misfit_scatter)
    if result.problem.target.minimise:
        return of_design(result, uncertainty)
    parts = [
        f"{len(uncertainty.runs)} MPM runs, {len(uncertainty.at_centre)} of them at one place and the others on either "
        f"side of it, measure slopes and scatter: two runs that differ in their jitter seed alone differ by {scatter} "
        "(root mean square). The target scatters like one run. The half-widths are at 95 %."
    ]
    if result.target.roughness > 1.0:
        parts.append(
            f"The measured heights scatter about their neighbours by {result.target.roughness:.2g} times the stated "
            "noise: so much noise is counted."
        )
    parts.append(of_fit(uncertainty))
    if count == 1:
        (each,) = result.problem.parameters
        slope = observation.change_text(float(uncertainty.slopes[0]), sign=observation.scalar)
        chance = observation.change_text(float(uncertainty.scatter[0]), sign=False)
        text = f"The observation changes by {slope} per {each.kind.unit} of `{each.name}` and scatters by {chance}."
        if uncertainty.half_widths[0] >= each.upper - each.lower:
            text += " The slope is no larger than its own scatter."
        parts.append(text)
    if result.identifiability:
        parts.append(effects(result, result.identifiability))
        if count > 1:
            parts += combinations(result.identifiability)
    return [part for part in parts if part]


def of_fit(uncertainty: Uncertainty) -> str:
    """Residuals compared with noise and scatter, and the consequence for the half-widths."""
    known = uncertainty.discrepancy
    if known is None:
        return ""
    compared = f"The residuals of {known.numbers} numbers are {known.ratio:.2g} times what noise and scatter explain"
    if known.factor == 1.0:
        return f"{compared} (p = {known.probability:.2g}): the half-widths stay."
    return f"**{compared}** (p = {known.probability:.1g}): each half-width is {known.factor:.2g} times wider for it."


def effects(result: Result, known: Identifiability) -> str:
    """The effect of errors of the observation on each parameter (one standard deviation), and its half-width."""
    noisy = result.target.noise > 0.0
    rows = []
    for each in result.problem.parameters:
        name, kind = each.name, each.kind
        row = {"parameter": f"`{name}`"}
        if known.half_a_cell:
            row["half a cell in each number observed"] = limited(kind, known.half_a_cell[name])
        row["scatter of the MPM"] = limited(kind, known.scatter[name])
        if noisy:
            row["noise of the measurement"] = limited(kind, known.noise[name])
        row["all together, 95 %"] = f"± {kind.text(result.certainty[name])}" if result.certainty else "-"
        rows.append(row)
    return markdown_table(list(rows[0]), [list(row.values()) for row in rows])


def combinations(known: Identifiability) -> list[str]:
    """Which combinations of the parameters the observation constrains."""
    values = ", ".join(f"{each.singular_value:.3g}" for each in known.combinations)
    parts = [
        "Singular values of the Jacobian, per range of the parameters and in standard deviations of scatter and noise, "
        f"of the combination constrained best to that constrained worst: {values}."
    ]
    unknown = [each for each in known.combinations if not each.identifiable]
    if not unknown:
        last = known.combinations[-1]
        return [*parts, f"All combinations are identifiable; the worst is {mix(last)}, to ± {share(last.half_width)}."]
    lines = [f"- **Not identifiable**: {mix(each)}, {poorly(each)}." for each in unknown]
    lines += [f"- **Identifiable**: {each}." for each in constrained_combinations(known)]
    heavy = sorted({name for each in unknown for name in main_weights(each)})
    parts.append("\n".join(lines))
    return [
        *parts,
        f"The values of {', '.join(f'`{name}`' for name in heavy)} are those of one answer. Others may fit far from it "
        "along what is not identifiable, which its half-widths do not include: `optimiser.starts` searches for them.",
    ]


def poorly(combination: Combination) -> str:
    """How poorly a combination is constrained."""
    width = combination.half_width
    return f"only to ± {share(width)} of the range" if width < 2.0 else "not at all"


def constrained(result: Result) -> list[str]:
    """The combinations that the observation constrains, in words; best first."""
    return [] if result.identifiability is None else constrained_combinations(result.identifiability)


def constrained_combinations(known: Identifiability) -> list[str]:
    """The same of what is known."""
    return [
        f"{mix(each)} to ± {share(each.half_width)} of the range" for each in known.combinations if each.identifiable
    ]


def mix(combination: Combination) -> str:
    """A combination in words: which parameters go up, and which go down with them."""
    heavy = main_weights(combination)
    up = [f"`{name}`" for name, weight in heavy.items() if weight > 0.0]
    down = [f"`{name}`" for name, weight in heavy.items() if weight <= 0.0]
    if not down:
        return " and ".join(up) + (" up or down together" if len(up) > 1 else "")
    return f"{' and '.join(up)} up while {' and '.join(down)} down"


def of_design(result: Result, uncertainty: Uncertainty) -> list[str]:
    """How closely each parameter of a design has to be kept."""
    text = result.target.observation.change_text
    rows = [
        [f"`{each.name}`", f"± {each.kind.text(width)}", f"{text(slope)} per {each.kind.unit}"]
        for each, width, slope in zip(
            result.problem.parameters, uncertainty.half_widths.tolist(), uncertainty.slopes.tolist(), strict=True
        )
    ]
    scatter = text(float(uncertainty.scatter[0]), sign=False)
    return [
        f"A design has no truth. {len(uncertainty.runs)} MPM runs around it measure its tolerances: what passes "
        f"scatters by {scatter} with the initial jitter alone. Each parameter may move by its half-width, the others "
        "as they are, before the MPM distinguishes it from that.",
        markdown_table(["parameter", "may move by", "what passes changes by"], rows),
    ]


def main_weights(combination: Combination) -> dict[str, float]:
    """The weights that are not small."""
    greatest = max(abs(weight) for weight in combination.weights.values())
    return {name: weight for name, weight in combination.weights.items() if abs(weight) >= MAIN * greatest}


def limited(kind: Kind, value: float) -> str:
    """A standard deviation of a parameter."""
    return f"± {kind.text(value)}" if math.isfinite(value) and value < 1e6 else "no limit"


def share(value: float) -> str:
    """A share of a range."""
    return f"{100.0 * value:.2g} %" if value < 1.0 else f"{value:.1f} times"
