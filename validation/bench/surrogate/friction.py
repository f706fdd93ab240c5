"""How strongly front and profile of held-out columns answer to the angle of friction, beside the MPM's.

With J the derivative of an observation with the angle by central differences of the fine MPM, averaged over jitter
seeds, and j that of a method,

    strength = j . J / J . J

is 1 where the method answers as the MPM does. A model's needs a single backward pass, however many numbers there are.
"""

import dataclasses
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from datasets.records import Record
from inverse.forward.gns import GnsForward
from inverse.forward.interface import Simulate
from inverse.forward.mpm import MpmForward
from inverse.jacobian import by_differences
from inverse.observations import Values, build
from inverse.problem import Problem
from inverse.settings import ObservationSettings, Parameter, TargetSettings
from mpm import simulate_many
from validation.bench.surrogate.accuracy import Accuracy
from validation.bench.surrogate.held_out import HeldOut, other_jitter
from validation.bench.surrogate.models import Model
from validation.bench.surrogate.price import coarse, mpm_method
from validation.bench.surrogate.records import Records, digest
from validation.runs import RunStore

STEP_DEG = 2.0
"""Of the central differences."""
OBSERVED = ("front", "profile")
WITHIN = 0.1
"""Criterion: a strength of 1 within this."""
MOST_COHESION = 300.0
"""Of the columns [Pa]: stronger ones stand, and answer to nothing."""
CELLS = (10, 20)
"""Of the coarse MPM beside it."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Strengths(Record):
    """Of one method on one column."""

    front: float
    profile: float
    seconds: float
    """Of both [s]."""


def chosen(accuracy: Accuracy, number: int) -> list[HeldOut]:
    """The first held-out columns of weak sand whose front is free, at larger x."""
    scores = next(iter(accuracy.scores.values()))
    return [
        each
        for each, score in zip(accuracy.scenes, scores, strict=True)
        if each.kind == "column"
        and score.rightwards
        and not score.at_wall
        and each.scene.material.cohesion <= MOST_COHESION
    ][:number]


def problem_of(each: HeldOut, observed: str) -> Problem:
    """The angle of friction of a column from its deposit."""
    angle = each.scene.material.friction_deg
    return Problem(
        name=each.name,
        scene=each.scene,
        parameters=(
            Parameter(
                name="friction_deg",
                initial=angle,
                lower=angle - 2.0 * STEP_DEG,
                upper=angle + 2.0 * STEP_DEG,
                step=STEP_DEG,
            ),
        ),
        observation=ObservationSettings(kind=observed),
        target=TargetSettings(twin=True),
    )


def answer(problem: Problem, simulate: Simulate, seeds: int = 1, cells: int | None = None) -> Values:
    """Derivative of the observation with the angle by the MPM [m/deg], shape [M], the mean over jitter seeds."""
    scenes = [other_jitter(problem.scene, number) for number in range(seeds)]
    if cells is not None:
        scenes = [coarse(scene, cells) for scene in scenes]
    found = []
    for scene in scenes:
        one = dataclasses.replace(problem, scene=scene)
        forward = MpmForward(one, build(one.observation, scene), simulate)
        found.append(by_differences(forward, one.initial, one.steps)[:, 0])
    return np.asarray(np.mean(found, axis=0))


def model_strength(problem: Problem, model: Model, reference: Values) -> float:
    """A model's strength, by automatic differentiation."""
    forward = GnsForward(model.simulator, problem, build(problem.observation, problem.scene))
    point = torch.tensor(problem.initial, requires_grad=True)
    weights = torch.from_numpy(reference / (reference @ reference))
    return float(torch.autograd.grad(forward.predict(point) @ weights, point)[0])


def mpm_strength(problem: Problem, cells: int, reference: Values) -> float:
    """The strength of a coarse MPM of one seed."""
    slope = answer(problem, partial(simulate_many, threads=1), cells=cells)
    return float(slope @ reference / (reference @ reference))


def strengths(each: HeldOut, references: dict[str, Values], strength: Callable[[Problem, Values], float]) -> Strengths:
    """Those of one method, timed."""
    began = time.perf_counter()
    found = {name: strength(problem_of(each, name), references[name]) for name in OBSERVED}
    return Strengths(front=found["front"], profile=found["profile"], seconds=time.perf_counter() - began)


def measure(
    columns: Sequence[HeldOut], models: Sequence[Model], keep: Path, *, seeds: int, cells: Sequence[int] = CELLS
) -> dict[str, list[Strengths]]:
    """Strengths by method, in the order of the columns; what `keep` has is not made again."""
    torch.set_num_threads(1)
    store = RunStore(keep / "friction")
    stored = Records(keep / "friction.json", Strengths)
    methods: dict[str, tuple[str, Callable[[Problem, Values], float]]] = {}
    for model in models:
        methods[model.name] = (model.digest, lambda problem, J, model=model: model_strength(problem, model, J))  # type: ignore[misc]
    for number in cells:
        methods[mpm_method(number)] = (str(number), lambda problem, J, number=number: mpm_strength(problem, number, J))  # type: ignore[misc]
    found: dict[str, list[Strengths]] = {name: [] for name in methods}
    for each in tqdm(columns, desc="friction", unit="column", dynamic_ncols=True):
        references = {name: answer(problem_of(each, name), store, seeds) for name in OBSERVED}
        for name, (origin, strength) in methods.items():
            key = digest(origin, each.scene, seeds)
            found[name].append(stored.made(key, partial(strengths, each, references, strength)))
    return found


def within(found: Sequence[Strengths], observed: str) -> int:
    """How many strengths are 1 within the criterion."""
    return sum(abs(getattr(each, observed) - 1.0) <= WITHIN for each in found)
