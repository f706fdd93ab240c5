"""`python -m validation.bench case-history`: a friction back-analysed at field scale, a page, a picture."""

import dataclasses
from functools import partial
from pathlib import Path

from datasets.particles import initial_particles
from validation.bench.case_history.history import FOLDER, analyse, read_history
from validation.bench.case_history.page import draw, write
from validation.bench.experiments.bench import deposits_of
from validation.runs import RunStore

QUICK_FACTOR = 2.0


def bench(out: Path, *, quick: bool, keep: Path, history: Path = FOLDER / "yildiz-parabola") -> str:
    """Back-analyse the case history in the folder `history`: case-history.md and its picture.

    quick: on cells twice as large. Raises InputError for a history that cannot be read.
    """
    read = read_history(history)
    if quick:
        coarse, fine = read.history.cells
        twin = dataclasses.replace(read.history.twin, cell=QUICK_FACTOR * read.history.twin.cell)
        larger = dataclasses.replace(read.history, cells=(QUICK_FACTOR * coarse, QUICK_FACTOR * fine), twin=twin)
        read = dataclasses.replace(read, history=larger)
    twin = read.history.twin
    start = initial_particles(read.scene(twin.bed_friction, twin.cell, twin.seed)).positions
    found = analyse(read, partial(deposits_of, RunStore(keep)), start)
    draw(out / "case-history.png", found)
    return write(out / "case-history.md", found, quick=quick)
