"""`python -m validation.bench experiments`: every experiment forward and backward, a score table, a page, a figure."""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from datasets.files import write_text
from datasets.measures import Positions
from datasets.scene import Scene
from validation.bench.experiments.computed import Simulate, compute, with_cells
from validation.bench.experiments.page import page, tables
from validation.bench.experiments.picture import draw
from validation.experiments.experiment import FOLDER, read_experiments
from validation.runs import Run, RunStore

QUICK_FACTOR = 2.0
QUICK_ROUNDS = 2


def bench(
    out: Path | None,
    *,
    quick: bool = False,
    keep: Path | None = None,
    folder: Path = FOLDER,
    simulate: Simulate | None = None,
) -> str:
    """Run all experiments of `folder` and return the score tables; with `out`, experiments.md and its picture there.

    quick: on cells twice as large, in 2D alone, with fewer runs for an angle: to try the command. keep: where
    finished runs stay. simulate: in place of the MPM. Raises InputError for an experiment that cannot be read.
    """
    shipped = read_experiments(folder)
    if quick:
        flat = [
            each
            for each in shipped
            if each.scene(each.experiment.cases[0].scene, each.experiment.cells[0], 25.0).dimension == 2
        ]
        shipped = [with_cells(each, QUICK_FACTOR) for each in flat]
    with runs_in(keep) as folder_of_runs:
        run = simulate or (lambda scenes: deposits_of(scenes, folder_of_runs))
        findings = compute(shipped, run, rounds=QUICK_ROUNDS) if quick else compute(shipped, run)
    if out is not None:
        draw(out / "experiments.png", findings)
        write_text(out / "experiments.md", page(findings, quick=quick))
    return tables(findings)


@contextmanager
def runs_in(keep: Path | None) -> Iterator[Path]:
    """The folder of finished runs: `keep`, or one that goes at the end."""
    if keep is not None:
        yield keep
        return
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


def deposits_of(scenes: Sequence[Scene], keep: Path) -> list[Positions]:
    """The deposits [m] of scenes, each of shape [N, D], at rest or at their end; runs are kept in `keep`."""
    flows = RunStore(keep).run([Run(scene=scene, until_rest=True) for scene in scenes])
    return [flow.positions[-1] for flow in flows]
