"""The section about layers of different velocities."""

from collections.abc import Mapping, Sequence

from inverse.report.markdown import table
from validation.bench.accuracy.page import paragraph
from validation.bench.surrogate.columns import BARS, ENERGY_BAR
from validation.bench.surrogate.courses import Comparison
from validation.bench.surrogate.figures import off, per_cent

PAPER_MSE = {"surrogate": 3.41e-4, "mpm": 8.70e-4}
"""The paper's losses [m^2] at the velocities that it found: its surrogate's, and its MPM's run again with them."""


def text(found: Mapping[str, Sequence[Comparison]], seeds: int) -> list[str]:
    """The section."""
    rows = []
    for name, group in found.items():
        for each in group:
            rows.append(
                [
                    name,
                    f"`{each.model}`",
                    each.start,
                    f"{1e4 * each.mse:.2f}",
                    f"{1e4 * each.mpm_mse:.2f}",
                    off(each.front_error, BARS[True]),
                    off(each.thinned_front_error, BARS[True]),
                    per_cent(each.scatter),
                    per_cent(each.profile_error),
                    per_cent(each.kinetic_error, ENERGY_BAR),
                    per_cent(each.potential_error, ENERGY_BAR),
                ]
            )
    head = ["velocities, lowest layer first", "model", "start", "point MSE [1e-4 m²]", "MPM's own"]
    tail = ["front, all points", "same points", "MPM's scatter", "profile", "kinetic energy", "potential energy"]
    return [
        "## Layers of different velocities",
        "",
        *paragraph(f"""
            `layers-10`, ten layers of 28 mm, 30°: with the paper's velocities (1.5 m/s at the floor to 0.15 m/s at the
            top), with the same from the top down, and with others drawn from 0 to 1.5 m/s. The point MSE is that of the
            deposit's points from the MPM's, here with the velocities given. The paper's surrogate has
            {1e4 * PAPER_MSE["surrogate"]:.2f}, its MPM {1e4 * PAPER_MSE["mpm"]:.2f}, both with the velocities that its
            inversion found, so it is no like-for-like figure. "MPM's own": between deposits of the MPM that differ in
            the jitter alone ({seeds} seeds), which no surrogate can be asked to beat.
        """),
        *table([*head, *tail], rows),
        "",
        "![energy over time](gns-energy.png)",
        "",
    ]
