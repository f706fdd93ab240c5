"""`python -m gns.train`: fit a model to trajectories of the MPM, within a budget of minutes or updates."""

import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter
from cyclopts.types import PositiveInt

from datasets import command_line
from gns.settings import ModelSettings, TrainingSettings

TRAINING = TrainingSettings()


def train(
    *datasets: Path,
    out: Path,
    resume: bool = False,
    begin: Path | None = None,
    seed: int = 0,
    threads: PositiveInt = 1,
    device: Literal["cpu", "cuda"] | None = None,
    model: Annotated[ModelSettings | None, Parameter(name="*")] = None,
    training: Annotated[TrainingSettings, Parameter(name="*")] = TRAINING,
) -> None:
    """Train a graph network simulator on trajectories of the MPM.

    Leaves OUT/best.safetensors (the model to use) with its card OUT/best.json, OUT/last.pt (what --resume continues),
    OUT/log.csv, OUT/log.png and OUT/scores.md. Ctrl-C finishes the update in progress and leaves OUT/last.pt. On
    several GPUs or processes: torchrun --nproc-per-node N -m gns.train ...

    Args:
        datasets: Dataset folders made by `python -m mpm.generate`.
        out: Folder of the run.
        resume: Continue from OUT/last.pt; give the other flags again.
        begin: A model to begin with instead of random weights: a file or the name of a shipped one. It keeps its
            normalisation and its settings; if settings are given, all but --rest-speed must equal its own.
        seed: Seed of the weights and of the samples.
        threads: Number of torch threads.
        device: cpu or cuda; unless given, a GPU if there is one.
    """
    # Imported here, so that --help need not load torch, which takes seconds.
    import torch

    from gns import checkpoint
    from gns.library import model_path
    from gns.training.loop import fit

    torch.set_num_threads(threads)
    begun = None if begin is None else checkpoint.load(model_path(begin))
    if model is None:
        model = ModelSettings() if begun is None else begun.simulator.settings
    fit(datasets, out, model=model, training=training, begin=begun, resume=resume, seed=seed, device=device)


if __name__ == "__main__":
    sys.exit(command_line.run(train, "python -m gns.train"))
