"""python -m validation.bench.speed.ablation --data DIR --runs DIR --out DIR: which choice is worth its training time.

One choice is changed at a time; all variants train for the same processor time on the same flows and are scored on the
same rollouts, of the test split. A variant whose run is there already is not trained again.
"""

import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from datasets import files
from datasets.command_line import WorkFailed, run
from datasets.errors import InputError
from datasets.training.samples import load_flows
from gns.model import checkpoint
from gns.score import Score, evaluate
from gns.train import pick
from validation.report.machine import GNS, machine

DATASETS = ("releases2d", "flow2d", "layers2d")
SCHEDULE = (1, 2, 4, 8, 12)
"""Steps to train through, in equal shares of the time."""
FLOWS = 8
"""Test flows of each dataset that are rolled out."""


@dataclass(frozen=True, kw_only=True)
class Variant:
    """One choice made otherwise."""

    name: str
    """Name of its run."""
    what: str
    """What is different."""
    flags: tuple[str, ...] = ()
    """Of `python -m gns.train`."""
    schedule: tuple[int, ...] = SCHEDULE


VARIANTS = (
    Variant(name="base", what="10 ms steps, 1 point per 10 mm, 64 wide, 4 layers, grid of 20 mm, 3 past displacements"),
    Variant(name="step-20ms", what="steps of 20 ms", flags=("--frames-per-step", "8")),
    Variant(name="coarse-20mm", what="1 point per 20 mm, radius 50 mm", flags=("--cell", "0.02", "--radius", "0.05")),
    Variant(name="width-128", what="128 wide", flags=("--width", "128")),
    Variant(name="layers-2", what="2 layers", flags=("--layers", "2")),
    Variant(name="grid-40mm", what="grid of 40 mm", flags=("--grid-cell", "0.04")),
    Variant(name="grid-off", what="no convolutions on the grid", flags=("--grid-layers", "0")),
    Variant(name="history-1", what="1 past displacement", flags=("--history", "1")),
    Variant(name="past-accelerations", what="past accelerations too", flags=("--past-accelerations",)),
    Variant(name="film", what="FiLM by the material in every layer", flags=("--film",)),
    Variant(name="single-steps", what="trained on single steps with noise only", schedule=(1,)),
    Variant(name="no-noise", what="no noise while training on single steps", flags=("--noise", "0")),
    Variant(name="rate-3e-3", what="learning rate 3e-3", flags=("--learning-rate", "3e-3")),
    Variant(name="wide-loss", what="loss squared up to twice the accelerations", flags=("--loss-scale", "2")),
    Variant(
        name="both",
        what="FiLM and past accelerations, steps of 20 ms",
        flags=("--film", "--past-accelerations", "--frames-per-step", "8"),
    ),
)


def command(*, data: Path, runs: Path, out: Path, minutes: float = 3.0, jobs: int = 1) -> None:
    """Train each variant for some minutes of processor time, and write OUT/ablation.md.

    Parameters
    ----------
    data
        Folder that holds releases2d, flow2d and layers2d as `python -m mpm.generate` made them.
    runs
        Folder of the runs; those that are complete are kept.
    out
        Folder for ablation.md.
    minutes
        Processor time of each training, on one thread.
    jobs
        Trainings at once.
    """
    if jobs < 1:
        raise InputError(f"expected at least 1 job, got {jobs}", key="--jobs")
    torch.set_num_threads(1)
    folders = [data / name for name in DATASETS]
    with ThreadPoolExecutor(jobs) as executor:
        trained = executor.map(lambda variant: train(variant, folders, runs, minutes), VARIANTS)
        for _ in tqdm(trained, total=len(VARIANTS), desc="trainings", unit="run"):
            pass
    rows = [row(variant, folders, runs / variant.name) for variant in tqdm(VARIANTS, desc="scores", unit="run")]
    files.write_text(out / "ablation.md", page(rows, minutes))


def train(variant: Variant, folders: Sequence[Path], runs: Path, minutes: float) -> None:
    """One training, unless it is there. Raises WorkFailed."""
    folder = runs / variant.name
    if (folder / "scores.md").exists():
        return
    schedule = [word for steps in variant.schedule for word in ("--unroll", str(steps))]
    arguments = [*map(str, folders), "--out", str(folder), "--minutes", f"{minutes:g}", "--clock", "cpu", *schedule]
    # So little trained a network has errors that standing still would hide.
    arguments += ["--rest-speed", "0"]
    # Scored once, at the end: validations would eat into the minutes.
    arguments += ["--validate-minutes", f"{100.0 * minutes:g}", *variant.flags]
    if (folder / "last.pt").exists():
        arguments.append("--resume")
    done = subprocess.run([sys.executable, "-m", "gns.train", *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise WorkFailed(f"{variant.name}: {done.stderr.strip().splitlines()[-1]}")


def row(variant: Variant, folders: Sequence[Path], folder: Path) -> str:
    """What a variant scores, as a row of the table."""
    model = checkpoint.load(folder / "best.pt")
    settings = model.simulator.settings
    scores: list[Score] = []
    for dataset in folders:
        flows = load_flows(dataset, "test", step=settings.step, dimension=settings.dimension)
        scores += evaluate(model.simulator, pick(flows, FLOWS), seed=0)
    released = [score for score in scores if score.released]
    parameters = sum(weight.numel() for weight in model.simulator.parameters())
    cells = [
        variant.what,
        f"{parameters / 1000:.0f} K",
        str(model.provenance["log"]["updates"]),
        percent([abs(score.front_error) for score in released]),
        percent([abs(score.front_error) for score in scores]),
        percent([score.profile_error for score in released]),
        percent([score.profile_error for score in scores]),
        *(f"{1.0e4 * np.mean([score.rmse[time] ** 2 for score in scores]):.1f}" for time in range(3)),
        percent([score.kinetic_error for score in scores]),
        f"{np.mean([score.seconds for score in scores]):.2f}",
    ]
    return "| " + " | ".join(cells) + " |"


def percent(values: Sequence[float]) -> str:
    """Their mean."""
    return f"{100.0 * np.mean(values):.1f} %"


def page(rows: Sequence[str], minutes: float) -> str:
    """ablation.md."""
    return "\n".join(
        [
            "# Which choice is worth its training time",
            "",
            f"Each line is a model trained for {minutes:g} minutes of processor time on one thread, on",
            f"{', '.join(DATASETS)}, with one choice changed, and scored on {FLOWS} flows of the test split of each:",
            "whole rollouts from the MPM's first 0.05 s, beside the MPM on the same points. Made by",
            "",
            "    python -m validation.bench.speed.ablation --data data --runs runs/ablation --out docs",
            "",
            f"on {machine(GNS)}.",
            "",
            "Front: mean of the absolute errors; profile: area between the height profiles over the deposit's; MSE: of",
            "the points at a quarter, half and the end of the flow; kinetic: largest difference of kinetic energies",
            "over the initial energy; time: of one rollout, four side by side.",
            "",
            "| variant | parameters | updates | front, released | front, all | profile, released | profile, all "
            "| MSE 1/4 [cm²] | 1/2 | end | kinetic | time [s] |",
            "|---|---|---|---|---|---|---|---|---|---|---|---|",
            *rows,
            "",
            "All are far from trained: the table says which choice learns faster, not where each would end, and",
            "another seed of the weights moves every number; read it for the large differences.",
            "",
        ]
    )


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.bench.speed.ablation"))
