"""python -m validation.columns --out DIR: the paper's four columns in our MPM, beside the paper's runouts."""

import dataclasses
import math
import sys
from pathlib import Path

import numpy as np

from datasets.command_line import run
from datasets.files import write_text
from datasets.library import read_scene
from datasets.measures import front, runout
from datasets.scene import Domain, Scene
from mpm.recording import LAST
from mpm.simulate import simulate_many
from validation.paper import read_paper

CELLS = (0.01, 0.005)
STEPS = (0.9, 0.4)
DAMPINGS = (0.12, 0.0)


def variant(scene: Scene, *, cell: float, step_fraction: float, damping: float, seed: int) -> Scene:
    """`scene` on another grid, at another step, with other damping and another jitter."""
    return dataclasses.replace(
        scene,
        domain=Domain(size=scene.domain.size, cell=cell),
        step_fraction=step_fraction,
        damping=damping,
        seed=seed,
    )


def command(*, out: Path, seeds: int = 4) -> None:
    """Compare the runout of the paper's four columns with ours: damped and not, on two grids, at two steps.

    Parameters
    ----------
    out
        Folder for columns.md.
    seeds
        Jitters per column; the table gives their mean, and the standard deviation over them.
    """
    paper = {scenario.name: scenario.runout for scenario in read_paper().scenarios}
    lines = [
        "| damping | cell [m] | step | " + " | ".join(paper) + " | rms deviation |",
        "|---|---|---|" + "---|" * (len(paper) + 1),
        "| the paper | 0.01 | | " + " | ".join(f"{d:.4f}" for d in paper.values()) + " | |",
    ]
    fronts = []
    for damping in DAMPINGS:
        for cell in CELLS:
            for step_fraction in STEPS:
                columns, deviations = [], []
                for name, stated in paper.items():
                    scene = read_scene(f"column-{name}")
                    flows = simulate_many(
                        [
                            variant(scene, cell=cell, step_fraction=step_fraction, damping=damping, seed=seed)
                            for seed in range(seeds)
                        ],
                        record=LAST,
                    )
                    d = np.array([runout(flow.positions[-1]) for flow in flows])
                    x = np.array([front(flow.positions[-1]) for flow in flows])
                    columns.append(f"{d.mean():.4f} ± {d.std(ddof=1):.4f}")
                    deviations.append(d.mean() / stated - 1.0)
                    if (damping, cell, step_fraction) == (DAMPINGS[0], CELLS[0], STEPS[0]):
                        fronts.append(f"| {name} | {x.mean():.4f} | {x.std(ddof=1) * 1000:.1f} |")
                rms = math.sqrt(np.mean(np.square(deviations)))
                lines.append(
                    f"| {damping:g} | {cell:g} | {step_fraction:g} | " + " | ".join(columns) + f" | {100 * rms:.1f} % |"
                )
                print(lines[-1], flush=True)
    text = "\n".join(
        [
            "# The paper's columns",
            "",
            f"`python -m validation.columns --seeds {seeds}`: runout d [m] (largest x) at 1 s, mean and standard",
            "deviation over the jitter seeds; step as a fraction of cell / wave speed; runs side by side on all cores.",
            "",
            *lines,
            "",
            f"Front (99.5 % of the points behind) at damping {DAMPINGS[0]:g}, cell {CELLS[0]:g} m, step {STEPS[0]:g}:",
            "",
            "| column | front [m] | scatter over jitter seeds [mm] |",
            "|---|---|---|",
            *fronts,
            "",
        ]
    )
    write_text(out / "columns.md", text)


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.columns"))
