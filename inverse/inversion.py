"""One inversion by one forward model: minimise the misfit, then report what was found."""

import os
import sys
import time
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path

from datasets.errors import InputError
from gns import card, checkpoint
from gns.library import model_path, shipped
from inverse.bounds import Bounds
from inverse.forward.gns import MEMORY_GIB, GnsForward, GnsSource
from inverse.forward.interface import Differentiable, Evaluation
from inverse.forward.mpm import MpmForward
from inverse.jacobian import automatic, central, without_gradient
from inverse.observations import Target
from inverse.observations.reading import read_target
from inverse.optimise import best, explore, minimise
from inverse.problem import Problem
from inverse.report import markdown as report
from inverse.result import Result, Verdict
from inverse.secants import sample
from inverse.settings import Method, Surrogate
from mpm import simulate, simulate_many


class Gradient(StrEnum):
    """Where the gradient comes from."""

    AD = "ad"
    """Reverse mode: automatic differentiation of the surrogate, the adjoint of the MPM."""
    FD = "fd"
    """Central differences."""
    NONE = "none"
    """None at all: the optimiser's `sampler` proposes, `max_trials` is the budget."""


class ForwardModel(StrEnum):
    """What predicts the observation."""

    GNS = "gns"
    MPM = "mpm"


def invert(
    problem: Problem,
    *,
    forward: ForwardModel | None = None,
    gradient: Gradient | None = None,
    model: Path | None = None,
    memory_gib: float = MEMORY_GIB,
    out: Path | None = None,
) -> Result:
    """Find the parameters of `problem` by one forward model; the verdict is left to the MPM (`validation.solve`).

    >>> from inverse import invert, read_problem
    >>> result = invert(read_problem("friction-tall-42"))
    >>> result.unknowns
    {'friction_deg': 41.59...}

    forward: the surrogate where absent, unless the problem asks for none; gradient: reverse mode of the surrogate,
    central differences of the MPM where absent; model: weights, those that ship where absent; memory_gib:
    activations that the backward pass may find ready; out: folder for `result.json`, `report.md` and pictures.
    Raises InputError for a combination that there is none of.
    """
    if forward is None:
        forward = ForwardModel.MPM if problem.surrogate is Surrogate.NONE else ForwardModel.GNS
    if memory_gib < 0.0:
        raise InputError(f"expected at least 0 GiB, got {memory_gib:g}", where="--memory-gib")
    target = read_target(problem, simulate)
    chosen: GnsForward | MpmForward
    if forward is ForwardModel.MPM and gradient is Gradient.AD:
        # Imported here: other inversions have no use for its kernels.
        from inverse.forward.adjoint import AdjointForward

        chosen = AdjointForward(problem, target.observation, simulate_many)
    elif forward is ForwardModel.MPM:
        chosen = MpmForward(problem, target.observation, simulate_many)
    else:
        chosen = surrogate(problem, target, model, memory_gib)
    began = time.perf_counter()
    records = search(problem, target, chosen, gradient)
    seconds = time.perf_counter() - began
    mpm_seconds = seconds if forward is ForwardModel.MPM else 0.0
    result = unconfirmed(problem, target, records, seconds, mpm_seconds=mpm_seconds)
    if out is not None:
        result.write(out)
        report.write(result, chosen.deposit, out, forward="surrogate" if forward is ForwardModel.GNS else "MPM")
    return result


def surrogate(problem: Problem, target: Target, model: Path | None, memory_gib: float) -> GnsForward:
    """The learned surrogate of `problem`. Raises InputError."""
    unsupported = [each.name for each in problem.parameters if not each.kind.differentiable]
    if unsupported or not target.observation.of_positions:
        what = ", ".join(unsupported) or "forces"
        raise InputError(f"expected mpm, no surrogate predicts {what}", where="--forward gns")
    weights, scene = model_path(model or shipped(problem.scene.dimension)), problem.scene_at(problem.initial)
    if warning := card.warning(weights, scene):
        print(warning, file=sys.stderr)
    return GnsSource(checkpoint.load(weights).simulator, problem, target.observation, memory_gib).start(None)


def search(
    problem: Problem, target: Target, forward: GnsForward | MpmForward, gradient: Gradient | None = None
) -> list[Evaluation]:
    """Every evaluation of `forward` on the way to the minimum of its misfit."""
    gradient = gradient or (Gradient.AD if isinstance(forward, GnsForward) else Gradient.FD)
    values, components = forward.select(target.values), target.observation.components
    if gradient is Gradient.NONE:
        # The MPM runs a scene per core, and as many are proposed at a time.
        at_once = 1 if isinstance(forward, GnsForward) else os.cpu_count() or 1
        return explore(forward, values, problem, components=components, at_once=at_once)
    settings, bounds = problem.optimiser, Bounds.from_problem(problem)
    jacobian = settings.method is Method.GAUSS_NEWTON
    spread: list[Evaluation] = []
    if settings.method is Method.SECANTS:
        spread = sample(forward, values, problem.initial, bounds, components=components)
        evaluate = without_gradient(forward, values, components=components)
    elif gradient is Gradient.AD and isinstance(forward, Differentiable):
        evaluate = automatic(forward, values, components=components, with_jacobian=jacobian)
    else:
        evaluate = central(forward, values, problem.steps, components=components, with_jacobian=jacobian)
    rates = [each.learning_rate for each in problem.parameters]
    return spread + minimise(evaluate, problem.initial, bounds, settings, rates=rates, sample=spread)


def unconfirmed(
    problem: Problem, target: Target, records: Sequence[Evaluation], seconds: float, *, mpm_seconds: float = 0.0
) -> Result:
    """The result of `records` of one forward model, `seconds` [s] in all, of which `mpm_seconds` in the MPM.

    The prediction of a forward model that is the MPM itself counts as the surrogate's here: nobody has checked it.
    """
    found = best(records)
    return Result(
        problem=problem,
        target=target,
        verdict=Verdict.UNCONFIRMED,
        answer=found.parameters,
        certainty=None,
        predicted=found.observation,
        loss=found.loss,
        evaluations=records,
        mpm_seconds=mpm_seconds,
        total_seconds=seconds,
    )
