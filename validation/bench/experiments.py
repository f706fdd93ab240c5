"""`python -m validation.bench experiments`: measured flows at angles of friction measured by themselves, and back."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from datasets.measures import Positions
from datasets.scene import Scene
from mpm import AT_REST
from validation.experiments.experiment import (
    FOLDER,
    Angle,
    Measured,
    MeasuredScene,
    Quantity,
    Shipped,
    read_experiments,
)
from validation.experiments.quantities import quantity
from validation.report.page import Page, percent, rms, signed
from validation.report.plots import BLUE, INK, LIGHT_BLUE, figure, pane
from validation.runs import Run, RunStore

CLOSE = 2.0
"""Spreads within which a number agrees."""
LADDER_DEG = (20.0, 24.0, 28.0, 32.0, 36.0)
"""Angles at which every case is run on its coarse cells: the slope of its front."""
QUICK = "aluminium-rods"

Simulate = Callable[[Sequence[Scene]], Sequence[Positions]]
"""Scenes to their deposits [m], each of shape [N, D]."""
Deposits = Mapping[tuple[str, str, float], Callable[[Measured], float]]
"""What is measured of a deposit [m], by experiment, case and angle [deg]."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """A measured number beside the computed one, at an angle of friction that was measured independently."""

    experiment: str
    case: MeasuredScene
    measured: Measured
    angle: Angle
    coarse: float
    """Computed on the coarse cells [m]."""
    fine: float
    """On the fine cells [m]; the coarse one's for another angle than the first."""

    @property
    def label(self) -> str:
        """Experiment, case and quantity."""
        return f"{self.experiment}, {self.case.name}, {self.measured.quantity}"

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
    """By the measurement's spread [deg]."""

    @property
    def label(self) -> str:
        """Experiment and case."""
        return f"{self.experiment}, {self.case.name}"

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
    """All that the page is made from."""

    shipped: tuple[Shipped, ...]
    scores: tuple[Score, ...]
    """At the first angle of each experiment."""
    others: tuple[Score, ...]
    """At its other angles, on the coarse cells."""
    inferred: tuple[Inferred, ...]


def bench(out: Path, *, quick: bool, keep: Path, experiments: Path = FOLDER) -> str:
    """Run all experiments in the folder `experiments`: experiments.md and its picture.

    quick: the aluminium rods alone. Raises InputError for an experiment that cannot be read.
    """
    shipped = [each for each in read_experiments(experiments) if each.name == QUICK or not quick]
    findings = compute(shipped, partial(deposits_of, RunStore(keep)))
    draw(out / "experiments.png", findings)
    return page(findings, quick=quick).write(out / "experiments.md")


def deposits_of(store: RunStore, scenes: Sequence[Scene]) -> list[Positions]:
    """The deposits [m] of scenes, each of shape [N, D], at rest or at their end."""
    return [flow.positions[-1] for flow in store.run([Run(scene=scene, record=AT_REST) for scene in scenes])]


def compute(shipped: Sequence[Shipped], simulate: Simulate) -> Findings:
    """Run everything: every case over the ladder on its coarse cells, and once on its fine ones."""
    pairs = [(each, case) for each in shipped for case in each.experiment.cases]
    tried = {each.name: sorted({*LADDER_DEG, *(angle.deg for angle in each.experiment.angles)}) for each in shipped}
    coarse = run([(each, case, 0, deg) for each, case in pairs for deg in tried[each.name]], simulate)
    crossings = {
        (each.name, case.name): crossing(
            {deg: coarse[each.name, case.name, deg](case.extent) for deg in tried[each.name]}, case.extent.value
        )
        for each, case in pairs
    }
    # On the fine cells at the angle that was measured, else at the one that the coarse cells imply.
    firsts = {
        (each.name, case.name): each.experiment.angles[0].deg
        if each.experiment.angles
        else crossings[each.name, case.name][0]
        for each, case in pairs
    }
    known = [(each, case) for each, case in pairs if not math.isnan(firsts[each.name, case.name])]
    fine = run([(each, case, 1, firsts[each.name, case.name]) for each, case in known], simulate)
    inferred = [
        Inferred(
            experiment=each.name,
            case=case,
            angles=each.experiment.angles,
            coarse_deg=coarse_deg,
            deg=first + (case.extent.value - fine[each.name, case.name, first](case.extent)) / slope,
            half_width_deg=abs(case.extent.spread / slope),
        )
        for each, case in known
        for first, (coarse_deg, slope) in [(firsts[each.name, case.name], crossings[each.name, case.name])]
    ]
    scores = {
        number: tuple(
            Score(
                experiment=each.name,
                case=case,
                measured=measured,
                angle=angle,
                coarse=coarse[each.name, case.name, angle.deg](measured),
                fine=(coarse if number else fine)[each.name, case.name, angle.deg](measured),
            )
            for each, case in pairs
            for angle in each.experiment.angles[number : None if number else 1]
            for measured in case.measured
        )
        for number in (0, 1)
    }
    return Findings(
        shipped=tuple(shipped),
        scores=scores[0],
        others=scores[1],
        inferred=tuple(inferred),
    )


def run(asked: Sequence[tuple[Shipped, MeasuredScene, int, float]], simulate: Simulate) -> Deposits:
    """Cases on their coarse (0) or fine (1) cells at angles of friction [deg]."""
    scenes = [each.scene(case.scene, each.cells(case)[number], deg) for each, case, number, deg in asked]
    return {
        (each.name, case.name, deg): partial(quantity, scene=scene, positions=deposit)
        for (each, case, _, deg), scene, deposit in zip(asked, scenes, simulate(scenes), strict=True)
    }


def crossing(fronts: Mapping[float, float], target: float) -> tuple[float, float]:
    """The angle [deg] at which a front that falls with it is `target` [m], linear between runs; and the slope there.

    nan for the angle where none of the runs is as far, or all are further. fronts: [m] by angle [deg].
    """
    angles = sorted(fronts)
    pairs = list(itertools.pairwise(angles))
    inside = [(a, b) for a, b in pairs if fronts[a] >= target >= fronts[b]]
    a, b = inside[0] if inside else (pairs[0] if fronts[angles[0]] < target else pairs[-1])
    # Over neighbours that are close the scatter of a jitter would be much of the difference.
    below, above = (a, b) if b - a >= 0.5 * (LADDER_DEG[1] - LADDER_DEG[0]) else (angles[0], angles[-1])
    slope = (fronts[above] - fronts[below]) / (above - below)
    return (a + (target - fronts[a]) / (fronts[b] - fronts[a]) * (b - a) if inside else math.nan), slope


def page(findings: Findings, *, quick: bool = False) -> Page:
    """The page."""
    text = Page(
        "Measured experiments",
        command="python -m validation.bench experiments",
        conclusion=conclusion(findings),
        quick=quick,
    )
    text.picture("experiments.png", "measured against computed")
    text.text(f"""
        Every experiment is a folder in `validation/experiments` with its scene, its numbers, their spread, source and
        licence. A number was read in a source or is worked out from such numbers; where sources disagree the band
        between them is the target, its half width the spread. Scenes are computed until they rest, undamped, one jitter
        each, on coarse and on fine cells; nothing is fitted. The error is (computed - measured) / spread on the fine
        cells; bold where it is beyond {CLOSE:g}, with the reason below. Where both an avalanche and a repose angle were
        measured, the first is the one to compute with, as Rousseau et al. (2023) find for Drucker-Prager continua; the
        error at the other one is of the coarse cells.
    """)
    text.section("At the measured angle")
    text.table(
        [
            {
                "experiment": each.experiment,
                "case": f"{each.case.name}, {each.measured.quantity}",
                "angle": f"{each.angle.deg:.1f}° ({each.angle.name})",
                "measured [m]": f"{each.measured.value:.4f} ± {each.measured.spread:.4f}",
                "coarse cells [m]": f"{each.coarse:.4f}",
                "fine cells [m]": f"{each.fine:.4f}",
                "error [spreads]": f"{each.error:+.1f}" if each.agrees else f"**{each.error:+.1f}**",
                "at the other angle": ", ".join(
                    f"{other.error:+.1f} at {other.angle.deg:.1f}°"
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
        The angle at which the front is the measured one, floor included where it is as rough as the grains: from the
        run on the fine cells by the slope of those on the coarse ones. ± is by the measurement's spread, without the
        discrepancy of the model.
    """)
    text.table(
        [
            {
                "experiment": each.experiment,
                "case": each.case.name,
                "measured": ", ".join(f"{a.deg:.1f} ± {a.half_width_deg:.1f}° ({a.name})" for a in each.angles),
                "coarse cells": "none" if math.isnan(each.coarse_deg) else f"{each.coarse_deg:.1f}°",
                "fine cells": "none" if math.isnan(each.deg) else f"{each.deg:.1f} ± {each.half_width_deg:.1f}°",
                "difference [°]": "-" if math.isnan(each.difference_deg) else f"{each.difference_deg:+.1f}",
            }
            for each in findings.inferred
        ]
    )
    text.section("The experiments")
    text.text("""
        `validation/experiments/NAME/experiment.toml` has what each number is from, its spread, and what the authors do
        not state with the choice that was made for it.
    """)
    for shipped in findings.shipped:
        one = shipped.experiment
        text.text(f"- `{shipped.name}`: {one.title}. {one.source} ({one.licence.rstrip('.')}).")
    return text


def conclusion(findings: Findings) -> list[str]:
    """What was found, each sentence from its numbers."""
    scores, inferred = findings.scores, [each for each in findings.inferred if not math.isnan(each.difference_deg)]
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
            f"The angle inferred from the front alone is {np.mean(off):+.1f}° from the measured one on average,"
            f" {min(off):+.1f} to {max(off):+.1f}°; in {sum(each.agrees for each in inferred)} of {len(inferred)} cases"
            " the two ranges overlap."
        )
    if findings.others:
        cases = {(each.experiment, each.case.name) for each in findings.others}
        same = [each for each in scores if (each.experiment, each.case.name) in cases]
        first = rms([(each.coarse - each.measured.value) / each.measured.spread for each in same])
        other = rms([each.error for each in findings.others])
        names = [" or ".join(sorted({each.angle.name for each in some})) for some in (same, findings.others)]
        lines.append(
            f"Where two angles were measured, the {names[0]} angle leaves {first:.1f} spreads rms, the {names[1]} angle"
            f" {other:.1f}, on the coarse cells."
        )
    return lines


def draw(path: Path, findings: Findings) -> None:
    """Lengths over the measured ones, a row each."""
    scores = [each for each in findings.scores if each.measured.quantity is not Quantity.PROFILE]
    rows, value = range(len(scores)), np.array([each.measured.value for each in scores])
    spread = np.array([each.measured.spread for each in scores]) / value
    with figure(path, size=(8.0, 1.6 + 0.36 * max(len(scores), 1))) as axes:
        axis = pane(axes)
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
