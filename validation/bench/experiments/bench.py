"""`python -m validation.bench experiments`: every experiment forward and backward, a page, a picture."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from datasets.measures import Positions
from datasets.scene import Scene
from mpm import AT_REST
from validation.bench.experiments.computed import compute, with_cells
from validation.bench.experiments.page import draw, write
from validation.experiments.experiment import FOLDER, read_experiments
from validation.runs import Run, RunStore

QUICK_FACTOR = 2.0
QUICK_ROUNDS = 2


def bench(out: Path, *, quick: bool, keep: Path, experiments: Path = FOLDER) -> str:
    """Run all experiments in the folder `experiments`: experiments.md and its picture.

    quick: on cells twice as large, in 2D alone, with fewer runs for an angle. Raises InputError for an experiment that
    cannot be read.
    """
    shipped = read_experiments(experiments)
    run = partial(deposits_of, RunStore(keep))
    if quick:
        flat = [
            each
            for each in shipped
            if each.scene(each.experiment.cases[0].scene, each.experiment.cells[0], 25.0).dimension == 2
        ]
        findings = compute([with_cells(each, QUICK_FACTOR) for each in flat], run, rounds=QUICK_ROUNDS)
    else:
        findings = compute(shipped, run)
    draw(out / "experiments.png", findings)
    return write(out / "experiments.md", findings, quick=quick)


def deposits_of(store: RunStore, scenes: Sequence[Scene]) -> list[Positions]:
    """The deposits [m] of scenes, each of shape [N, D], at rest or at their end."""
    return [flow.positions[-1] for flow in store.run([Run(scene=scene, record=AT_REST) for scene in scenes])]
