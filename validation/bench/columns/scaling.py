"""python -m validation.bench.columns.scaling --out DIR: how far columns run over their aspect ratio, beside the experiments."""

import sys
from collections.abc import Sequence
from pathlib import Path

from datasets.command_line import run
from datasets.files import write_text
from datasets.particles import particle_count
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from mpm import AT_REST, simulate, simulate_many
from mpm.simulation import LARGE
from validation.bench.columns import scaling_page as scaling_report
from validation.bench.columns.collapse import (
    FRICTION_DEG,
    Deposit,
    half_column,
    measured,
    quarter_cylinder,
    volume_error,
)
from validation.bench.columns.scaling_laws import Series, read_laws

ASPECTS_2D = tuple(0.5 * 2.0 ** (number / 3.0) for number in range(13))
ASPECTS_3D = tuple(0.5 * 2.0 ** (number / 2.0) for number in range(9))
CELLS = {2: 32, 3: 14}
"""Across the smaller of length and height, by dimension."""
OTHER_ANGLES = (25.0, 35.0)
"""Angles of friction [deg], grains and floor alike, tried in 2D on half the cells."""


def collapse(scenes: Sequence[Scene], aspects: Sequence[float]) -> tuple[Deposit, ...]:
    """Let columns go until they rest: small ones side by side, large ones one after the other."""
    sizes = [particle_count(scene) for scene in scenes]
    small = [index for index, size in enumerate(sizes) if size < LARGE]
    flows: dict[int, Trajectory] = {}
    if small:
        flows |= zip(small, simulate_many([scenes[index] for index in small], record=AT_REST), strict=True)
    for index in set(range(len(scenes))) - set(small):
        flows[index] = simulate(scenes[index], record=AT_REST)
    return tuple(
        measured(aspect, flows[index].positions[-1], flows[index].summary["rest_time"])
        for index, aspect in enumerate(aspects)
    )


def series_2d(cells: int, seeds: int, friction_deg: float) -> Series:
    """Half columns."""
    # The dearest first, so that little is left to wait for at the end.
    columns = [(aspect, seed) for aspect in reversed(ASPECTS_2D) for seed in range(seeds)]
    scenes = [half_column(aspect, cells, friction_deg=friction_deg, seed=seed) for aspect, seed in columns]
    deposits = collapse(scenes, [aspect for aspect, _ in columns])
    return Series(dimension=2, cells=cells, friction_deg=friction_deg, deposits=deposits)


def series_3d(cells: int, friction_deg: float) -> Series:
    """Quarters of cylinders."""
    scenes = [quarter_cylinder(aspect, cells, friction_deg=friction_deg) for aspect in ASPECTS_3D]
    return Series(
        dimension=3,
        cells=cells,
        friction_deg=friction_deg,
        deposits=collapse(scenes, ASPECTS_3D),
        volume_error=max((volume_error(scene) for scene in scenes), key=abs),
    )


def command(*, out: Path, seeds: int = 2) -> None:
    """Runout and final height of collapsing columns over aspect ratios 0.5 to 8, in 2D and of cylinders in 3D.

    Parameters
    ----------
    out
        Folder for scaling.md and its picture.
    seeds
        Jitters per column in 2D.
    """
    main = (series_2d(CELLS[2], seeds, FRICTION_DEG), series_3d(CELLS[3], FRICTION_DEG))
    others = (
        series_2d(CELLS[2] // 2, seeds, FRICTION_DEG),
        *(series_2d(CELLS[2] // 2, seeds, angle) for angle in OTHER_ANGLES),
        series_3d(CELLS[3] // 2, FRICTION_DEG),
    )
    laws = read_laws()
    scaling_report.draw(out / "scaling.png", main, laws)
    write_text(out / "scaling.md", scaling_report.text(main, others, laws, seeds))


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.bench.columns.scaling"))
