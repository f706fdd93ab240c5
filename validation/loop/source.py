"""The forward model that proposes: the learned surrogate where it was trained for the flow, else the linearised MPM."""

import sys
from functools import partial
from pathlib import Path

from datasets.errors import InputError
from gns import card
from gns.inference import model_path, shipped
from gns.initial import check
from gns.model import checkpoint
from inverse.forward.gns import MEMORY_GIB, GnsSource
from inverse.forward.interface import Simulate, SurrogateSource
from inverse.forward.linearised import MpmSource
from inverse.observations import Target
from inverse.problem import Problem
from inverse.settings import Surrogate
from mpm import ALL, LAST


def choose(
    problem: Problem, target: Target, simulate: Simulate, *, model: Path | None = None, memory_gib: float = MEMORY_GIB
) -> tuple[SurrogateSource, str | None]:
    """The source of surrogates, and the reason why it is no learned one; None where it is.

    simulate: the MPM for differences. model: weights, those that ship where absent. Raises InputError.
    """
    observation = target.observation
    record = ALL if observation.over_time else LAST
    by_mpm = MpmSource(problem, observation, partial(simulate, record=record))
    if problem.surrogate is Surrogate.NONE:
        return by_mpm, "the problem asks for none"
    if without := [each.name for each in problem.parameters if not each.kind.differentiable]:
        return by_mpm, f"{', '.join(without)} is no input of it"
    if not observation.differentiable:
        return by_mpm, f"it does not predict {observation.label}"
    weights = model_path(model or shipped(problem.scene.dimension))
    simulator = checkpoint.load(weights).simulator
    scene = problem.scene_at(problem.initial)
    known = card.read(weights)
    outside = known.outside(scene) if known is not None else []
    try:
        check(scene, simulator.settings)
    except InputError as error:
        outside = outside or [str(error)]
    if outside:
        return by_mpm, f"{weights.name} was not trained on such a flow: {'; '.join(outside)}"
    if warning := card.warning(weights, scene):
        print(warning, file=sys.stderr)
    return GnsSource(simulator, problem, observation, memory_gib), None
