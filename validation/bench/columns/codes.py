"""python -m validation.bench.columns.codes --out DIR: fronts of columns beside those of other codes and of experiments."""

import dataclasses
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from datasets.command_line import run
from datasets.files import write_text
from validation.bench.columns import codes_page as peers_report
from validation.bench.columns.collapse import half_column, measured
from validation.bench.columns.fronts import Front, read_peers
from validation.bench.columns.scaling_laws import read_laws
from validation.runs import Run, RunStore

ASPECTS = (0.5, 1.0, 2.0, 4.0, 8.0)
CELLS = (16, 32)
"""Across the smaller of length and height."""
SEEDS = {16: 4, 32: 1}
"""Jitters by cells; at the highest aspect ratios one does."""
OURS = {"Talus AFLIP": None, "Talus APIC": 0.0}
"""Relaxation times of our transfers; None is the default."""


def our_runs(aspects: Sequence[float], seeds: Mapping[int, int]) -> dict[Front, Run]:
    """Our columns by what they stand for; fronts still zero."""
    runs = {}
    for name, relaxation in OURS.items():
        for cells, count in seeds.items():
            for aspect in aspects:
                for seed in range(count if aspect <= 2.0 else 1):
                    code, transfer = name.split()
                    what = Front(
                        code=code,
                        transfer=transfer,
                        aspect=aspect,
                        cells=cells,
                        seed=seed,
                        front=0.0,
                        runout=0.0,
                        height=0.0,
                    )
                    scene = dataclasses.replace(half_column(aspect, cells, seed=seed), relaxation_time=relaxation)
                    runs[what] = Run(scene=scene, until_rest=True)
    return runs


def command(*, out: Path, keep: Path = Path("runs/peers"), quick: bool = False) -> None:
    """Fronts of half columns of aspect ratio 0.5 to 8 by AFLIP and by APIC, beside other codes and experiments.

    Parameters
    ----------
    out
        Folder for peers.md and peers.png.
    keep
        Folder for the deposits; what is there is not run again.
    quick
        Low columns on coarse grids alone, to try the command; their figures mean nothing.
    """
    runs = our_runs(ASPECTS[:2], {5: 1, 8: 1}) if quick else our_runs(ASPECTS, SEEDS)
    ours = []
    for what, flow in zip(runs, RunStore(keep).run(list(runs.values())), strict=True):
        found = measured(what.aspect, flow.positions[-1], flow.summary["rest_time"])
        ours.append(dataclasses.replace(what, front=found.front, runout=found.runout, height=found.height))
    others = read_peers()
    fronts = [*ours, *others.fronts]
    laws = [law for law in read_laws() if law.dimension == 2 and law.quantity == "runout"]
    peers_report.draw(out / "peers.png", fronts, laws)
    write_text(out / "peers.md", peers_report.text(fronts, others.codes, laws))


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.bench.columns.codes"))
