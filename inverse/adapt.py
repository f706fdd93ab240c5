"""`python -m inverse.adapt PROBLEM --out RUN`: a surrogate that has learned the problem at hand."""

import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from datasets.command_line import run


class _Callable(ModuleType):
    """This module, which its import binds over the function `inverse.adapt`, and which is that function when called."""

    def __call__(self, *args: Any, **options: Any) -> Path:
        """See `inverse.adaptation.adapt`."""
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
    """Run the MPM at points throughout the bounds of PROBLEM, and correct a model by these flows.

    Leaves OUT/best.safetensors with its card OUT/best.json, scores and bands on flows that were held out, OUT/data.
    --model OUT then uses it in `validation.loop`, `inverse` and `gns.rollout`. Running the same command again finishes
    what is missing.

    Args:
        problem: Path of a problem in TOML, or the name of a shipped one.
        out: Folder of the model and its data.
        runs: Runs of the MPM, of which every fifth is held out.
        minutes: Time to train [min]; the runs come on top.
        model: The model to begin with, a file or a folder; unless given, the one that ships for 2D or for 3D.
        jobs: Processes of the MPM side by side; one per processor unless given.
        seed: Seed of the parameters, of the jitters and of the samples.
    """
    # Imported here: torch takes seconds to load, and help has no use for it.
    import torch

    from inverse.adaptation import adapt

    torch.set_num_threads(1)
    adapt(problem, out, runs=runs, minutes=minutes, model=model, jobs=jobs, seed=seed)


if __name__ == "__main__":
    sys.exit(run(main, "python -m inverse.adapt"))
