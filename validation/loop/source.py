"""Which model proposes in the loop: the learned surrogate where it knows the flow, else the MPM by differences."""

from pathlib import Path

from datasets.errors import InputError
from gns.inference import shipped
from gns.initial import check
from gns import card
from gns.model import checkpoint
from inverse.forward.gns import GnsSource
from inverse.forward.interface import Simulate, SurrogateSource
from inverse.forward.linearised import MpmSource
from inverse.observations.deposit import Observation
from inverse.parameters.parameters import kind, with_unknowns
from inverse.problem import Problem, Surrogate


def choose(
    problem: Problem, observation: Observation, simulate: Simulate, *, model: Path | None = None, memory_gib: float
) -> tuple[SurrogateSource, str | None]:
    """What proposes, and why it is no learned surrogate; None where it is one.

    simulate: the MPM for differences. model: weights, those that ship where absent.
    """
    if problem.surrogate is Surrogate.NONE:
        return MpmSource(problem, observation, simulate), "none was asked for"
    strange = [name for name in problem.names if not kind(name).by_surrogate]
    if strange:
        return MpmSource(problem, observation, simulate), f"it knows nothing of {', '.join(strange)}"
    if not observation.by_surrogate:
        return MpmSource(problem, observation, simulate), "it tells no forces"
    weights = model or shipped(problem.scene.dimension)
    simulator = checkpoint.load(weights).simulator
    scene = with_unknowns(problem.scene, problem.names, problem.initial)
    known = card.read(weights)
    outside = known.outside(scene) if known is not None else []
    try:
        check(scene, simulator.settings)
    except InputError as error:
        outside = outside or [str(error)]
    if outside:
        reason = f"{weights.name} is outside of its training range: {'; '.join(outside)}"
        return MpmSource(problem, observation, simulate), reason
    return GnsSource(simulator, problem, observation, memory_gib), None
