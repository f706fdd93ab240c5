"""A learned surrogate in the emulator's trend, where its price is less than that of the runs which it saves.

It is asked all over the box; its own emulator is then a function in the trend of the MPM's, whose coefficient and
whose error the runs of the MPM show (`inverse.posterior.emulator`). The trend with it is used where the runs that are
left out one by one are predicted better with it than without.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.stats import qmc
from tqdm import tqdm

from datasets.errors import InputError
from gns import card, checkpoint
from gns.initial import check
from gns.library import model_path, shipped
from gns.ranges import outside
from inverse.forward.gns import GnsForward
from inverse.forward.interface import Forward
from inverse.posterior.emulator import Emulator, Matrix, fitted, linear
from inverse.posterior.settings import CONSTANTS
from inverse.problem import Problem
from inverse.settings import Surrogate as Requested
from inverse.target import Target
from validation.loop.task import Task

Load = Callable[[Problem, Target, Path | None], tuple[Forward | None, str]]
"""Problem, target, weights -> the surrogate, or None and why there is none."""
COMPONENTS = 2
"""Of the surrogate's observation that enter the trend."""
PER_UNKNOWN, AT_LEAST = 6, 6
"""Predictions over the box."""
SAVES = 0.5
"""Share of the price of the runs that it may save, which its own may be."""
QUICKEST = 0.1
"""Seconds of a prediction at least: where even that costs too much, no weights are read."""
EXACT = 1e-3
"""Scatter of its components, in standard deviations over the box: only rounding."""


@dataclass(frozen=True, kw_only=True)
class Surrogate:
    """Predictions of the learned surrogate over the box."""

    points: Matrix
    """In fractions of the ranges, shape [s, U]."""
    numbers: Matrix
    """Its observations, shape [s, m]."""

    @cached_property
    def emulator(self) -> Emulator:
        """Of its first components, each with a standard deviation of 1."""
        values, basis = np.linalg.svd(self.numbers - self.numbers.mean(axis=0), full_matrices=False)[1:]
        kept = max(1, int(np.sum(values[:COMPONENTS] > EXACT * values[0])))
        components = (self.numbers - self.numbers.mean(axis=0)) @ basis[:kept].T / np.maximum(values[:kept], 1e-300)
        components *= np.sqrt(len(self.points))
        return fitted(self.points, components, np.full(kept, EXACT))

    def trend(self, points: Matrix) -> Matrix:
        """1, v and its components at points [S, U], shape [S, 1 + U + COMPONENTS]."""
        return np.concatenate([linear(points), self.emulator.mean(points)], axis=1)


def asked(task: Task, forward: Forward, count: int) -> Surrogate:
    """Predictions of `forward` at `count` points that fill the box."""
    unknowns = len(task.problem.parameters)
    points = qmc.LatinHypercube(unknowns, rng=task.generator(1), optimization="random-cd").random(count)
    locations = tqdm(task.at(points), desc="surrogate", unit="prediction", leave=False, disable=None)
    numbers = [forward.observe([each])[0] for each in locations]
    return Surrogate(points=points, numbers=np.stack(numbers))


def choose(task: Task, mpm_seconds: float, *, model: Path | None, load: Load) -> tuple[Surrogate | None, str]:
    """The surrogate's predictions, or None, and the reason in words.

    mpm_seconds: of a run of the MPM; model: weights, those that ship where absent; load: `learned`. Raises InputError
    for a problem that asks for one that there is none of.
    """
    requested = task.problem.surrogate
    if requested is Requested.NONE:
        return None, "the problem asks for none"
    if task.problem.target.minimise:
        return None, "a design is looked for by the MPM alone"
    unknowns = len(task.problem.parameters)
    count = AT_LEAST + PER_UNKNOWN * unknowns
    saved = CONSTANTS.wave + CONSTANTS.first_per_unknown * unknowns
    if requested is Requested.AUTO and count * QUICKEST > SAVES * saved * mpm_seconds:
        return None, f"it would cost more than it saves ({saved} runs of {mpm_seconds:.2f} s)"
    forward, reason = load(task.problem, task.target, model)
    if forward is None:
        if requested is Requested.GNS:
            raise InputError(f"expected auto or none, {reason}", key="surrogate")
        return None, reason
    began = time.perf_counter()
    forward.observe([task.problem.initial])
    first = time.perf_counter() - began
    price = f"{count} predictions of {first:.2f} s for {saved} runs of {mpm_seconds:.2f} s"
    if requested is Requested.GNS:
        return asked(task, forward, count), f"the problem asks for it ({price})"
    if count * first > SAVES * saved * mpm_seconds:
        return None, f"it would cost more than it saves ({price})"
    return asked(task, forward, count), f"it is cheaper ({price})"


def learned(problem: Problem, target: Target, model: Path | None) -> tuple[Forward | None, str]:
    """The learned surrogate, or None and the reason why it does not know the flow. Raises InputError."""
    observation = target.observation
    if without := [each.name for each in problem.parameters if not each.kind.differentiable]:
        return None, f"{', '.join(without)} is no input of it"
    if not observation.of_positions:
        return None, f"it does not predict {observation.label}"
    weights = model_path(model or shipped(problem.scene.dimension))
    simulator = checkpoint.load(weights).simulator
    scene = problem.scene_at(problem.initial)
    known = card.read(weights)
    unknown = outside(scene, known.ranges) if known is not None else []
    try:
        check(scene, simulator.settings)
    except InputError as error:
        unknown = unknown or [str(error)]
    if unknown:
        return None, f"{weights.name} was not trained on such a flow: {'; '.join(unknown)}"
    if warning := card.warning(weights, scene):
        print(warning, file=sys.stderr)
    return GnsForward(simulator, problem, observation), ""
