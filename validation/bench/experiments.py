"""`python -m validation.bench experiments`: measured flows at angles of friction measured by themselves, and back."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from datasets.trajectory import Trajectory
from mpm import AT_REST
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
from validation.report.page import Page, emphasised, percent, rms, signed
from validation.report.plots import BLUE, INK, LIGHT_BLUE, figure
from validation.runs import Run, RunStore

CLOSE = 2.0
"""Spreads within which a number agrees."""
LADDER_DEG = (16.0, 20.0, 24.0, 28.0, 32.0)
"""Angles at which every case is run on its coarse cells: the slope of its front."""
QUICK = "aluminium-rods"
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

    experiment: str
    case: MeasuredScene
    measured: Measured
    name: str
    """Of the angle."""
    reading: Reading
    coarse: float
    """Computed on the coarse cells [m]; nan where there was no such run."""
    fine: float
    """On the fine cells [m]; the coarse one's for another angle than the first."""

    @property
    def label(self) -> str:
        return f"{self.experiment}, {self.case.name}, {self.measured.quantity}"

    @property
    def angle(self) -> str:
        """Such as 22.0° (repose, μ(I))."""
        read = [self.name, *(["μ(I)"] if self.reading.rate else []), *({self.reading.angle} - {"slope"})]
        return f"{self.reading.deg:.1f}° ({', '.join(read)})"

    @property
    def independent(self) -> bool:
        return self.name != INFERRED

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

    experiment: str
    case: MeasuredScene
    angles: tuple[Angle, ...]
    """The material's own; empty where none was measured."""
    coarse_deg: float
    """By the runs on the coarse cells alone [deg]; nan where no angle of the ladder gives what was measured."""
    deg: float
    """On the fine cells [deg]."""
    half_width_deg: float
    """By CLOSE times the measurement's spread [deg]."""

    @property
    def difference_deg(self) -> float:
        """Inferred on the fine cells less measured [deg]; nan where either is missing."""
        return self.deg - self.angles[0].deg if self.angles else math.nan

    @property
    def agrees(self) -> bool:
        """Whether the two ranges overlap; False where either is missing."""
        return bool(self.angles) and abs(self.difference_deg) <= self.half_width_deg + self.angles[0].half_width_deg


@dataclass(frozen=True, kw_only=True)
class Findings:
    shipped: tuple[Shipped, ...]
    scores: tuple[Score, ...]
    """At the first angle of each experiment, or at the inferred one where it has none."""
    others: tuple[Score, ...]
    """At its other angles, on the coarse cells."""
    inferred: tuple[Inferred, ...]


def bench(out: Path, *, quick: bool, keep: Path, experiments: Path = FOLDER) -> str:
    """Run all experiments in the folder `experiments`: experiments.md and its picture.

    quick: the aluminium rods alone. Raises InputError for an experiment that cannot be read.
    """
    shipped = [each for each in read_experiments(experiments) if each.name == QUICK or not quick]
    findings = compute(shipped, RunStore(keep).run)
    draw(out / "experiments.png", findings)
    return page(findings, quick=quick).write(out / "experiments.md")


def compute(shipped: Sequence[Shipped], simulate: Simulate) -> Findings:
    """Run everything: every case over the ladder on its coarse cells, and once on its fine ones."""
    pairs = [(each, case) for each in shipped for case in each.experiment.cases]
    readings = {each: dict.fromkeys((*ladder(each), *each.experiment.readings)) for each in shipped}
    coarse = run([(each, case, reading) for each, case in pairs for reading in readings[each]], 0, simulate)
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
    inferred = [
        Inferred(
            experiment=each.name,
            case=case,
            angles=each.experiment.angles,
            coarse_deg=coarse_deg,
            deg=first.deg + (case.extent.value - fine[each, case, first](case.extent)) / slope,
            half_width_deg=abs(CLOSE * case.extent.spread / slope),
        )
        for each, case, first in firsts
        for coarse_deg, slope in [crossings[each, case]]
    ]
    # Where no angle was measured, what else was is held against a run at the inferred one.
    again = [
        (each, case, replace(first, deg=one.deg))
        for (each, case, first), one in zip(firsts, inferred, strict=True)
        if not each.experiment.angles and case.measured[1:]
    ]
    fine |= run(again, 1, simulate)
    scores: list[Score] = []
    others: list[Score] = []
    for each, case, first in (*(one for one in firsts if one[0].experiment.angles), *again):
        angles = each.experiment.angles
        names = [angle.name for angle in angles] or [INFERRED]
        for reading, name in zip(each.experiment.readings or [first], names, strict=True):
            known: Callable[[Measured], float] = coarse.get((each, case, reading), lambda _: math.nan)
            best = fine[each, case, first] if reading == first else known
            (scores if reading == first else others).extend(
                Score(
                    experiment=each.name,
                    case=case,
                    measured=measured,
                    name=name,
                    reading=reading,
                    coarse=known(measured),
                    fine=best(measured),
                )
                # An inferred angle says nothing of the number that it was inferred from.
                for measured in case.measured[0 if angles else 1 :]
            )
    return Findings(shipped=tuple(shipped), scores=tuple(scores), others=tuple(others), inferred=tuple(inferred))


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


def page(findings: Findings, *, quick: bool) -> Page:
    text = Page("Measured experiments", "experiments", conclusion(findings), quick=quick)
    text.picture("experiments.png", "measured against computed")
    text.text(f"""
        Every experiment is a folder in `validation/experiments`: scene, numbers, spread, source, licence, and what the
        authors do not state with the choice that was made. A number was read in a source or is worked out from such
        numbers; where sources disagree the band between them is the target, its half width the spread. Scenes are
        computed until they rest, undamped, one jitter each; nothing is fitted. The error is (computed - measured) /
        spread on the fine cells; bold where it is beyond {CLOSE:g}, with the reason below.

        One rule for all: an angle is [that of a slope](how-to/angle.md). At the repose angle a flow stops: it is μ_s,
        and friction grows with the inertial number by the numbers of glass beads. At an avalanche angle grains begin
        to flow: it is the friction of all of the flow. The repose angle comes first; the error at the other one is of
        the coarse cells. An inferred angle is that of the next table, by the same experiment's final extent.
    """)
    text.section("At the measured angle")
    text.table(
        [
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
    )
    beyond = [each for each in findings.scores if not each.agrees]
    reasons = [f"- {each.label}: {each.measured.explanation or 'No reason is known.'}" for each in beyond]
    text.text("\n".join(reasons))
    text.section("The angle from the front")
    text.text("""
        The slope's angle at which the front is the measured one, with all else as above: from the run on the fine
        cells by the slope of those on the coarse ones. ± is by two spreads of the measurement, without the
        discrepancy of the model.
    """)
    text.table(
        [
            {
                "experiment": f"{each.experiment}, {each.case.name}",
                "measured": ", ".join(f"{a.deg:.1f} ± {a.half_width_deg:.1f}° ({a.name})" for a in each.angles[:1]),
                "coarse cells": "none" if math.isnan(each.coarse_deg) else f"{each.coarse_deg:.1f}°",
                "fine cells": "none" if math.isnan(each.deg) else f"{each.deg:.1f} ± {each.half_width_deg:.1f}°",
                "difference [°]": "-" if math.isnan(each.difference_deg) else f"{each.difference_deg:+.1f}",
            }
            for each in findings.inferred
        ]
    )
    text.section("Sources")
    for shipped in findings.shipped:
        text.text(f"- `{shipped.name}`: {shipped.experiment.source} ({shipped.experiment.licence}).")
    return text


def conclusion(findings: Findings) -> list[str]:
    scores = [each for each in findings.scores if each.independent]
    inferred = [each for each in findings.inferred if not math.isnan(each.difference_deg)]
    if not scores:
        return ["No experiment has an angle of friction of its own."]
    agreed = sum(each.agrees for each in scores)
    largest = max(scores, key=lambda each: abs(each.error))
    fronts = [each for each in scores if each.measured.quantity in (Quantity.FRONT, Quantity.RADIUS)]
    far = [each.fine / each.measured.value - 1.0 for each in fronts]
    mean, moved = float(np.mean(far)), max(abs(each.fine / each.coarse - 1.0) for each in fronts)
    lines = [
        f"At angles of friction measured by themselves, nothing fitted, {agreed} of {len(scores)} lengths are within"
        f" {CLOSE:g} times their spread; rms {rms([each.error for each in scores]):.1f} spreads, at most"
        f" {largest.error:+.1f} ({largest.label}).",
        f"Fronts come {percent(abs(mean))} too {'far' if mean > 0.0 else 'short'} on average, {signed(min(far))} to"
        f" {signed(max(far))}; from coarse to fine cells they move by {percent(moved)} at most.",
    ]
    if inferred:
        off = [each.difference_deg for each in inferred]
        lines.append(
            f"The angle inferred from the front alone is {abs(np.mean(off)):.1f}°"
            f" {'above' if sum(off) > 0.0 else 'below'} the measured one on average, {rms(off):.1f}° rms,"
            f" {min(off):+.1f} to {max(off):+.1f}°; in {sum(each.agrees for each in inferred)} of {len(inferred)} cases"
            " the two ranges overlap."
        )
    if findings.others:
        cases = {(each.experiment, each.case.name) for each in findings.others}
        same = [replace(each, fine=each.coarse) for each in scores if (each.experiment, each.case.name) in cases]
        first, other = (rms([each.error for each in group]) for group in (same, findings.others))
        lines.append(
            f"Where there are two readings, on the coarse cells the first leaves {first:.1f} spreads rms and"
            f" {sum(not each.agrees for each in same)} lengths beyond {CLOSE:g}, the other one {other:.1f} and"
            f" {sum(not each.agrees for each in findings.others)}."
        )
    lines += [
        f"{each.label}: {each.error:+.1f} spreads at the angle that is inferred from its final extent."
        for each in findings.scores
        if not each.independent
    ]
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
