"""python -m validation.bench.speed.gradient_run POINTS STEPS: one gradient through a rollout, and what it took, as JSON.

A process of its own for each: memory that another case left behind would count otherwise.
"""

import dataclasses
import json
import math
import sys
import time
from pathlib import Path

import torch

from datasets.command_line import WorkFailed, run
from datasets.errors import InputError
from gns.inference import SHIPPED
from gns.model import checkpoint
from gns.model.simulator import Simulator
from gns.model.state import Conditions, State
from gns.unroll import step_activation_bytes, unroll
from validation.bench.speed.columns import dam
from validation.report.memory import forgotten, peak, resident


@dataclasses.dataclass(frozen=True, kw_only=True)
class Took:
    """What a gradient took."""

    points: int
    steps: int
    kept: int
    """Steps whose activations stay."""
    forward: float
    """[s]."""
    backward: float
    """[s]."""
    before: int
    """Held before: the interpreter, PyTorch, the model, the points [bytes]."""
    peak: int
    """The most that was ever held, that included [bytes]."""
    clean: bool
    """Whether the peak is that of the gradient alone, or may be that of the program's start."""
    activations: int
    """Of one step, by `gns.unroll.step_activation_bytes` [bytes]."""

    @property
    def extra(self) -> int:
        """Peak above what was held before [bytes]."""
        return self.peak - self.before

    @property
    def seconds(self) -> float:
        """Forward and backward [s]."""
        return self.forward + self.backward


def gradient(
    simulator: Simulator, state: State, conditions: Conditions, steps: int, kept: int, *, progress: bool
) -> tuple[float, float]:
    """Seconds forward and backward of the gradient of the last mean position with respect to one friction for all."""
    begin = time.perf_counter()
    friction = conditions.friction[0].clone().requires_grad_()
    unknown = dataclasses.replace(conditions, friction=friction.expand_as(conditions.friction))
    end = unroll(simulator, state, unknown, steps, kept_steps=kept, progress=progress)[-1, :, 0].mean()
    middle = time.perf_counter()
    end.backward()  # type: ignore[no-untyped-call]
    if friction.grad is None or not math.isfinite(friction.grad.item()):
        raise WorkFailed(f"the gradient through {steps} steps is no finite number")
    return middle - begin, time.perf_counter() - middle


def took(model: Path, points: int, steps: int, kept: int, *, progress: bool = False) -> Took:
    """Run one gradient in this process."""
    simulator = checkpoint.load(model).simulator.requires_grad_(False)
    # What is compiled and set up at the first call is no part of it.
    gradient(simulator, *dam(simulator.settings, min(points, 200)), 2, 1, progress=False)
    state, conditions = dam(simulator.settings, points)
    clean = forgotten()
    before = resident() or peak()
    forward, backward = gradient(simulator, state, conditions, steps, kept, progress=progress)
    most = peak()
    return Took(
        points=points,
        steps=steps,
        kept=kept,
        forward=forward,
        backward=backward,
        before=before,
        peak=most,
        clean=clean,
        activations=step_activation_bytes(simulator, state, conditions),
    )


def command(
    points: int, steps: int, /, *, kept: int = 0, model: Path = SHIPPED, threads: int = 1, progress: bool = False
) -> None:
    """One gradient of a dam's flow with respect to its friction; prints seconds and peak memory [bytes] as JSON.

    Parameters
    ----------
    points
        Points of the dam.
    steps
        Steps of the rollout.
    kept
        Steps whose activations stay in memory.
    model
        The model's file.
    threads
        Threads of PyTorch.
    progress
        Show the steps of the forward pass.
    """
    if points < 1 or steps < 1:
        raise InputError(f"expected at least 1 point and 1 step, got {points} and {steps}", key="POINTS STEPS")
    if not 0 <= kept <= steps:
        raise InputError(f"expected 0 to {steps} steps, got {kept}", key="--kept")
    torch.set_num_threads(threads)
    print(json.dumps(dataclasses.asdict(took(model, points, steps, kept, progress=progress))))


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.bench.speed.gradient_run"))
