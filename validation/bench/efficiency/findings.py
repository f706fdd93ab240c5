"""Sentences about the measurements: where one method gets cheaper than another, which method ends lowest."""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

from validation.bench.efficiency.records import (
    AD,
    AD_LONG,
    ADJOINT,
    ADJOINT_MEAN,
    FD_GNS,
    FD_JITTER,
    FD_MPM,
    JITTERS,
    Cost,
    Gradient,
    MethodResult,
    OverParticles,
    OverUnknowns,
    Parts,
    ProblemResult,
)

REVERSE = (AD, ADJOINT)
"""Methods whose gradient costs the same for any number of unknowns."""
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
    """Costs of a method over the particles, in 2D."""
    some = [each for each in over.costs if (each.method, each.unknowns, each.dimension) == (method, unknowns, 2)]
    return sorted(some, key=lambda each: each.particles)


def unknowns_cost(over: OverUnknowns) -> str:
    """From how many unknowns on AD is cheaper."""
    curves = {method: gradient_curve(over, method) for method in (AD, ADJOINT, FD_GNS, FD_MPM)}
    most = curves[AD][-1][0]
    parts = [f"{method} {100.0 * dict(curves[method])[most] / dict(curves[FD_MPM])[most]:.2g} %" for method in REVERSE]
    texts = [cheaper(*pair, curves, "unknowns") for pair in ((ADJOINT, FD_MPM), (AD, FD_MPM), (AD, ADJOINT))]
    return f"{'; '.join(texts)}; at {most:,.0f}, of the seconds of {FD_MPM}, {' and '.join(parts)}."


def unknowns_cosine(over: OverUnknowns) -> str:
    """How far the gradients by reverse mode point the MPM's way, and how well the MPM's own is defined."""

    def cosines(method: str) -> dict[int, Gradient]:
        # One unknown has a sign and no direction.
        return {each.unknowns: each for each in over.gradients if each.method == method and each.unknowns > 1}

    numbers = sorted(cosines(AD))
    if not numbers:
        return ""
    texts = [
        f"{method} {' / '.join(f'{cosines(method)[number].cosine:.3f}' for number in numbers)}"
        for method in (AD, ADJOINT, ADJOINT_MEAN, FD_JITTER)
    ]
    return (
        f"Cosine to {FD_MPM}, mean of {JITTERS} jitters, at {' / '.join(f'{number:,}' for number in numbers)}"
        f" unknowns: {'; '.join(texts)}."
    )


def particles_cost(over: OverParticles) -> str:
    """From how many particles on AD is cheaper, with few unknowns and with many."""
    texts = []
    for unknowns in sorted({each.unknowns for each in over.costs}):
        curves: dict[str, Curve] = {
            method: [(float(each.particles), each.seconds) for each in costs_of(over, method, unknowns)]
            for method in (AD, ADJOINT, FD_MPM)
        }
        pairs = ((ADJOINT, FD_MPM), (AD, FD_MPM), (AD, ADJOINT))
        found = "; ".join(cheaper(*pair, curves, "particles") for pair in pairs)
        texts.append(f"with {unknowns} unknown{'s' if unknowns > 1 else ''} {found}")
    return f"Over the particles, {'; '.join(texts)}."


def particles_memory(over: OverParticles) -> list[str]:
    """Memory of the largest scene, and of the gradient through many steps beside the paper's limit."""
    most = max(each.particles for each in over.costs)
    largest = [each for each in over.costs if (each.particles, each.unknowns, each.dimension) == (most, 1, 2)]
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
    enough = level(result)
    first = min(result.methods, key=lambda each: each.seconds_to(enough))
    ends = [
        (method, lowest(result, lambda each, method=method: each.method.startswith(method)))  # type: ignore[misc]
        for method in (AD, ADJOINT)
        if any(each.method.startswith(method) for each in result.methods)
    ]
    floor = "" if result.floor is None else f" (at the truth {result.floor:.1e})"
    texts = [
        f"; {method} ends at {each.loss:.1e}, {rounded(each.loss / best.loss)} times the least{arrival(each, enough)}"
        for method, each in ends
    ]
    return (
        f"Least MPM loss {best.loss:.1e}{floor} by {best.method}; first below {enough:.1e}: {first.method}, after"
        f" {first.seconds_to(enough):.2g} s{''.join(texts)}."
    )


def arrival(row: MethodResult, enough: float) -> str:
    """When a search got to a loss; empty where it did not."""
    seconds = row.seconds_to(enough)
    return "" if math.isinf(seconds) else f", there after {seconds:.2g} s"


def problems_best(results: Sequence[ProblemResult]) -> str:
    """Which method is first at the least loss of each problem."""
    firsts: dict[str, list[str]] = {}
    for result in results:
        enough = level(result)
        first = min(result.methods, key=lambda each: each.seconds_to(enough))
        firsts.setdefault(kind_of(first), []).append(f"{result.problem} {first.seconds_to(enough):.2g} s")
    texts = [f"{method} ({', '.join(where)})" for method, where in firsts.items()]
    return f"First within {SAME:g} times the least MPM loss: {'; '.join(texts)}."


def kind_of(row: MethodResult) -> str:
    """A method without the steps of its differences."""
    return ", ".join(["differences", *row.method.split(", ")[1:]] if "differences of" in row.method else [row.method])


def level(result: ProblemResult) -> float:
    """The loss below which no answer is better than another, by the MPM's own scatter."""
    return SAME * max(lowest(result).loss, result.floor or 0.0)


def surrogate_use(parts: Parts) -> str:
    """What the surrogate is for where the MPM has its own adjoint: how much cheaper its gradient is, and how good."""
    texts = []
    if parts.unknowns is not None:
        ours, theirs = (dict(gradient_curve(parts.unknowns, method)) for method in (AD, ADJOINT))
        ratios = [ours[number] / theirs[number] for number in ours]
        texts.append(f"its gradient takes {spread(ratios)} of the seconds of {ADJOINT} over the unknowns")
    if parts.particles is not None:
        pairs = zip(costs_of(parts.particles, AD, 1), costs_of(parts.particles, ADJOINT, 1), strict=True)
        texts.append(f"{spread([a.seconds / b.seconds for a, b in pairs])} over the particles")
    results = list(parts.problems.values())
    if results:
        there = [any(math.isfinite(row.seconds_to(level(each))) for row in by_gns(each)) for each in results]
        # A tenth of the way to the least loss, in digits, is a beginning for another search.
        near = [first_within(each, 10.0) for each in results]
        began = sum("GNS" in each.method for each in near)
        texts.append(
            f"by it alone {sum(there)} of {len(results)} problems end at the MPM's level, and on {began} it is first "
            "within ten times the least loss"
        )
    said = "; ".join(texts)
    return f"What the surrogate is for: {said}." if said else ""


def first_within(result: ProblemResult, factor: float) -> MethodResult:
    """The method that is first within `factor` of the least loss."""
    enough = factor * level(result) / SAME
    return min(result.methods, key=lambda each: each.seconds_to(enough))


def by_gns(result: ProblemResult) -> list[MethodResult]:
    """The searches by the surrogate alone."""
    return [each for each in result.methods if "GNS" in each.method]


def spread(values: Sequence[float]) -> str:
    """The least and the greatest of `values`."""
    lowest, highest = rounded(min(values)), rounded(max(values))
    return lowest if lowest == highest else f"{lowest} to {highest}"


def conclusion(parts: Parts) -> list[str]:
    """What the page says first."""
    found = []
    if parts.unknowns is not None:
        found.append(f"{unknowns_cost(parts.unknowns)} {unknowns_cosine(parts.unknowns)}".strip())
    if parts.particles is not None:
        found += [particles_cost(parts.particles), " ".join(particles_memory(parts.particles))]
    if parts.problems:
        found.append(problems_best(list(parts.problems.values())))
    return [sentence for sentence in [*found, surrogate_use(parts)] if sentence]
