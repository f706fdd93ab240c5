"""Sentences about the measurements: where one method gets cheaper than another, which method ends lowest."""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

from validation.bench.efficiency.records import (
    AD,
    AD_LONG,
    FD_GNS,
    FD_JITTER,
    FD_MPM,
    Cost,
    Gradient,
    MethodResult,
    OverParticles,
    OverUnknowns,
    Parts,
    ProblemResult,
)

SAME = 1.5
"""Losses whose ratio is less than this do not differ: a check run scatters too."""
PAPER_NODES, PAPER_BYTES = 20_000, 16.0e9
"""Where the paper's gradient no longer fits (its last figure and the discussion with it)."""
Curve = Sequence[tuple[float, float]]
"""Seconds over a number of unknowns or particles, ascending."""


def crossing(first: Curve, second: Curve) -> float:
    """The number from which on `first` stays below `second`; inf where it does not at the end, the least where always.

    Straight between measurements on logarithmic axes: log(a/b) is linear in log(n), so that between n0 and n1 the
    crossing is at log n = log n0 + (log n1 - log n0) r0 / (r0 - r1), with r = log(a/b) at both.
    """
    mine, others = dict(first), dict(second)
    ratios = [(n, math.log(mine[n] / others[n])) for n in sorted(mine.keys() & others.keys())]
    if not ratios or ratios[-1][1] >= 0.0:
        return math.inf
    steps = [pair for pair in pairwise(ratios) if pair[0][1] >= 0.0 > pair[1][1]]
    if not steps:
        return ratios[0][0]
    (n0, r0), (n1, r1) = steps[-1]
    return math.exp(math.log(n0) + r0 / (r0 - r1) * math.log(n1 / n0))


def cheaper(first: str, second: str, curves: dict[str, Curve], what: str) -> str:
    """From which number of `what` on the first method is the cheaper one."""
    at, (fewest, *_), most = crossing(curves[first], curves[second]), curves[first][0], curves[first][-1][0]
    if math.isinf(at):
        return f"{first} is not cheaper than {second} up to {most:,.0f} {what}"
    if at == fewest:
        return f"{first} is cheaper than {second} from {fewest:,.0f} to {most:,.0f} {what}"
    return f"{first} is cheaper than {second} from about {math.ceil(float(f'{at:.2g}')):,} {what} on"


def rounded(ratio: float) -> str:
    """Two digits that count."""
    return f"{float(f'{ratio:.2g}'):,g}"


def gradient_curve(over: OverUnknowns, method: str) -> Curve:
    """Seconds of a method over the unknowns."""
    return sorted((float(each.unknowns), each.seconds) for each in over.gradients if each.method == method)


def costs_of(over: OverParticles, method: str, unknowns: int) -> list[Cost]:
    """Costs of a method over the particles."""
    some = [each for each in over.costs if (each.method, each.unknowns) == (method, unknowns)]
    return sorted(some, key=lambda each: each.particles)


def unknowns_cost(over: OverUnknowns) -> str:
    """From how many unknowns on AD is cheaper."""
    curves = {method: gradient_curve(over, method) for method in (AD, FD_GNS, FD_MPM)}
    most = curves[AD][-1][0]
    percent = 100.0 * dict(curves[AD])[most] / dict(curves[FD_MPM])[most]
    texts = [cheaper(AD, other, curves, "unknowns") for other in (FD_GNS, FD_MPM)]
    return f"{'; '.join(texts)}; at {most:.0f} it takes {percent:.3g} % of the seconds of {FD_MPM}."


def unknowns_cosine(over: OverUnknowns) -> str:
    """How far the surrogate's gradient points the MPM's way, and how well the MPM's own is defined."""

    def cosines(method: str) -> dict[int, Gradient]:
        # One unknown has a sign and no direction.
        return {each.unknowns: each for each in over.gradients if each.method == method and each.unknowns > 1}

    pairs = [(number, each.cosine, cosines(FD_JITTER)[number].cosine) for number, each in cosines(AD).items()]
    texts = [f"{ad:.3f} at {number} unknowns (MPM with another jitter: {own:.3f})" for number, ad, own in pairs]
    return f"The cosine between the gradients of {AD} and {FD_MPM} is {', '.join(texts)}." if texts else ""


def particles_cost(over: OverParticles) -> str:
    """From how many particles on AD is cheaper, with few unknowns and with many."""
    texts = []
    for unknowns in sorted({each.unknowns for each in over.costs}):
        curves: dict[str, Curve] = {
            method: [(float(each.particles), each.seconds) for each in costs_of(over, method, unknowns)]
            for method in (AD, FD_GNS, FD_MPM)
        }
        found = "; ".join(cheaper(AD, other, curves, "particles") for other in (FD_GNS, FD_MPM))
        texts.append(f"with {unknowns} unknown{'s' if unknowns > 1 else ''} {found}")
    return f"Over the particles, {'; '.join(texts)}."


def particles_memory(over: OverParticles) -> list[str]:
    """Memory of the largest scene, and of the gradient through many steps beside the paper's limit."""
    most = max(each.particles for each in over.costs)
    largest = [each for each in over.costs if (each.particles, each.unknowns) == (most, 1)]
    texts = [f"{each.method} {each.memory / 1.0e9:.2g} GB" for each in largest if each.method != AD_LONG]
    return [f"Memory at {most:,} particles and one unknown: {', '.join(texts)}."] + [
        f"{AD_LONG}, of {each.nodes:,} nodes take {each.memory / 1.0e9:.2g} GB and {each.seconds / 60.0:.1f} minutes;"
        f" the paper's code exceeds {PAPER_BYTES / 1.0e9:g} GB at about {PAPER_NODES:,} nodes and up to 400 steps."
        for each in largest
        if each.method == AD_LONG
    ]


def lowest(result: ProblemResult, is_one: Callable[[MethodResult], bool] = lambda _: True) -> MethodResult:
    """The method that ends at the least MPM loss."""
    return min(filter(is_one, result.methods), key=lambda each: each.loss)


def best_of(result: ProblemResult) -> str:
    """Which method ends lowest on a problem, and which gets there first."""
    best = lowest(result)
    # Below the MPM's own scatter no answer is better than another.
    enough = SAME * max(best.loss, result.floor or 0.0)
    first = min(result.methods, key=lambda each: each.seconds_to(enough))
    ad = lowest(result, lambda each: each.method.startswith(AD))
    floor = "" if result.floor is None else f" (at the truth {result.floor:.1e})"
    return (
        f"Least MPM loss {best.loss:.1e}{floor} by {best.method}; first below {enough:.1e}: {first.method}, after"
        f" {first.seconds_to(enough):.2g} s; {AD} ends at {ad.loss:.1e}, {rounded(ad.loss / best.loss)} times the"
        " least."
    )


def problems_best(results: Sequence[ProblemResult]) -> str:
    """How often which model ends lowest, and how far the surrogate alone stays above it."""
    mpm = sum("MPM" in lowest(each).method for each in results)
    gns = [lowest(each, lambda row: "GNS" in row.method).loss / lowest(each).loss for each in results]
    ad = [lowest(each, lambda row: row.method.startswith(AD)).loss / lowest(each).loss for each in results]
    return (
        f"On {mpm} of {len(results)} problems a search by the MPM ends at the least MPM loss; the best by the GNS alone"
        f" ends at {rounded(min(gns))} to {rounded(max(gns))} times that loss, {AD} at {rounded(min(ad))} to"
        f" {rounded(max(ad))} times."
    )


def conclusion(parts: Parts) -> list[str]:
    """What the page says first."""
    found = []
    if parts.unknowns is not None:
        found += [unknowns_cost(parts.unknowns), unknowns_cosine(parts.unknowns)]
    if parts.particles is not None:
        found += [particles_cost(parts.particles), " ".join(particles_memory(parts.particles))]
    if parts.problems:
        found.append(problems_best(list(parts.problems.values())))
    return [sentence for sentence in found if sentence]
