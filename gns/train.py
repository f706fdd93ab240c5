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
    OUT/log.csv, OUT/log.png and OUT/scores.md. Ctrl-C ends the update in progress and leaves OUT/last.pt. On several
    GPUs or processes: torchrun --nproc-per-node N -m gns.train ...

    Args:
        datasets: Folders that `python -m mpm.generate` made.
        out: Folder of the run.
        resume: Continue from OUT/last.pt; give the other flags again.
        begin: A model to begin with instead of random weights, a file or the name of a shipped one. Its normalisation
            stays, and its settings; where any are given, all must be its own but for --rest-speed.
        seed: Seed of the weights and of the samples.
        threads: Threads of torch.
        device: cpu or cuda; a GPU where there is one unless given.
    """
    # Here, because torch takes seconds, which --help should not.
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
