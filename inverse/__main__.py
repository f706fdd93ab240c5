"""`python -m inverse PROBLEM --out DIR`: one inversion, by the surrogate or by the MPM, and what it cost."""

import dataclasses
import sys
import time
from enum import StrEnum
from pathlib import Path

import numpy as np

from datasets.command_line import run
from datasets.errors import InputError
from gns import checkpoint
from gns.rollout import SHIPPED
from inverse import observations, report
from inverse.finite_difference import central
from inverse.gns_forward import MEMORY_GIB, GnsForward, GnsSource
from inverse.gradient import automatic
from inverse.inversion import invert
from inverse.mpm_forward import MpmForward
from inverse.problem import read_problem
from inverse.target import read_target
from inverse.unknowns import with_unknowns
from mpm.simulate import simulate, simulate_many


class Gradient(StrEnum):
    """Where the gradient comes from."""

    AD = "ad"
    """Reverse-mode automatic differentiation through the whole rollout."""
    FD = "fd"
    """Central differences."""


class ForwardModel(StrEnum):
    """What predicts the observation."""

    GNS = "gns"
    MPM = "mpm"


def main(
    problem: str,
    /,
    *,
    out: Path,
    gradient: Gradient | None = None,
    forward: ForwardModel = ForwardModel.GNS,
    model: Path = SHIPPED,
    memory_gib: float = MEMORY_GIB,
) -> None:
    """Find the unknowns of PROBLEM; leaves OUT/result.json, OUT/report.md and pictures.

    The MPM does not check the answer, so the verdict is "unconfirmed"; `python -m validation.loop` asks it.

    Parameters
    ----------
    problem
        Path of a problem in TOML, or the name of a shipped one.
    out
        Folder for the results.
    gradient
        Automatic differentiation, or central differences; the MPM has only the latter.
    forward
        What predicts the observation: the surrogate or the MPM.
    model
        Weights of the surrogate.
    memory_gib
        Activations that the backward pass may find ready, instead of computing them again.
    """
    asked = read_problem(problem)
    if forward is ForwardModel.MPM and gradient is Gradient.AD:
        raise InputError("expected --gradient fd, the MPM has no automatic gradient", where="--forward mpm")
    if memory_gib < 0.0:
        raise InputError(f"expected at least 0 GiB, got {memory_gib:g}", where="--memory-gib")
    observation = observations.build(asked.observation, asked.scene)
    mpm_seconds = 0.0
    chosen: GnsForward | MpmForward = MpmForward(asked, observation, simulate_many)
    if forward is ForwardModel.GNS:
        source = GnsSource(checkpoint.load(model).simulator, asked, observation, memory_gib)
        names = [unknown.name for unknown in asked.unknowns]
        initial = with_unknowns(asked.scene, names, [unknown.initial for unknown in asked.unknowns])
        began = time.perf_counter()
        chosen = source.start(simulate(source.first_frames(initial)))
        mpm_seconds = time.perf_counter() - began
    target = read_target(asked, observation, simulate)
    if isinstance(chosen, GnsForward) and gradient is not Gradient.FD:
        result = invert(asked, target, automatic(chosen, target.values))
    else:
        result = invert(asked, target, central(chosen, target.values, asked))
    if isinstance(chosen, MpmForward):
        mpm_seconds = result.total_seconds
    result = dataclasses.replace(result, mpm_seconds=mpm_seconds)
    result.write(out)
    report.write(result, chosen.deposit(result.answer), out)
    print(np.array2string(result.answer, precision=3))


if __name__ == "__main__":
    sys.exit(run(main, "python -m inverse"))
