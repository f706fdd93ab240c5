"""The section about seconds: where the surrogate is faster than the MPM, at what error, and where it is not."""

import math
from collections.abc import Sequence
from itertools import groupby

from inverse.forward.gns import MEMORY_GIB
from inverse.report.markdown import table
from validation.bench.accuracy.page import paragraph, signed
from validation.bench.surrogate.figures import bold, holds
from validation.bench.surrogate.models import Model
from validation.bench.surrogate.races import TALL, Race, WholeSecond
from validation.report.machine import GNS, MPM, machine


def text(second: WholeSecond | None, races: Sequence[Race], models: Sequence[Model], rounds: int) -> list[str]:
    """The section."""
    lines = [
        "## Speed against the MPM",
        "",
        *paragraph(f"{machine(MPM | GNS)}. One thread each, nothing beside it; compilation apart."),
    ]
    if second is not None:
        lines += whole_second(second, [model for model in models if model.settings.dimension == 2], rounds)
    return [*lines, *against(races)]


def whole_second(second: WholeSecond, models: Sequence[Model], rounds: int) -> list[str]:
    """The table of the tall column, and from how many unknowns the gradient is the cheaper one."""
    rows = [["MPM", "-", second.mpm.written(2), "", "-", "", "-", "-"]]
    words = []
    for model in models:
        name, bars = model.name, model.bars
        forward, gradient = second.forward[name], second.gradient[name]
        unknowns = max(1, math.ceil(gradient.middle / second.mpm.middle - 1.0))
        rows.append(
            [
                f"`{name}`",
                str(second.points[name]),
                forward.written(2),
                f"{bars.forward:g} s {holds(forward.middle, bars.forward)}",
                gradient.written(2),
                f"{bars.gradient:g} s {holds(gradient.middle, bars.gradient)}",
                f"{forward.middle / second.mpm.middle:.1f}",
                str(second.kept_steps[name]),
            ]
        )
        words.append(f"for `{name}` from {unknowns} unknowns on")
    head = ["", "points", "forward [s]", "bar", "with the gradient [s]", "bar", "forward over the MPM's"]
    return [
        *paragraph(f"""
            The whole second of `{TALL}` (the MPM: 3,200 points), timed in turn, median of {rounds} (least to greatest).
            The gradient is that of the front with respect to tan φ; {MEMORY_GIB:g} GiB of activations may stay in
            memory, those of the kept steps; the others are computed again.
        """),
        *table([*head, "kept steps"], rows),
        "",
        *paragraph(f"""
            The MPM has no gradient; differences of K unknowns take K + 1 of its runs. At these seconds the surrogate's
            gradient, which costs the same for any number of them, is the cheaper one {" and ".join(words)}.
        """),
    ]


def against(races: Sequence[Race]) -> list[str]:
    """A line per resolution of the MPM, and per series what it comes to."""
    rows, words = [], []
    for _, group in groupby(races, key=lambda each: each.series):
        series = list(group)
        finest = min(series, key=lambda each: each.cell)
        for each in series:
            own = "-" if each is finest else signed(each.front / finest.front - 1.0)
            cells = []
            for lap in each.laps.values():
                faster = each.seconds / lap.seconds
                cells += [
                    f"{lap.points:,}",
                    f"{lap.seconds:.2f}",
                    bold(f"{faster:.2f}", faster > 1.0),
                    signed(lap.front / each.front - 1.0),
                ]
            row = [each.series, f"{1000.0 * each.cell:.3g}", f"{each.points:,}", f"{each.seconds:.2f}", own]
            rows.append((tuple(each.laps), row + cells))
        words += worth(series, finest)
    lines = [
        "### When it pays",
        "",
        *paragraph("""
            The same flow by the MPM on coarser and finer cells, and larger and smaller columns on the same cells; the
            surrogate, from rest, always at its own resolution. "Gain": the MPM's seconds over the surrogate's, bold
            where the surrogate is the faster. The surrogate's error is that of its front from the front of that run of
            the MPM; it learned from the MPM at its data's cells, so beside a finer MPM it has the grid's error as well;
            where the two cancel, that is luck.
            "Off the finest" is the MPM's own: what its cells cost.
        """),
    ]
    for names, some in groupby(rows, key=lambda each: each[0]):
        head = ["scene", "MPM: cell [mm]", "points", "seconds", "off the finest"]
        for name in names:
            head += [f"`{name}`: points", "seconds", "gain", "front error"]
        lines += [*table(head, [row for _, row in some]), ""]
    return [*lines, *words, ""]


def worth(series: Sequence[Race], finest: Race) -> list[str]:
    """A sentence per model: from where on it is faster, and whether a coarser MPM does as well for less."""
    said = []
    for name, lap in finest.laps.items():
        slower = [each for each in series if each.seconds > lap.seconds]
        error = abs(lap.front / finest.front - 1.0)
        # The run of the MPM that is compared is itself the reference: it cannot be its own rival.
        rivals = [
            each
            for each in series
            if each is not finest and each.seconds <= lap.seconds and abs(each.front / finest.front - 1.0) <= error
        ]
        if not slower:
            sentence = "slower than the MPM" + (" throughout" if len(series) > 1 else "")
        else:
            first = min(slower, key=lambda each: each.points)
            gain = signed(lap.front / first.front - 1.0)
            sentence = f"faster than the MPM from {first.points:,} points on (front {gain} off that run's)"
        if rivals:
            best = min(rivals, key=lambda each: each.seconds)
            sentence += (
                f"; but the MPM on cells of {1000.0 * best.cell:.3g} mm takes {best.seconds:.2f} s, no longer than it, "
                f"and is no further from the finest ({signed(best.front / finest.front - 1.0)} against "
                f"{signed(lap.front / finest.front - 1.0)})"
            )
        said.append(f"- {finest.series}, `{name}`: {sentence}.")
    return said
