"""`python -m inverse PROBLEM --out DIR`: one inversion, by the surrogate or by the MPM, and what it cost."""

import dataclasses
import os
import sys
import time
from enum import StrEnum
from pathlib import Path

from datasets.command_line import run
from datasets.errors import InputError
from gns.inference import shipped
from gns import card
from gns.model import checkpoint
from inverse.finite_difference import central
from inverse.forward.gns import MEMORY_GIB, GnsForward, GnsSource
from inverse.forward.mpm import MpmForward
from inverse.gradient import automatic
from inverse.gradient_free import explore
from inverse.inversion import invert, unconfirmed
from inverse.observations.deposit import Observation, Values
from inverse.observations.measurements import prepare
from inverse.observations.target import Target
from inverse.parameters.parameters import kind, with_unknowns
from inverse.problem import Method, Problem, Surrogate, read_problem
from inverse.report import markdown as report
from inverse.result import Result
from mpm import simulate, simulate_many


class Gradient(StrEnum):
    """Where the gradient comes from."""

    AD = "ad"
    """Reverse-mode automatic differentiation through the whole rollout."""
    FD = "fd"
    """Central differences."""
    NONE = "none"
    """None at all: the optimiser's `sampler` proposes, `max_trials` is the budget."""


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
    forward: ForwardModel | None = None,
    model: Path | None = None,
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
        Automatic differentiation, the MPM has none; central differences, its default; or none, a search without.
    forward
        What predicts the observation: the surrogate, unless the problem asks for none, or the MPM.
    model
        Weights of the surrogate; unless given, those that ship for 2D or for 3D.
    memory_gib
        Activations that the backward pass may find ready, instead of computing them again.
    """
    asked = read_problem(problem)
    if forward is None:
        forward = ForwardModel.MPM if asked.surrogate is Surrogate.NONE else ForwardModel.GNS
    if forward is ForwardModel.MPM and gradient is Gradient.AD:
        raise InputError("expected --gradient fd or none, the MPM has no automatic gradient", where="--forward mpm")
    if memory_gib < 0.0:
        raise InputError(f"expected at least 0 GiB, got {memory_gib:g}", where="--memory-gib")
    observation, target = prepare(asked, simulate)
    mpm_seconds = 0.0
    chosen: GnsForward | MpmForward = MpmForward(asked, observation, simulate_many)
    if forward is ForwardModel.GNS:
        strange = [name for name in asked.names if not kind(name).by_surrogate]
        if strange or not observation.by_surrogate:
            what = ", ".join(strange) or "forces"
            raise InputError(f"expected mpm, no surrogate is told of {what}", where="--forward gns")
        weights = model or shipped(asked.scene.dimension)
        if note := card.warning(weights, with_unknowns(asked.scene, asked.names, asked.initial)):
            print(note, file=sys.stderr)
        simulator = checkpoint.load(weights).simulator
        source = GnsSource(simulator, asked, observation, memory_gib)
        frames = source.first_frames(with_unknowns(asked.scene, asked.names, asked.initial))
        began = time.perf_counter()
        beginning = None if frames is None else simulate(frames)
        mpm_seconds = time.perf_counter() - began
        chosen = source.start(beginning)
    wanted = chosen.wanted(target.values) if isinstance(chosen, GnsForward) else target.values
    if gradient is None:
        gradient = Gradient.AD if isinstance(chosen, GnsForward) else Gradient.FD
    result = solve(asked, target, observation, chosen, wanted, gradient)
    if isinstance(chosen, MpmForward):
        mpm_seconds = result.total_seconds
    result = dataclasses.replace(result, mpm_seconds=mpm_seconds)
    result.write(out)
    records = result.evaluations
    stages = [
        (f"evaluation {place + 1}, loss {records[place].loss:.1e}", records[place].unknowns)
        for place in report.picked(result.rounds)
    ]
    report.write(
        result,
        chosen.deposit(result.answer),
        out,
        forward="surrogate" if forward is ForwardModel.GNS else "MPM",
        stages=[(title, unknowns, chosen.deposit(unknowns)) for title, unknowns in stages],
    )
    for name, value in result.unknowns.items():
        print(f"{name:<24} {report.quantity(name, value)}")


def solve(
    problem: Problem,
    target: Target,
    observation: Observation,
    forward: GnsForward | MpmForward,
    wanted: Values,
    gradient: Gradient,
) -> Result:
    """One inversion of `forward`; `wanted` is the target as far as its predictions are held against it."""
    jacobian = problem.optimiser.method is Method.GAUSS_NEWTON
    components = observation.components
    match gradient:
        case Gradient.AD:
            assert isinstance(forward, GnsForward)
            evaluate = automatic(forward, wanted, components=components, with_jacobian=jacobian)
        case Gradient.FD:
            evaluate = central(forward, wanted, problem, components=components, with_jacobian=jacobian)
        case Gradient.NONE:
            began = time.perf_counter()
            # The MPM runs a scene per core, and as many are proposed at a time.
            at_once = (os.cpu_count() or 1) if isinstance(forward, MpmForward) else 1
            records = explore(forward, wanted, problem, components=components, at_once=at_once)
            return unconfirmed(problem, target, records, time.perf_counter() - began)
    return invert(problem, target, evaluate)


if __name__ == "__main__":
    sys.exit(run(main, "python -m inverse"))
