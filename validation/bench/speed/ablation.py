"""`python -m validation.bench ablation`: which choice of the network or of its training lowers the error soonest.

One choice is changed at a time; all variants train for the same processor time on the same flows and are scored on the
same rollouts, of the test split.
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

from datasets.command_line import WorkFailed
from datasets.definitions import DEFINITIONS
from datasets.errors import InputError
from datasets.training.samples import load_flows
from gns.model import checkpoint
from gns.score import Score, evaluate
from gns.train import pick
from mpm.generate import generate
from mpm.process import processors
from validation.report.machine import GNS
from validation.report.page import Page, Row

DATASETS = ("releases2d", "flow2d", "layers2d")
SCHEDULE = (1, 2, 4, 8, 12)
"""Steps to train through, in equal parts of the time."""
FLOWS = 8
"""Test flows of each dataset that are rolled out."""
QUICK_COUNT, QUICK_MINUTES, QUICK_VARIANTS = 20, 0.1, 2


@dataclass(frozen=True, kw_only=True)
class Variant:
    """One choice that is changed."""

    name: str
    """Name of its run."""
    change: str
    flags: tuple[str, ...] = ()
    """Of `python -m gns.train`."""
    schedule: tuple[int, ...] = SCHEDULE


VARIANTS = (
    Variant(name="base", change="10 ms steps, 1 node per 10 mm, 64 wide, 4 layers, grid of 20 mm, 3 displacements"),
    Variant(name="step-20ms", change="steps of 20 ms", flags=("--frames-per-step", "8")),
    Variant(name="coarse-20mm", change="1 node per 20 mm, radius 50 mm", flags=("--cell", "0.02", "--radius", "0.05")),
    Variant(name="width-128", change="128 wide", flags=("--width", "128")),
    Variant(name="layers-2", change="2 layers", flags=("--layers", "2")),
    Variant(name="grid-40mm", change="grid of 40 mm", flags=("--grid-cell", "0.04")),
    Variant(name="grid-off", change="no convolutions on the grid", flags=("--grid-layers", "0")),
    Variant(name="history-1", change="1 past displacement", flags=("--history", "1")),
    Variant(name="past-accelerations", change="past accelerations too", flags=("--past-accelerations",)),
    Variant(name="film", change="FiLM by the material in every layer", flags=("--film",)),
    Variant(name="single-steps", change="trained on single steps with noise only", schedule=(1,)),
    Variant(name="no-noise", change="no noise while training on single steps", flags=("--noise", "0")),
    Variant(name="rate-3e-3", change="learning rate 3e-3", flags=("--learning-rate", "3e-3")),
    Variant(name="wide-loss", change="loss squared up to twice the accelerations", flags=("--loss-scale", "2")),
    Variant(
        name="both",
        change="FiLM and past accelerations, steps of 20 ms",
        flags=("--film", "--past-accelerations", "--frames-per-step", "8"),
    ),
)


@dataclass(frozen=True, kw_only=True)
class VariantScore:
    """A trained variant and its scores on test flows."""

    change: str
    parameters: int
    updates: int
    scores: tuple[Score, ...]

    @property
    def front(self) -> float:
        """Mean of the absolute front errors [-]."""
        return mean([abs(score.front_error) for score in self.scores])

    @property
    def profile(self) -> float:
        """Mean profile error [-]."""
        return mean([score.profile_error for score in self.scores])


def bench(out: Path, *, quick: bool, keep: Path, data: Path = Path("data"), minutes: float = 3.0, jobs: int = 1) -> str:
    """Train each variant for some minutes of processor time and score it.

    Parameters
    ----------
    out
        Folder for ablation.md.
    quick
        Two variants for a few seconds each, on small datasets that are generated in KEEP.
    keep
        Folder of the runs; those that are complete are not trained again.
    data
        Folder that holds releases2d, flow2d and layers2d as `python -m mpm.generate` made them.
    minutes
        Processor time of each training, on one thread.
    jobs
        Trainings at once.
    """
    if jobs < 1:
        raise InputError(f"expected at least 1 job, got {jobs}", key="--jobs")
    torch.set_num_threads(1)
    variants = VARIANTS[:QUICK_VARIANTS] if quick else VARIANTS
    if quick:
        data, minutes = keep / "data", QUICK_MINUTES
        for name in DATASETS:
            generate(DEFINITIONS[name], data / name, seed=0, count=QUICK_COUNT, jobs=processors())
    folders = [data / name for name in DATASETS]
    with ThreadPoolExecutor(jobs) as executor:
        trained = executor.map(lambda variant: train(variant, folders, keep, minutes), variants)
        for _ in tqdm(trained, total=len(variants), desc="trainings", unit="run"):
            pass
    found = [score(each, folders, keep / each.name) for each in tqdm(variants, desc="scores", unit="run")]
    command = f"python -m validation.bench ablation --minutes {minutes:g}"
    return page(found, minutes, command=command, quick=quick).write(out / "ablation.md")


def train(variant: Variant, folders: Sequence[Path], runs: Path, minutes: float) -> None:
    """One training, unless it is there. Raises WorkFailed."""
    folder = runs / variant.name
    if (folder / "scores.md").exists():
        return
    schedule = [word for steps in variant.schedule for word in ("--unroll", str(steps))]
    arguments = [*map(str, folders), "--out", str(folder), "--minutes", f"{minutes:g}", "--clock", "cpu", *schedule]
    # With a rest speed, errors of networks that are so little trained would not show.
    arguments += ["--rest-speed", "0"]
    # Scored once, at the end: validations would use some of the minutes.
    arguments += ["--validate-minutes", f"{100.0 * minutes:g}", *variant.flags]
    if (folder / "last.pt").exists():
        arguments.append("--resume")
    done = subprocess.run([sys.executable, "-m", "gns.train", *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise WorkFailed(f"{variant.name}: {done.stderr.strip().splitlines()[-1]}")


def score(variant: Variant, folders: Sequence[Path], folder: Path) -> VariantScore:
    """A trained variant on flows of the test splits."""
    model = checkpoint.load(folder / "best.pt")
    settings = model.simulator.settings
    scores: list[Score] = []
    for dataset in folders:
        flows = load_flows(dataset, "test", step=settings.step, dimension=settings.dimension)
        scores += evaluate(model.simulator, pick(flows, FLOWS), seed=0)
    return VariantScore(
        change=variant.change,
        parameters=sum(weight.numel() for weight in model.simulator.parameters()),
        updates=model.provenance["log"]["updates"],
        scores=tuple(scores),
    )


def mean(values: Sequence[float]) -> float:
    """Mean, nan of none."""
    return float(np.mean(values)) if values else float("nan")


def row(found: VariantScore) -> Row:
    """A variant as a line of the table."""
    released = [score for score in found.scores if score.released]
    mse = [1.0e4 * mean([score.rmse[time] ** 2 for score in found.scores]) for time in range(3)]
    return {
        "variant": found.change,
        "parameters": f"{found.parameters / 1000:.0f} K",
        "updates": found.updates,
        "front, released": mean([abs(score.front_error) for score in released]),
        "front, all": found.front,
        "profile, released": mean([score.profile_error for score in released]),
        "profile, all": found.profile,
        **dict(zip(("MSE 1/4 [cm²]", "1/2", "end"), (f"{each:.1f}" for each in mse), strict=True)),
        "kinetic": mean([score.kinetic_error for score in found.scores]),
        "time [s]": f"{mean([score.seconds for score in found.scores]):.2f}",
    }


def conclusion(found: Sequence[VariantScore]) -> list[str]:
    """The best and the worst variant by front and by profile, beside the first one."""
    base, sentences = found[0], []
    for name in ("front", "profile"):
        errors = {each.change: float(getattr(each, name)) for each in found}
        ordered = sorted(errors, key=lambda change: errors[change])
        better = sum(error < errors[base.change] for error in errors.values())
        sentences.append(
            f"Mean {name} error {errors[base.change]:.1%} with {base.change}; {better} of {len(found) - 1} changes"
            f" lower it. The lowest is {errors[ordered[0]]:.1%} ({ordered[0]}), the highest {errors[ordered[-1]]:.1%}"
            f" ({ordered[-1]})."
        )
    return sentences


def page(found: Sequence[VariantScore], minutes: float, *, command: str, quick: bool = False) -> Page:
    """ablation.md."""
    text = Page(
        "Choices of the network and its training",
        command=command,
        conclusion=conclusion(found),
        packages=GNS,
        quick=quick,
    )
    text.text(f"""
        Each line is a model trained for {minutes:g} minutes of processor time on one thread, on {", ".join(DATASETS)},
        with one choice changed, and scored on {FLOWS} flows of the test split of each: whole rollouts from the MPM's
        first 0.05 s, beside the MPM on the same particles.

        Front: mean of the absolute errors; profile: area between the height profiles over the deposit's; MSE: of the
        particles at a quarter, half and the end of the flow; kinetic: largest difference of kinetic energies over the
        initial energy; time: of one rollout, four side by side.
    """)
    percent = dict.fromkeys(("front, released", "front, all", "profile, released", "profile, all", "kinetic"), ".1%")
    text.table([row(each) for each in found], formats=percent)
    text.text("""
        None is fully trained: the table says which choice learns faster, not where each would end, and another seed of
        the weights changes every number.
    """)
    return text
