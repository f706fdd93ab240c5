"""The section about seconds: from where on the surrogate is faster than the MPM, and at what error."""

from collections.abc import Sequence
from itertools import groupby
from math import ceil

from inverse.forward.gns import MEMORY_GIB
from validation.bench.speed.networks import SCENE
from validation.bench.surrogate.speed import ModelRun, MpmRun, WholeSecond
from validation.report.page import Page, Row, signed


def speed_section(text: Page, seconds: Sequence[WholeSecond], runs: Sequence[MpmRun]) -> None:
    """Seconds against the MPM's."""
    text.section("Speed against the MPM")
    text.text("One thread each, nothing beside it, without compilation.")
    if seconds:
        text.text(f"""
            One second of `{SCENE}`, median (minimum to maximum). The gradient is that of the mean position with respect
            to tan φ; {MEMORY_GIB:g} GiB of activations stay in memory. Differences of K unknowns take K + 1 runs of the
            MPM: the gradient is cheaper from the number of unknowns in the last column on.
        """)
        text.table(
            [
                {
                    "model": f"`{each.cost.name}`",
                    "nodes": each.cost.nodes,
                    "MPM [s]": each.mpm.written(2),
                    "forward [s]": each.cost.forward.written(2),
                    "with the gradient [s]": each.cost.gradient.written(2),
                    "forward over the MPM's": f"{each.cost.forward.median / each.mpm.median:.1f}",
                    "unknowns": max(1, ceil(each.cost.gradient.median / each.mpm.median - 1.0)),
                }
                for each in seconds
            ]
        )
    text.section("Over the resolution of the MPM", level=3)
    text.text("""
        The same flow by the MPM on coarser and finer cells, and larger and smaller columns on the same cells; the
        surrogate, from rest, at its own resolution. "Gain": the MPM's seconds over the surrogate's, bold above 1. The
        surrogate's front error is against that run of the MPM; "off the finest" is the MPM's own error.
    """)
    for _, alike in groupby(runs, key=lambda each: tuple(each.models)):
        group = list(alike)
        text.table([run_row(each, finest_of(group, each.series)) for each in group])
    text.text("\n".join(f"- {sentence}" for sentence in speed_said(runs)))


def finest_of(runs: Sequence[MpmRun], series: str) -> MpmRun:
    """The run on the finest cells of a series."""
    return min((each for each in runs if each.series == series), key=lambda each: each.cell)


def run_row(run: MpmRun, finest: MpmRun) -> Row:
    """One resolution of the MPM beside the models."""
    row = {
        "scene": run.series,
        "cell [mm]": f"{1000.0 * run.cell:.3g}",
        "particles": f"{run.particles:,}",
        "MPM [s]": f"{run.seconds:.2f}",
        "off the finest": "-" if run is finest else signed(run.front / finest.front - 1.0),
    }
    for name, each in run.models.items():
        gain = run.seconds / each.seconds
        row |= {
            f"`{name}`: nodes": f"{each.nodes:,}",
            f"`{name}` [s]": f"{each.seconds:.2f}",
            f"`{name}`: gain": f"**{gain:.2f}**" if gain > 1.0 else f"{gain:.2f}",
            f"`{name}`: front error": signed(each.front / run.front - 1.0),
        }
    return row


def speed_said(runs: Sequence[MpmRun]) -> list[str]:
    """Per series and model: from where on it is faster, and whether a coarser MPM has no larger error in less time."""
    said = []
    for series in dict.fromkeys(each.series for each in runs):
        group = [each for each in runs if each.series == series]
        finest = finest_of(runs, series)
        for name, each in finest.models.items():
            said.append(f"{series}, `{name}`: {_faster(group, each)}{_coarser(group, finest, each)}.")
    return said


def _faster(runs: Sequence[MpmRun], model: ModelRun) -> str:
    slower = [run for run in runs if run.seconds > model.seconds]
    if not slower:
        return "slower than the MPM" + (" throughout" if len(runs) > 1 else "")
    first = min(slower, key=lambda run: run.particles)
    error = signed(model.front / first.front - 1.0)
    return f"faster than the MPM from {first.particles:,} particles on (front {error} off that run's)"


def _coarser(runs: Sequence[MpmRun], finest: MpmRun, model: ModelRun) -> str:
    def error(front: float) -> float:
        return front / finest.front - 1.0

    # The finest run is the reference and so no alternative.
    better = [
        run
        for run in runs
        if run is not finest and run.seconds <= model.seconds and abs(error(run.front)) <= abs(error(model.front))
    ]
    if not better:
        return ""
    best = min(better, key=lambda run: run.seconds)
    return (
        f"; but the MPM on cells of {1000.0 * best.cell:.3g} mm takes {best.seconds:.2f} s, no longer, and its front is"
        f" no further from the finest ({signed(error(best.front))} against {signed(error(model.front))})"
    )
