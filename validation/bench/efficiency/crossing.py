"""Where one method gets cheaper than another, and what follows from it in words."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from validation.bench.efficiency.cuts import AD, AGAIN, FD_GNS, FD_MPM
from validation.bench.efficiency.rows import Cost, Gradient, Race

BESIDE = 1.5
"""Losses whose ratio is less than this are as good as each other: a check run scatters too."""
Curve = Sequence[tuple[float, float]]
"""Seconds or bytes over a number of unknowns or points, ascending."""


@dataclass(frozen=True, kw_only=True)
class Crossing:
    """Where a first method gets cheaper than a second, as the number grows."""

    first: float
    """The least number from which on it is; nan where it never is in the range."""
    everywhere: bool
    """Whether it is from the start of the range on."""

    @property
    def never(self) -> bool:
        """Whether it is not, even at the end of the range."""
        return math.isnan(self.first)


def crossing(first: Curve, second: Curve) -> Crossing:
    """Where `first` gets and stays below `second`: straight between measurements on logarithmic axes.

    log(a/b) is linear in log(n) there, so that the crossing between n0 and n1 is at
    log n = log n0 + (log n1 - log n0) r0 / (r0 - r1), with r = log(a/b) at both.
    """
    mine, others = dict(first), dict(second)
    shared = sorted(mine.keys() & others.keys())
    ratios = [(n, math.log(mine[n] / others[n])) for n in shared]
    if not ratios or ratios[-1][1] >= 0.0:
        return Crossing(first=math.nan, everywhere=False)
    if all(ratio < 0.0 for _, ratio in ratios):
        return Crossing(first=ratios[0][0], everywhere=True)
    (n0, r0), (n1, r1) = [pair for pair in pairwise(ratios) if pair[0][1] >= 0.0 > pair[1][1]][-1]
    share = r0 / (r0 - r1)
    return Crossing(first=math.exp(math.log(n0) + share * math.log(n1 / n0)), everywhere=False)


def seconds_over_unknowns(gradients: Sequence[Gradient], method: str) -> list[tuple[float, float]]:
    """Seconds of a method over the unknowns."""
    return sorted((float(each.unknowns), each.seconds) for each in gradients if each.method == method)


def costs_over_points(costs: Sequence[Cost], method: str, unknowns: int) -> list[tuple[float, Cost]]:
    """What a method costs over the points."""
    some = [each for each in costs if (each.method, each.unknowns) == (method, unknowns)]
    return sorted(((float(each.points), each) for each in some), key=lambda pair: pair[0])


def said(found: Crossing, cheaper: str, dearer: str, what: str, most: float, *, whole: bool) -> str:
    """A crossing in a sentence; `what` is counted, up to `most`. whole: in whole numbers."""
    if found.never:
        return f"{cheaper} is not cheaper than {dearer} at any number of {what} up to {most:,.0f}."
    if found.everywhere:
        return f"{cheaper} is cheaper than {dearer} at every number of {what} from {found.first:,.0f} to {most:,.0f}."
    number = math.ceil(round(found.first, 6)) if whole else float(f"{found.first:.2g}")
    return f"{cheaper} is cheaper than {dearer} from about {number:,.0f} {what} on."


def unknowns_said(gradients: Sequence[Gradient]) -> list[str]:
    """What the cuts of one heap tell."""
    most = max(each.unknowns for each in gradients)
    curves = {method: seconds_over_unknowns(gradients, method) for method in (AD, FD_GNS, FD_MPM)}
    lines = [
        said(crossing(curves[AD], curves[other]), AD, other, "unknowns", most, whole=True) for other in (FD_GNS, FD_MPM)
    ]
    ratio = dict(curves[AD])[most] / dict(curves[FD_MPM])[most]
    lines.append(f"At {most} unknowns {AD} takes {100.0 * ratio:.3g} % of the seconds of {FD_MPM}.")
    worth = []
    for unknowns in sorted({each.unknowns for each in gradients}):
        cosines = {each.method: each.cosine for each in gradients if each.unknowns == unknowns}
        by_ad, again = cosines.get(AD), cosines.get(AGAIN)
        # One unknown has a sign and no direction.
        if unknowns > 1 and by_ad is not None and again is not None:
            worth.append(f"{by_ad:.3f} at {unknowns} unknowns (two jitters of the MPM: {again:.3f})")
    if worth:
        lines.append(f"The cosine between {AD} and {FD_MPM} is {', '.join(worth)}.")
    return lines


def points_said(costs: Sequence[Cost]) -> list[str]:
    """What the sizes of one column tell."""
    most = max(each.points for each in costs)
    lines = []
    for unknowns in sorted({each.unknowns for each in costs}):
        curves = {
            method: [(points, cost.seconds) for points, cost in costs_over_points(costs, method, unknowns)]
            for method in (AD, FD_GNS, FD_MPM)
        }
        counted = f"With {unknowns} unknown{'s' if unknowns > 1 else ''}: "
        for other in (FD_GNS, FD_MPM):
            found = crossing(curves[AD], curves[other])
            reverse = crossing(curves[other], curves[AD])
            if found.never and not reverse.everywhere:
                lines.append(counted + said(reverse, other, AD, "points", most, whole=False))
            else:
                lines.append(counted + said(found, AD, other, "points", most, whole=False))
    largest = {each.method: each for each in costs if each.points == most and each.unknowns == 1}
    memory = ", ".join(f"{method} {each.memory / 1.0e9:.2g} GB" for method, each in largest.items())
    lines.append(f"Memory at {most:,} points and one unknown: {memory}.")
    return lines


def race_said(race: Race) -> list[str]:
    """Who wins a race, and who was there soonest."""
    rows = list(race.rows)
    best = min(rows, key=lambda row: row.loss)
    # Below the MPM's own scatter no answer is better than another.
    enough = BESIDE * max(best.loss, race.floor or 0.0)
    good = [row for row in rows if row.loss <= enough]
    soonest = {row.method: first_below(race, row.method, enough) for row in good}
    name = min(soonest, key=lambda method: soonest[method])
    lines = [f"{race.problem}: least loss in the MPM {best.loss:.1e} by {best.method}."]
    if race.floor is not None:
        lines.append(f"The truth itself shows {race.floor:.1e}.")
    which = "least" if race.floor is None else "greater of the two"
    lines.append(f"First within {BESIDE:g} times the {which}: {name}, after {soonest[name]:.2g} s.")
    by_ad = min((row for row in rows if row.method.startswith(AD)), key=lambda row: row.loss, default=None)
    if by_ad is not None and by_ad not in good:
        lines.append(f"{by_ad.method} stays at {by_ad.loss:.1e}, {by_ad.loss / best.loss:.2g} times the least.")
    return lines


def first_below(race: Race, method: str, value: float) -> float:
    """Seconds until a method's answer showed at most `value` in the MPM for good."""
    row = next(row for row in race.rows if row.method == method)
    after = math.inf
    for each in reversed(row.curve):
        if each.loss > value:
            break
        after = each.seconds
    return after


def leaders(race: Race, seconds: Sequence[float]) -> Mapping[float, tuple[str, float] | None]:
    """At each time: the method whose answer by then shows the least loss, and that loss; None before any answer."""
    found: dict[float, tuple[str, float] | None] = {}
    for time in seconds:
        known = [(row.method, value) for row in race.rows if (value := row.by(time)) is not None]
        found[time] = min(known, key=lambda pair: pair[1], default=None)
    return found
