"""The section of a report on uncertainty: what the half-widths are made of, and which combinations are identifiable."""

from inverse.result import Combination
from validation.loop.result import Result

MAIN = 0.3
"""A parameter with less than this share of the greatest weight is not named as part of a combination."""


def uncertainty(result: Result) -> list[str]:
    """What the half-widths are made of."""
    state, first = result.outcome.state, result.outcome.answers[0]
    found, observation = state.posterior, result.target.observation
    scatter = observation.distance_text(first.scatter(state.task))
    parts = [
        f"An emulator of {int(found.near.sum())} of the {len(state.runs)} MPM runs, each with a jitter seed of its "
        f"own, gives the posterior over the whole box (uniform prior between the bounds). Two runs at the answer "
        f"differ by {scatter} (root mean square); the target scatters like one. What the emulator does not know is "
        f"{100.0 * found.emulator_share:.2g} % of the variance, and part of the half-widths, which are at 95 %. "
        f"Two independent populations of samples differ by {found.samples.difference:.2g} standard deviations."
    ]
    if result.problem.target.minimise:
        parts[0] = (
            "A design has no truth. Each parameter may move by its half-width, the others with it, before the MPM "
            f"distinguishes what passes from its scatter; {parts[0][0].lower()}{parts[0][1:]}"
        )
        return parts
    if result.target.roughness > 1.0:
        parts.append(
            f"The measured heights scatter about their neighbours by {result.target.roughness:.2g} times the stated "
            "noise: so much noise is counted."
        )
    if state.discretisation is not None:
        change = observation.distance_text(
            observation.distance(first.observation + state.discretisation, first.observation)
        )
        parts.append(
            f"Cells twice as large change the observation by {change}; so much is counted as the error of the cells, "
            "as the target is no flow on them."
        )
    fit = result.outcome.discrepancy
    if fit is not None:
        text = f"The residuals of {fit.numbers} numbers are {fit.ratio:.2g} times what noise and scatter explain"
        text = f"{text} (p = {fit.probability:.2g})" if fit.factor == 1.0 else f"**{text}** (p = {fit.probability:.1g})"
        parts.append(f"{text}: {'the half-widths stay' if fit.factor == 1.0 else 'errors are counted so much larger'}.")
    if len(result.unknowns) > 1:
        lines = [
            f"- {'**Identifiable**' if each.identifiable else '**Not identifiable**'}: {mix(each)}, "
            f"to ± {100.0 * each.half_width:.2g} % of the range."
            for each in result.combinations
        ]
        parts.append("\n".join(lines))
    return parts


def mix(combination: Combination) -> str:
    """A combination in words: which parameters go up, and which go down with them."""
    greatest = max(abs(weight) for weight in combination.weights.values())
    heavy = {name: weight for name, weight in combination.weights.items() if abs(weight) >= MAIN * greatest}
    up = [f"`{name}`" for name, weight in heavy.items() if weight > 0.0]
    down = [f"`{name}`" for name, weight in heavy.items() if weight <= 0.0]
    if not down:
        return " and ".join(up) + (" up or down together" if len(up) > 1 else "")
    return f"{' and '.join(up)} up while {' and '.join(down)} down"
