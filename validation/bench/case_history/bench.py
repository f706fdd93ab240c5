"""`python -m validation.bench case-history`: a friction back-analysed at field scale, a page, a picture."""

import dataclasses
from pathlib import Path

from datasets.files import write_text
from datasets.particles import initial_particles
from validation.bench.case_history.history import FOLDER, analyse, read_history
from validation.bench.case_history.page import draw, page, tables
from validation.bench.experiments.bench import deposits_of, runs_in
from validation.bench.experiments.computed import Simulate

NAME = "yildiz-parabola"
QUICK_FACTOR = 2.0


def bench(
    out: Path | None,
    *,
    quick: bool = False,
    keep: Path | None = None,
    folder: Path | None = None,
    simulate: Simulate | None = None,
) -> str:
    """Back-analyse the history in `folder` and return its table; with `out`, case-history.md and its picture there.

    quick: on cells twice as large. keep: where finished runs stay. simulate: in place of the MPM. Raises InputError for
    a history that cannot be read.
    """
    read = read_history(folder or FOLDER / NAME)
    if quick:
        history = read.history
        coarse, fine = history.cells
        twin = dataclasses.replace(history.twin, cell=QUICK_FACTOR * history.twin.cell)
        larger = dataclasses.replace(history, cells=(QUICK_FACTOR * coarse, QUICK_FACTOR * fine), twin=twin)
        read = dataclasses.replace(read, history=larger)
    twin = read.history.twin
    start = initial_particles(read.scene(twin.bed_friction, twin.cell, twin.seed)).positions
    with runs_in(keep) as folder_of_runs:
        found = analyse(read, simulate or (lambda scenes: deposits_of(scenes, folder_of_runs)), start)
    if out is not None:
        draw(out / "case-history.png", found)
        write_text(out / "case-history.md", page(found))
    return tables(found)
