"""`python -m validation.bench experiments`: measured flows at angles of friction measured by themselves, and back."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from datasets.flow.trajectory import Trajectory
from mpm import AT_REST
from validation.bench.page import Keep, Out, emphasised, kept, percent, signed, write_page
from validation.experiments.experiment import (
    FOLDER,
    Angle,
    Measured,
    MeasuredScene,
    Quantity,
    Reading,
    Shipped,
    quantity,
    read_experiments,
)
from validation.plots import BLUE, INK, LIGHT_BLUE, figure
from validation.runs import Run, RunStore

CLOSE = 2.0
"""Spreads within which a number agrees."""
LADDER_DEG = (16.0, 20.0, 24.0, 28.0, 32.0)
"""Angles at which every case is run on its coarse cells: the slope of its front."""
INFERRED = "inferred"
"""Name of an angle that comes from the experiment itself."""
RECORDED = 5
"""Frames from one to the next of a flow that is measured over time."""

Simulate = Callable[[Sequence[Run]], Sequence[Trajectory]]
"""Runs to their flows, as `validation.runs.RunStore.run`."""
Asked = tuple[Shipped, MeasuredScene, Reading]
Flows = dict[Asked, Callable[[Measured], float]]
"""What is measured of a flow [m], by experiment, case and reading."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """A measured number beside the computed one."""

    label: str
    """Experiment, case, quantity."""
    measured: Measured
    angle: str
    """Such as 22.0° (repose, μ(I))."""
    independent: bool
    """Whether the angle was measured by itself, not inferred from this experiment."""
    coarse: float
    """Computed on the coarse cells [m]; nan where there was no such run."""
    fine: float
    """On the fine cells [m]; the coarse one's for another angle than the first."""

    @property
    def error(self) -> float:
        """Computed on the fine cells less measured, in spreads [-]."""
        return (self.fine - self.measured.value) / self.measured.spread

    @property
    def agrees(self) -> bool:
        """Whether it is within CLOSE times the spread."""
        return abs(self.error) <= CLOSE


@dataclass(frozen=True, kw_only=True)
class Inferred:
    """The angle at which the front is the measured one, beside the material's own."""

    label: str
    """Experiment and case."""
    own: Angle | None
    """The material's; None where none was measured."""
    deg: float
    """On the fine cells [deg]; nan where no angle gives what was measured."""
    half_width_deg: float
    """By CLOSE times the measurement's spread [deg]."""

    @property
    def difference_deg(self) -> float:
        """Inferred less measured [deg]; nan where either is missing."""
        return math.nan if self.own is None else self.deg - self.own.deg

    @property
    def agrees(self) -> bool:
        """Whether the two ranges overlap; False where either is missing."""
        return self.own is not None and abs(self.difference_deg) <= self.half_width_deg + self.own.half_width_deg


@dataclass(frozen=True, kw_only=True)
class Findings:
    shipped: tuple[Shipped, ...]
    scores: list[Score]
    """At the first angle of each experiment, or at the inferred one where it has none."""
    others: list[Score]
    """At its other angles, on the coarse cells."""
    inferred: list[Inferred]


def bench(*, out: Out, keep: Keep = None, experiments: Path = FOLDER) -> str:
    """Compute all measured experiments, and infer their angles from their fronts.

    Raises InputError for an experiment that cannot be read.

    Parameters
    ----------
    experiments
        Folder that holds a folder for each experiment; those that ship unless given.
    """
    with kept(keep) as folder:
        findings = compute(read_experiments(experiments), RunStore(folder).run)
    draw(out / "experiments.png", findings)
    return written(out, findings)


def compute(shipped: Sequence[Shipped], simulate: Simulate) -> Findings:
    """Run everything: every case over the ladder on its coarse cells, and once on its fine ones."""
    pairs = [(each, case) for each in shipped for case in each.experiment.cases]
    asked = [(e, case, r) for e, case in pairs for r in dict.fromkeys((*ladder(e), *e.experiment.readings))]
    coarse = run(asked, 0, simulate)
    crossings = {
        (each, case): crossing({r.deg: coarse[each, case, r](case.extent) for r in ladder(each)}, case.extent.value)
        for each, case in pairs
    }
    # On the fine cells at the first angle that was measured, else at the one that the coarse cells imply.
    firsts = [
        (each, case, reading)
        for each, case in pairs
        for reading in each.experiment.readings[:1] or [replace(ladder(each)[0], deg=crossings[each, case][0])]
        if not math.isnan(reading.deg)
    ]
    fine = run(firsts, 1, simulate)
    found = Findings(shipped=tuple(shipped), scores=[], others=[], inferred=[])
    for each, case, first in firsts:
        slope, angles, extent = crossings[each, case][1], each.experiment.angles, case.extent
        deg = first.deg + (extent.value - fine[each, case, first](extent)) / slope
        found.inferred.append(
            Inferred(
                label=f"{each.name}, {case.name}",
                own=angles[0] if angles else None,
                deg=deg,
                half_width_deg=abs(CLOSE * extent.spread / slope),
            )
        )
        # Where no angle was measured, what else was is held against a run at the inferred one.
        again = replace(first, deg=deg)
        if not angles and case.measured[1:]:
            fine |= run([(each, case, again)], 1, simulate)
        for reading, name in zip(
            each.experiment.readings or [again], [a.name for a in angles] or [INFERRED], strict=True
        ):
            known: Callable[[Measured], float] = coarse.get((each, case, reading), lambda _: math.nan)
            for measured in case.measured if angles else case.measured[1:]:
                score = Score(
                    label=f"{each.name}, {case.name}, {measured.quantity}",
                    measured=measured,
                    angle=said(reading, name),
                    independent=bool(angles),
                    coarse=known(measured),
                    fine=fine.get((each, case, reading), known)(measured),
                )
                (found.others if reading in each.experiment.readings[1:] else found.scores).append(score)
    return found


def said(reading: Reading, name: str) -> str:
    """An angle with its name and how it is read."""
    read = [name, *(["μ(I)"] if reading.rate else []), *({reading.angle} - {"slope"})]
    return f"{reading.deg:.1f}° ({', '.join(read)})"


def ladder(shipped: Shipped) -> list[Reading]:
    """The readings over which the slope of a front is found: as the first of an experiment, at other angles."""
    known = [*shipped.experiment.readings, Reading(math.nan, rate=shipped.experiment.grains is not None)]
    return [replace(known[0], deg=deg) for deg in LADDER_DEG]


def run(asked: Sequence[Asked], number: int, simulate: Simulate) -> Flows:
    """Cases on their coarse (0) or fine (1) cells, by readings."""
    runs = []
    for each, case, reading in asked:
        timed = any(measured.times for measured in case.measured)
        record = replace(AT_REST, frames=RECORDED) if timed else AT_REST
        runs.append(Run(scene=each.scene(case.scene, each.cells(case)[number], reading), record=record))
    return dict(zip(asked, (partial(quantity, flow=flow) for flow in simulate(runs)), strict=True))


def crossing(fronts: Mapping[float, float], target: float) -> tuple[float, float]:
    """The angle [deg] at which a front that falls with it is `target` [m], linear between runs; and the slope there.

    nan for the angle where none of the runs is as far, or all are further. fronts: [m] by angle [deg].
    """
    angles = sorted(fronts)
    pairs = list(itertools.pairwise(angles))
    inside = [(a, b) for a, b in pairs if fronts[a] >= target >= fronts[b]]
    a, b = inside[0] if inside else (pairs[0] if fronts[angles[0]] < target else pairs[-1])
    slope = (fronts[b] - fronts[a]) / (b - a)
    return (a + (target - fronts[a]) / (fronts[b] - fronts[a]) * (b - a) if inside else math.nan), slope


def written(out: Path, findings: Findings) -> str:
    """Write the page, and return its conclusion."""
    scores = [
        {
            "experiment": each.label,
            "angle": each.angle,
            "measured [m]": f"{each.measured.value:.4f} ± {each.measured.spread:.4f}",
            "coarse cells [m]": "-" if math.isnan(each.coarse) else f"{each.coarse:.4f}",
            "fine cells [m]": f"{each.fine:.4f}",
            "error [spreads]": emphasised(f"{each.error:+.1f}", each.agrees),
            "at the other angle": ", ".join(
                f"{other.error:+.1f} at {other.angle}"
                for other in findings.others
                if (other.label, other.measured) == (each.label, each.measured)
            ),
        }
        for each in findings.scores
    ]
    inferred = [
        {
            "experiment": each.label,
            "measured": f"{a.deg:.1f} ± {a.half_width_deg:.1f}° ({a.name})" if (a := each.own) else "",
            "inferred": "none" if math.isnan(each.deg) else f"{each.deg:.1f} ± {each.half_width_deg:.1f}°",
            "difference [°]": "-" if math.isnan(each.difference_deg) else f"{each.difference_deg:+.1f}",
        }
        for each in findings.inferred
    ]
    beyond = [each for each in findings.scores if not each.agrees]
    reasons = [f"- {each.label}: {each.measured.explanation or 'No reason is known.'}" for each in beyond]
    sources = [f"- `{e.name}`: {e.experiment.source} ({e.experiment.licence})." for e in findings.shipped]
    return write_page(
        out,
        "experiments",
        conclusion(findings),
        close=CLOSE,
        scores=scores,
        reasons="\n".join(reasons),
        inferred=inferred,
        sources="\n".join(sources),
    )


def conclusion(findings: Findings) -> list[str]:
    """Lengths and fronts forward, angles backward."""
    scores = [each for each in findings.scores if each.independent]
    inferred = [each for each in findings.inferred if not math.isnan(each.difference_deg)]
    if not scores:
        return ["No experiment has an angle of friction of its own."]
    largest = max(scores, key=lambda each: abs(each.error))
    fronts = [each for each in scores if each.measured.quantity in (Quantity.FRONT, Quantity.RADIUS)]
    far = [each.fine / each.measured.value - 1.0 for each in fronts]
    mean, moved = float(np.mean(far)), max(abs(each.fine / each.coarse - 1.0) for each in fronts)
    lines = [
        f"With independently measured angles of friction and nothing fitted, {sum(each.agrees for each in scores)} of"
        f" {len(scores)} computed lengths lie within {CLOSE:g} spreads of the measured ones; the largest error is"
        f" {largest.error:+.1f} spreads ({largest.label}).",
        f"Fronts are {percent(abs(mean))} too {'far' if mean > 0.0 else 'short'} on average, {signed(min(far))} to"
        f" {signed(max(far))}; finer cells move them by at most {percent(moved)}.",
    ]
    if inferred:
        off = [each.difference_deg for each in inferred]
        lines.append(
            f"The angle inferred from a front is {abs(np.mean(off)):.1f}° {'above' if sum(off) > 0.0 else 'below'} the"
            f" measured one on average, {min(off):+.1f}° to {max(off):+.1f}°; the ranges of"
            f" {sum(each.agrees for each in inferred)} of {len(inferred)} cases overlap."
        )
    return lines


def draw(path: Path, findings: Findings) -> None:
    """Lengths over the measured ones, a row each."""
    scores = [each for each in findings.scores if each.measured.single]
    rows, value = range(len(scores)), np.array([each.measured.value for each in scores])
    spread = np.array([each.measured.spread for each in scores]) / value
    with figure(path, size=(8.0, 1.6 + 0.36 * max(len(scores), 1))) as axes:
        axis = axes[0, 0]
        ones = np.ones(len(scores))
        axis.errorbar(ones, rows, xerr=spread, fmt="s", color=INK, capsize=3, ms=4, label="measured, ± spread")
        for name, colour in (("coarse", LIGHT_BLUE), ("fine", BLUE)):
            found = np.array([getattr(each, name) for each in scores])
            axis.plot(found / value, rows, "o", color=colour, label=f"computed, {name} cells")
        axis.set_yticks(rows, [each.label for each in scores])
        axis.set(xlabel="length over the measured one", title="At the angle of friction that was measured by itself")
        axis.grid(axis="y", visible=False)
        axis.invert_yaxis()
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=3)
