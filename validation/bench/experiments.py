"""`python -m validation.bench experiments`: measured flows, computed at independently measured angles, and inverted."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from datasets.flow.trajectory import Trajectory
from inverse.observations import ArrivalSettings, FrontSettings, GaugesSettings
from mpm import ALL, AT_REST
from validation.bench.page import Keep, Out, Row, emphasised, percent, tables, write_page
from validation.experiments.experiment import (
    FOLDER,
    Angle,
    Case,
    Experiment,
    Floats,
    Measured,
    Prediction,
    Quantity,
    Reading,
    quantity,
    read_experiments,
)
from validation.plots import BLUE, INK, LIGHT_BLUE, ORANGE, figure
from validation.run_store import Run, RunStore, kept

CLOSE = 2.0  # spreads within which a number agrees
LADDER_DEG = (16.0, 20.0, 24.0, 28.0, 32.0)
"""Angles at which every case runs on its coarse cells, which give the slope of its front over the angle."""
INFERRED = "inferred"  # name of an angle that comes from the experiment itself
RECORDED = 5  # frames between two recorded ones, for a flow that is measured over time

Simulate = Callable[[Sequence[Run]], Sequence[Trajectory]]
"""Runs -> their flows, like `validation.run_store.RunStore.run`."""


@dataclass(frozen=True, kw_only=True)
class CaseScore:
    """A measured number and the computed one."""

    case: str  # and its experiment
    measured: Measured
    reading: Reading
    coarse: float  # computed on the coarse cells [m]; nan without such a run
    fine: float  # on the fine cells [m]; on the coarse ones for other angles than the first

    @property
    def label(self) -> str:
        return f"{self.case}, {self.measured.quantity}"

    @property
    def error(self) -> float:
        """Value computed on the fine cells minus the measured one, in spreads [-]."""
        return (self.fine - self.measured.value) / self.measured.spread

    @property
    def agrees(self) -> bool:
        return abs(self.error) <= CLOSE


@dataclass(frozen=True, kw_only=True)
class Inferred:
    """The angle at which the computed front equals the measured one, and the material's own angle."""

    label: str  # experiment and case
    own: Angle | None  # the material's; None if none was measured
    deg: float  # on the fine cells [deg]
    half_width_deg: float  # by CLOSE times the measurement's spread [deg]

    @property
    def difference_deg(self) -> float:
        """Inferred minus measured angle [deg]; nan if none was measured."""
        return math.nan if self.own is None else self.deg - self.own.deg

    @property
    def agrees(self) -> bool:
        """Whether the two ranges overlap; False if no angle was measured."""
        return self.own is not None and abs(self.difference_deg) <= self.half_width_deg + self.own.half_width_deg


@dataclass(frozen=True, kw_only=True)
class Predicted:
    """A prediction on one grid."""

    variant: str
    cell: float  # [m]
    gauges: tuple[float, ...]  # distances [m]
    time: Floats  # of the frames [s], shape [T]
    front: Floats  # its distance [m], shape [T]
    thickness: Floats  # at the gauges [m], shape [G, T]
    arrivals: Floats  # at the gauges [s], shape [G]; nan if the front does not reach the gauge


def bench(*, out: Out, keep: Keep = None, experiments: Path = FOLDER) -> str:
    """Compute all measured experiments, and infer their angles from their fronts.

    Raises InputError for an experiment that cannot be read.

    Args:
        experiments: Folder with a folder for each experiment; default: the shipped experiments.
    """
    read = read_experiments(experiments)
    with kept(keep) as folder:
        store = RunStore(folder)
        computed = [compute(experiment, case, store.run) for experiment in read for case in experiment.cases]
        predicted = [
            (f"{experiment.name}, {prediction.name}", experiment, forecast(experiment, prediction, store.run))
            for experiment in read
            for prediction in experiment.predictions
        ]
    scores = [row for rows, _ in computed for row in rows]
    inferred = [angle for _, angle in computed if angle is not None]
    firsts = [first for first, *_ in scores]
    draw(out / "experiments.png", [score for score in firsts if score.measured.single])
    beyond = [score for score in firsts if not score.agrees]
    reasons = [f"- {score.label}: {score.measured.explanation or 'No reason is known.'}" for score in beyond]
    sources = [f"- `{experiment.name}`: {experiment.source} ({experiment.licence})." for experiment in read]
    return write_page(
        out,
        "experiments",
        conclusion(firsts, inferred),
        close=CLOSE,
        scores=[score_row(*row) for row in scores],
        reasons="\n".join(reasons),
        inferred=[
            {
                "experiment": angle.label,
                "measured": f"{own.deg:.1f} ± {own.half_width_deg:.1f}° ({own.name})" if (own := angle.own) else "",
                "inferred": f"{angle.deg:.1f} ± {angle.half_width_deg:.1f}°",
                "difference [°]": "-" if own is None else f"{angle.difference_deg:+.1f}",
            }
            for angle in inferred
        ],
        predictions="\n\n".join(section(*item, out) for item in predicted),
        sources="\n".join(sources),
    )


def compute(experiment: Experiment, case: Case, simulate: Simulate) -> tuple[list[list[CaseScore]], Inferred | None]:
    """Run a case over the ladder of angles on its coarse cells, and at the first angle on its fine ones. Returns the
    scores of each measured number at the first angle of the experiment (the inferred one if it has none), then at its
    other angles on the coarse cells; and the inferred angle, None if no angle gives the front."""
    readings, extent = experiment.readings, case.extent
    first = readings[0] if readings else Reading(name=INFERRED, deg=math.nan, rate=experiment.grains is not None)
    ladder = [replace(first, deg=deg) for deg in LADDER_DEG]
    timed = any(measured.times for measured in case.measured)
    record = replace(AT_REST, frames=RECORDED) if timed else AT_REST

    def run(cells: int, angles: Sequence[Reading]) -> dict[Reading, Trajectory]:
        runs = [Run(scene=experiment.scene(case, cells, reading), record=record) for reading in angles]
        return dict(zip(angles, simulate(runs), strict=True))

    coarse = run(0, list(dict.fromkeys((*ladder, *readings))))
    angle, slope = crossing({reading.deg: quantity(extent, coarse[reading]) for reading in ladder}, extent.value)
    # The fine cells run at the first measured angle, else at the one that the coarse cells imply.
    first = first if readings else replace(first, deg=angle)
    if math.isnan(first.deg):
        return [], None
    fine = run(1, [first])
    deg = first.deg + (extent.value - quantity(extent, fine[first])) / slope
    label, own = f"{experiment.name}, {case.name}", experiment.angles[0] if readings else None
    inferred = Inferred(label=label, own=own, deg=deg, half_width_deg=abs(CLOSE * extent.spread / slope))
    again = replace(first, deg=deg)
    if not readings and case.measured[1:]:
        # Without a measured angle, the other measured numbers are compared with a run at the inferred one.
        fine |= run(1, [again])

    def score(measured: Measured, reading: Reading) -> CaseScore:
        by_coarse = quantity(measured, coarse[reading]) if reading in coarse else math.nan
        by_fine = quantity(measured, fine[reading]) if reading in fine else by_coarse
        return CaseScore(case=label, measured=measured, reading=reading, coarse=by_coarse, fine=by_fine)

    numbers = case.measured if readings else case.measured[1:]
    return [[score(measured, reading) for reading in readings or (again,)] for measured in numbers], inferred


def forecast(experiment: Experiment, prediction: Prediction, simulate: Simulate) -> list[Predicted]:
    """Every variant on the coarse cells, then on the fine ones."""
    predicted = []
    for number, variant in itertools.product((0, 1), prediction.variants):
        scene = experiment.predicted(prediction, number, variant)
        (flow,) = simulate([Run(scene=scene, record=ALL)])
        x, time = tuple(prediction.start + gauge for gauge in prediction.gauges), tuple(flow.time.tolist())
        heights = GaugesSettings(x=x, times=time, spacing=prediction.spacing).operator(scene).observe(flow)
        arrivals = ArrivalSettings(x=x).operator(scene).observe(flow)
        predicted.append(
            Predicted(
                variant=variant.name,
                cell=scene.domain.cell,
                gauges=prediction.gauges,
                time=flow.time,
                front=FrontSettings(times=time).operator(scene).observe(flow) - prediction.start,
                thickness=heights.reshape(len(x), len(time)),
                arrivals=np.where(arrivals < time[-1], arrivals, math.nan),
            )
        )
    return predicted


def section(label: str, experiment: Experiment, predictions: Sequence[Predicted], out: Path) -> str:
    """The section of a prediction on the page; it also draws the picture."""
    picture = f"experiments-{experiment.name}.png"
    with figure(out / picture, size=(4.8, 3.4), columns=2) as axes:
        finest = [predicted for predicted in predictions if predicted.cell == predictions[-1].cell]
        for predicted, colour in zip(finest, (BLUE, ORANGE, INK, LIGHT_BLUE), strict=False):
            axes[0, 0].plot(predicted.time, predicted.front, color=colour, label=predicted.variant)
            for at, series, style in zip(predicted.gauges, predicted.thickness, ("-", "--", ":", "-."), strict=False):
                axes[0, 1].plot(predicted.time, series, style, color=colour, label=f"{at:g} m, {predicted.variant}")
        axes[0, 0].set(xlabel="time [s]", ylabel="front from the gate [m]")
        axes[0, 1].set(xlabel="time [s]", ylabel="thickness [m]")
        for axis in axes.flat:
            axis.legend()
    rows: list[Row] = []
    for predicted in predictions:
        row = {"with": predicted.variant, "cell [m]": f"{predicted.cell:g}"}
        for at, arrival, series in zip(predicted.gauges, predicted.arrivals, predicted.thickness, strict=True):
            row[f"front at {at:g} m [s]"] = "-" if math.isnan(arrival) else f"{arrival:.2f}"
            row[f"thickest at {at:g} m [m]"] = f"{series.max():.3f} at {predicted.time[series.argmax()]:.1f} s"
        rows.append({**row, "farthest front [m]": f"{predicted.front.max():.1f}"})
    variants = [variant for prediction in experiment.predictions for variant in prediction.variants]
    lines = [f"- {variant.name}: {variant.source}." for variant in variants]
    lines += [f"- {made['what']}: {made['choice']}; {made['reason']}." for made in experiment.assumptions]
    parts = [f"### {label}", f"{experiment.title}. {experiment.what}", tables([rows]), f"![{label}]({picture})"]
    return "\n\n".join([*parts, "\n".join(lines)])


def crossing(fronts: Mapping[float, float], target: float) -> tuple[float, float]:
    """The angle [deg] at which a front that decreases with it is `target` [m], linear between runs; and the slope. The
    angle is nan if no run reaches the target or all exceed it. fronts: angle [deg] -> front [m]."""
    angles = sorted(fronts)
    pairs = list(itertools.pairwise(angles))
    inside = [(a, b) for a, b in pairs if fronts[a] >= target >= fronts[b]]
    a, b = inside[0] if inside else (pairs[0] if fronts[angles[0]] < target else pairs[-1])
    slope = (fronts[b] - fronts[a]) / (b - a)
    return (a + (target - fronts[a]) / (fronts[b] - fronts[a]) * (b - a) if inside else math.nan), slope


def score_row(score: CaseScore, *others: CaseScore) -> Row:
    return {
        "experiment": score.label,
        "angle": str(score.reading),
        "measured [m]": f"{score.measured.value:.4f} ± {score.measured.spread:.4f}",
        "coarse cells [m]": "-" if math.isnan(score.coarse) else f"{score.coarse:.4f}",
        "fine cells [m]": f"{score.fine:.4f}",
        "error [spreads]": emphasised(f"{score.error:+.1f}", score.agrees),
        "at the other angle": ", ".join(f"{other.error:+.1f} at {other.reading}" for other in others),
    }


def conclusion(firsts: Sequence[CaseScore], angles: Sequence[Inferred]) -> list[str]:
    """Lengths and fronts forward, angles backward; firsts: the scores at the first angles."""
    scores = [score for score in firsts if score.reading.name != INFERRED]
    inferred = [angle for angle in angles if angle.own is not None]
    if not scores:
        return ["No experiment has an angle of friction of its own."]
    largest = max(scores, key=lambda score: abs(score.error))
    fronts = [score for score in scores if score.measured.quantity in (Quantity.FRONT, Quantity.RADIUS)]
    far = [front.fine / front.measured.value - 1.0 for front in fronts]
    mean, moved = float(np.mean(far)), max(abs(front.fine / front.coarse - 1.0) for front in fronts)
    off = [angle.difference_deg for angle in inferred]
    return [
        f"With independently measured angles of friction and nothing fitted, {sum(score.agrees for score in scores)} of"
        f" {len(scores)} computed fronts, heights and profiles at measured angles lie within {CLOSE:g} spreads of the"
        f" measured ones; the largest error is {largest.error:+.1f} spreads ({largest.label}).",
        f"Fronts are {percent(abs(mean))} too {'far' if mean > 0.0 else 'short'} on average,"
        f" {percent(min(far), '+.1f')} to {percent(max(far), '+.1f')}; finer cells move them by at most"
        f" {percent(moved)}.",
        f"The angle inferred from a front is {abs(np.mean(off)):.1f}° {'above' if sum(off) > 0.0 else 'below'} the"
        f" measured one on average, {min(off):+.1f}° to {max(off):+.1f}°; the ranges of"
        f" {sum(angle.agrees for angle in inferred)} of {len(inferred)} cases overlap.",
    ]


def draw(path: Path, scores: Sequence[CaseScore]) -> None:
    rows, value = range(len(scores)), np.array([score.measured.value for score in scores])
    spread = np.array([score.measured.spread for score in scores]) / value
    with figure(path, size=(8.0, 1.6 + 0.36 * max(len(scores), 1))) as axes:
        axis = axes[0, 0]
        ones = np.ones(len(scores))
        axis.errorbar(ones, rows, xerr=spread, fmt="s", color=INK, capsize=3, ms=4, label="measured, ± spread")
        for name, colour in (("coarse", LIGHT_BLUE), ("fine", BLUE)):
            lengths = np.array([getattr(score, name) for score in scores])
            axis.plot(lengths / value, rows, "o", color=colour, label=f"computed, {name} cells")
        axis.set_yticks(rows, [score.label for score in scores])
        axis.set(xlabel="length over the measured one", title="At the angle of friction that was measured by itself")
        axis.grid(axis="y", visible=False)
        axis.invert_yaxis()
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=3)
