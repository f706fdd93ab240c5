"""experiments.png: measured against found with error bars, and the angles inferred beside the measured ones."""

import math
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from datasets import files
from validation.bench.experiments.computed import Findings
from validation.bench.experiments.page import label
from validation.experiments.experiment import Quantity

MEASURED, FINE, COARSE = "#222222", "#1b6ca8", "#9ecae1"


def draw(path: Path, findings: Findings) -> None:
    """A row per measured number on the left, one per inferred angle on the right."""
    rows = max(len(findings.scores), len(findings.angles), 1)
    figure, axes = plt.subplots(1, 2, figsize=(14.0, 1.6 + 0.36 * rows), layout="constrained")
    lengths(axes[0], findings)
    angles(axes[1], findings)
    for axis in axes:
        axis.grid(axis="x", color="#e6e6e6", linewidth=0.6)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
        axis.invert_yaxis()
        axis.legend(fontsize=8, frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2)
    with files.replacing(path) as part:
        figure.savefig(part, dpi=140)
    plt.close(figure)


def lengths(axis: Axes, findings: Findings) -> None:
    """Lengths over the measured ones."""
    some = [each for each in findings.scores if each.measured.quantity is not Quantity.PROFILE]
    places = range(len(some))
    scale = [each.measured.value for each in some]
    spreads = [each.measured.spread / each.measured.value for each in some]
    axis.errorbar(
        [1.0] * len(some),
        places,
        xerr=spreads,
        fmt="s",
        color=MEASURED,
        capsize=3,
        markersize=4,
        label="measured, ± spread",
    )
    for number, colour, name in ((0, COARSE, "found, coarse cells"), (1, FINE, "found, fine cells")):
        found = [each.found[number] / value for each, value in zip(some, scale, strict=True)]
        axis.plot(found, places, "o", color=colour, markersize=6, label=name)
    axis.set_yticks(places, [label(each) for each in some], fontsize=8)
    axis.set_xlabel("length over the measured one")
    axis.set_title("Forward, with angles measured independently", loc="left", fontsize=10)


def angles(axis: Axes, findings: Findings) -> None:
    """Angles in degrees."""
    places = range(len(findings.angles))
    for place, each in zip(places, findings.angles, strict=True):
        for number, angle in enumerate(each.angles):
            axis.errorbar(
                angle.deg,
                place,
                xerr=angle.half_width_deg,
                fmt="sd"[number > 0],
                color=MEASURED,
                capsize=3,
                markersize=4,
                mfc=MEASURED if number == 0 else "none",
            )
        for number, colour in ((0, COARSE), (1, FINE)):
            found = each.inferred[number]
            if not math.isnan(found.deg):
                axis.errorbar(
                    found.deg, place, xerr=found.half_width_deg, fmt="o", color=colour, capsize=3, markersize=6
                )
    axis.plot([], [], "s", color=MEASURED, markersize=4, label="measured, to compute with")
    axis.plot([], [], "d", color=MEASURED, markersize=4, mfc="none", label="measured, the other one")
    axis.plot([], [], "o", color=COARSE, label="inferred from the front, coarse cells")
    axis.plot([], [], "o", color=FINE, label="inferred from the front, fine cells")
    axis.set_yticks(places, [f"{each.experiment}, {each.case.name}" for each in findings.angles], fontsize=8)
    axis.set_xlabel("angle of friction [deg]")
    axis.set_title("Backward", loc="left", fontsize=10)
