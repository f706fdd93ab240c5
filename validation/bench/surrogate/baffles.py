"""The section about 3D flows against baffles."""

from collections.abc import Mapping, Sequence

from datasets.measures import UPSTREAM
from inverse.report.markdown import table
from validation.bench.accuracy.page import paragraph
from validation.bench.surrogate.columns import ENERGY_BAR
from validation.bench.surrogate.courses import Comparison
from validation.bench.surrogate.figures import off, per_cent

BAR = 0.03
"""Of runout and front [-]."""
PAPER_RUNOUT = {"baffles-5": 0.0087}
"""Runout error [-] of the paper's surrogate (its appendix)."""


def text(found: Mapping[str, Sequence[Comparison]]) -> list[str]:
    """The section."""
    rows = []
    for name, group in found.items():
        for each in group:
            paper = PAPER_RUNOUT.get(name)
            rows.append(
                [
                    f"`{name}`",
                    f"`{each.model}`",
                    each.start,
                    f"{off(each.runout_error, BAR)}, {off(each.thinned_runout_error, BAR)}",
                    "-" if paper is None else per_cent(paper),
                    f"{off(each.front_error, BAR)}, {off(each.thinned_front_error, BAR)}",
                    per_cent(each.scatter),
                    f"{per_cent(each.mean_depth_error)} ({per_cent(each.depth_error)})",
                    per_cent(each.profile_error),
                    " / ".join(f"{1000.0 * moment:.0f}" for moment in each.rmse),
                    per_cent(each.kinetic_error, ENERGY_BAR),
                    per_cent(each.potential_error, ENERGY_BAR),
                ]
            )
    head = ["scene", "model", "start", "runout: all, same points", "the paper's", "front: all, same points"]
    tail = ["profile", "points at 1/4, 1/2, end [mm]", "kinetic energy", "potential energy"]
    wall = [name for name, (each, *_) in found.items() if each.at_wall]
    touching = (
        f"In {', '.join(wall)} the furthest points reach the far wall, so the runout says little there." if wall else ""
    )
    return [
        "## Baffles in 3D",
        "",
        *paragraph(f"""
            The paper's two scenes, in boxes that the training data do not have. Runout is the largest x, the front has
            99.5 % of the points behind it; bar {100 * BAR:g} %. {touching} Upstream depth: mean over strips
            {UPSTREAM:g} m long before each baffle of the first row, as wide as the baffle; its error is the mean over
            time (in brackets the largest) over the MPM's greatest depth. The profile is summed over z. Energy as above,
            bar {100 * ENERGY_BAR:g} %.
        """),
        *table([*head, "MPM's scatter", "upstream depth", *tail], rows),
        "",
        "![deposits from above](gns-baffles.png)",
        "",
        "![front, upstream depth and energy over time](gns-baffles-time.png)",
        "",
    ]
