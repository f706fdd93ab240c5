"""What an answer is worth, in plain words: how certain each unknown is, and what the observation cannot tell apart."""

import math

from inverse.parameters.parameters import kind
from inverse.problem import Observable
from inverse.report.markdown import code, length, quantity, table
from inverse.result import Combination, Identifiability, Result
from validation.loop.certainty import Certainty

HEAVY = 0.3
"""An unknown with less than this share of the greatest weight is not named as part of a combination."""


def words(result: Result, certainty: Certainty) -> list[str]:
    """The section of the report."""
    lines = ["## What it is worth", ""]
    if result.problem.target.least:
        return [*lines, *of_design(result, certainty), ""]
    extra = len(certainty.runs)
    lines += [
        f"{extra} more MPM runs at the answer and beside it, with {len(certainty.here)} jitter seeds at it, say how "
        f"much the MPM scatters by chance: {scatter(result, certainty)}. The target is one such flow as well. "
        "Each half-width is meant to hold the truth 95 times in 100.",
        "",
    ]
    if result.target.roughness > 1.0:
        lines += [
            f"The measured heights scatter about their neighbours by {result.target.roughness:.2g} times the stated "
            "noise: so much noise is counted.",
            "",
        ]
    lines += of_discrepancy(certainty)
    if len(result.unknowns) == 1:
        lines += of_one(result, certainty)
    if result.identifiability:
        lines += ["", *table(*errors(result, result.identifiability)), ""]
        if len(result.unknowns) > 1:
            lines += combinations(result, result.identifiability)
    return [*lines, ""]


def scatter(result: Result, certainty: Certainty) -> str:
    """How far two runs at the answer are apart."""
    match result.problem.observation.kind:
        case Observable.FRONT | Observable.RUNOUT | Observable.PROFILE:
            what = f"{100.0 * certainty.misfit:.2g} % of the {result.problem.observation.kind}"
        case Observable.TOE:
            what = f"{length(certainty.misfit)} in the toe"
        case Observable.DEPOSIT:
            what = f"{length(certainty.misfit)} in the place of a point (root mean square)"
        case Observable.PASSED:
            what = f"{100.0 * certainty.misfit:.2g} % of the material"
        case Observable.SEVERAL:
            what = f"{certainty.misfit:.2g} standard deviations (root mean square over the numbers)"
    return f"two runs that differ in nothing but the jitter are {what} apart"


def of_discrepancy(certainty: Certainty) -> list[str]:
    """How the fit compares with what noise and chance allow, and what that does to the half-widths."""
    known = certainty.discrepancy
    if known is None:
        return []
    compared = (
        f"The {known.numbers} numbers compared are {known.ratio:.2g} times as far from the MPM as the stated noise "
    )
    compared += "and the chance of two flows let expect"
    if known.factor == 1.0:
        return [f"{compared}: chance explains that (p = {known.probability:.2g}).", ""]
    return [
        f"**The model fits worse than the noise allows**: {compared[0].lower()}{compared[1:]} "
        f"(p = {known.probability:.1g}). Each half-width is {known.factor:.2g} times wider for it.",
        "",
    ]


def told_combinations(result: Result) -> list[str]:
    """What of the unknowns the observation tells, each combination in words; best known first."""
    known = result.identifiability.combinations if result.identifiability else []
    return [f"{mix(each)} to ± {_share(each.half_width)} of the range" for each in known if each.told]


def of_one(result: Result, certainty: Certainty) -> list[str]:
    """How the observation moves with a single unknown."""
    ((name, calibration),) = certainty.calibrations.items()
    (unknown,) = result.problem.unknowns
    moves = f"{1e3 * calibration.slope:+.3g} mm per {kind(name).unit} of `{name}`"
    chance = f"{1e3 * calibration.scatter:.2g} mm"
    if result.problem.observation.kind is Observable.PASSED:
        moves = f"{100.0 * calibration.slope:+.3g} % of the material per {kind(name).unit} of `{name}`"
        chance = f"{100.0 * calibration.scatter:.2g} %"
    lines = [f"Near the answer the observation moves by {moves} and scatters by {chance} from run to run."]
    if result.problem.observation.kind is Observable.SEVERAL:
        moves = f"{calibration.slope:+.3g} standard deviations per {kind(name).unit} of `{name}`"
        chance = f"{calibration.scatter:.2g}"
    if calibration.half_width >= unknown.upper - unknown.lower:
        lines += [f"The slope drowns in the scatter: this observation does not tell `{name}` within its bounds."]
    return lines


def errors(result: Result, known: Identifiability) -> tuple[list[str], list[list[str]]]:
    """What an error of the observation means for each unknown (one standard deviation), and the half-width of all."""
    noisy = result.target.noise > 0.0
    head = ["unknown", *(["half a cell in each number observed"] if known.half_a_cell else [])]
    head += ["the MPM's scatter", *(["the measurement's noise"] if noisy else []), "all together, 95 %"]
    rows = []
    for name in result.unknowns:
        row = [f"`{name}`", *([_about(name, known.half_a_cell[name])] if known.half_a_cell else [])]
        row += [_about(name, known.scatter[name]), *([_about(name, known.noise[name])] if noisy else [])]
        rows.append([*row, f"± {quantity(name, result.certainty[name])}" if result.certainty else "-"])
    return head, rows


def combinations(result: Result, known: Identifiability) -> list[str]:
    """Which combinations of the unknowns the observation tells, and which it does not."""
    hidden = [each for each in known.combinations if not each.told]
    values = ", ".join(f"{each.singular_value:.3g}" for each in known.combinations)
    lines = [
        "What a step of the whole range does to the observation, over its scatter and noise (singular values, of the "
        f"combination known best to that known least): {values}.",
        "",
    ]
    if not hidden:
        least = known.combinations[-1]
        lines += [
            f"The observation tells all {len(known.combinations)} combinations of the unknowns. It knows least of "
            f"{mix(least)}: to ± {_share(least.half_width)} of the range."
        ]
        return lines
    for each in hidden:
        how = f"only to ± {_share(each.half_width)} of the range" if each.half_width < 2.0 else "not at all"
        lines += [f"- **Not told**: {mix(each)}, {how}."]
    if len(hidden) == len(known.combinations):
        return [*lines, "", "It tells nothing of the unknowns."]
    lines += [f"- **Told**: {each}." for each in told_combinations(result)]
    heavy = {name for each in hidden for name in _heavy(each)}
    lines += [
        "",
        f"Single values of {', '.join(code(sorted(heavy)))} are to be read with that in mind. Far away along what is "
        "not told may lie other answers; the half-widths are of this one alone: `optimiser.starts` looks for others.",
    ]
    return lines


def mix(combination: Combination) -> str:
    """A combination in words: what goes up, and what goes down with it."""
    heavy = _heavy(combination)
    up = [name for name, weight in heavy.items() if weight > 0.0]
    down = [name for name, weight in heavy.items() if weight <= 0.0]
    if not down:
        return " and ".join(code(up)) + (" up or down together" if len(up) > 1 else "")
    return f"{' and '.join(code(up))} up while {' and '.join(code(down))} down"


def of_design(result: Result, certainty: Certainty) -> list[str]:
    """How closely each unknown of a design has to be met."""
    share = 100.0 * next(iter(certainty.calibrations.values())).scatter
    lines = [
        f"A design has no truth. {len(certainty.runs)} more MPM runs around it say how closely it has to be kept: what "
        f"passes scatters by {share:.2g} % of the material with the initial jitter alone. Each unknown may move by its "
        "half-width, the others as they are, before the MPM tells the difference.",
        "",
    ]
    rows = [
        [f"`{name}`", f"± {quantity(name, each.half_width)}", f"{100.0 * each.slope:+.3g} % per {kind(name).unit}"]
        for name, each in certainty.calibrations.items()
    ]
    return [*lines, *table(["unknown", "may move by", "what passes changes by"], rows)]


def _heavy(combination: Combination) -> dict[str, float]:
    greatest = max(abs(weight) for weight in combination.weights.values())
    return {name: weight for name, weight in combination.weights.items() if abs(weight) >= HEAVY * greatest}


def _about(name: str, value: float) -> str:
    return f"± {quantity(name, value)}" if math.isfinite(value) and value < 1e6 else "no limit"


def _share(value: float) -> str:
    return f"{100.0 * value:.2g} %" if value < 1.0 else f"{value:.1f} times"
