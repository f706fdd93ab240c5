"""`python -m inverse.adapt PROBLEM --out RUN`: trains a surrogate for the problem at hand."""

import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from datasets.command_line import run


class _Callable(ModuleType):
    """This module, callable: importing it hides the function `inverse.adapt`, so the module acts as that function."""

    def __call__(self, *args: Any, **options: Any) -> Path:
        from inverse.adaptation import adapt

        return adapt(*args, **options)


sys.modules[__name__].__class__ = _Callable


def main(
    problem: str,
    /,
    *,
    out: Path,
    runs: int = 64,
    minutes: float = 2.0,
    model: Path | None = None,
    jobs: int | None = None,
    seed: int = 0,
) -> None:
    """Run the MPM at points throughout the bounds of PROBLEM, and correct a model with these flows.

    Writes OUT/best.safetensors, its card OUT/best.json with scores and bands on held-out flows, and OUT/data. Use the
    model with --model OUT in `validation.loop`, `inverse` and `gns.rollout`. Running the same command again resumes an
    interrupted adaptation; with more --runs or another --model, the training begins anew.

    Args:
        problem: Path of a problem in TOML, or the name of a shipped one.
        out: Folder of the model and its data.
        runs: Number of MPM runs, of which every fifth is held out.
        minutes: Time to train [min], without the MPM runs.
        model: The model to start from, a file or a folder; by default, the one that ships for 2D or 3D.
        jobs: Number of parallel MPM processes; by default, one per processor.
        seed: Seed of the parameters, of the jitters and of the samples.
    """
    # Imported here: torch takes seconds to load, and --help does not need it.
    import torch

    from inverse.adaptation import adapt

    torch.set_num_threads(1)
    adapt(problem, out, runs=runs, minutes=minutes, model=model, jobs=jobs, seed=seed)


if __name__ == "__main__":
    sys.exit(run(main, "python -m inverse.adapt"))
