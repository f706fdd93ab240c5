"""Decides whether a surrogate is used: the scene is in its range, its error band narrow and an MPM run expensive.

The surrogate inverts first (`inverse.search.descent`) and leads: the MPM runs at its answers, then around them, and
corrects them. No run is made outside the surrogate's region unless the MPM contradicts it: if the surrogate errs by
more than its band allows, the region widens in proportion, and it doubles whenever the posterior reaches its edge.
"""

import sys
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from datasets.errors import InputError
from datasets.processes import processors
from datasets.scene import Scene
from gns import card, checkpoint
from gns.library import model_path, shipped
from gns.simulator import Simulator
from inverse.answer import Purpose
from inverse.forward import Forward
from inverse.forward.gns import PREDICTIONS, Flow, GnsForward, band_of, priced, seconds_of_run, unfamiliar
from inverse.forward.mpm import MpmForward
from inverse.observations.target import Target
from inverse.posterior.emulator import fewest_runs
from inverse.posterior.settings import CONSTANTS
from inverse.problem import Problem
from inverse.search.inference import Inversion, further, wave_size
from inverse.settings import Surrogate
from mpm.footprint import INVERSION, PROCESS, expected, planned
from validation.loop.task import Loop, Task
from validation.loop.verdict import checked
from validation.run_store import RunStore

JITTER = 0  # jitter seed of the flows that the surrogate predicts
WIDEST = 0.2  # largest 95 % band as a share of the flow's extent: a wider band excludes little of the prior box
OUTERMOST = 0.2
"""Last share of the likelihood's fall, from its top to the edge of a region, in which a sample is at the edge."""
QUICKEST = 0.1  # shortest prediction [s]: if even that costs too much, no weights are read


def choose(task: Task, model: Path | None = None) -> tuple[Forward | None, str]:
    """The surrogate that leads the search, or None; and the reason in words. model: weights, which are used at any
    cost; by default the shipped ones. The MPM on larger cells leads only if the problem says `coarse`. Raises
    InputError if the problem demands a surrogate that does not exist."""
    problem, requested = task.problem, task.problem.surrogate
    if requested is Surrogate.NONE:
        return None, "the problem asks for none"
    if requested is Surrogate.COARSE:
        problem = replace(problem, scene=task.on_cells(problem.scene, 2.0))
        store = RunStore(task.folder, task.simulate, label="coarse-")
        # The coarse MPM errs by about one cell of the scene, four times the scatter of its flows.
        coarse = MpmForward(problem, task.target.observation, store, band=4.0 * task.scatter)
        return coarse, "it is the MPM on cells twice as large"
    run, by_price = seconds_of_run(problem.scene), requested is Surrogate.AUTO and model is None
    if by_price and quick(run):
        return None, f"a run of the MPM takes {run:.2g} s, which is less than {PREDICTIONS:g} predictions"
    forward, reason = learned(problem, task.target, model)
    if forward is None:
        if requested is Surrogate.GNS:
            raise InputError(f"expected auto or none, {reason}", key="surrogate")
        return None, reason
    dear, price = priced(problem.scene, partial(forward.errors, problem.initial))
    if by_price and not dear:
        return None, f"{price}, a {PREDICTIONS:g}th of it or more"
    return forward, price if by_price else f"the problem requests it; {price}"


def quick(run: float) -> bool:
    """Whether an MPM run is so short that predictions save no time."""
    return run < PREDICTIONS * QUICKEST


def estimate(problem: Problem, model: Path | None, out: Path) -> str:
    """The least time, in words, of the loop's first runs and of the runs that check its answer."""
    unknowns = len(problem.parameters)
    alone = problem.surrogate is Surrogate.NONE or (model is None and quick(seconds_of_run(problem.scene)))
    fill = CONSTANTS.first_runs + CONSTANTS.first_per_unknown * unknowns + CONSTANTS.repeats
    few = fill + CONSTANTS.checks if alone else CONSTANTS.first_checks + CONSTANTS.wave + unknowns
    runs = max(min(few, problem.loop.budget(unknowns)) - len(list((out / "mpm").glob("*.npz"))), 0)
    work, size = planned([problem.scene])
    size = PROCESS + INVERSION + 2 * processors() * (size - PROCESS)
    spoken = expected(problem.scene, runs * work, memory=size, processors=processors(), least=True)
    return f"{runs} runs of the MPM or more; {spoken}"


def learned(problem: Problem, target: Target, model: Path | None) -> tuple[Forward | None, str]:
    """The learned surrogate; or None, and why it does not predict the flow well enough. Raises InputError."""
    observation = target.observation
    if without := [parameter.name for parameter in problem.parameters if not parameter.kind.predicted]:
        return None, f"{', '.join(without)} is no input of it"
    if not observation.of_positions:
        return None, f"it does not predict {observation.label}"
    weights = model_path(model or shipped(problem.scene))
    # A jitter seed that no MPM run has, and one seed for every target.
    problem = replace(problem, scene=replace(problem.scene, seed=JITTER))
    stamp = weights.stat().st_mtime_ns if weights.exists() else 0
    simulator, flows = loaded(weights, stamp, problem.scene, tuple(problem.names))
    scene = problem.scene_at(problem.initial)
    if strange := unfamiliar(weights, simulator.settings, scene):
        return None, strange
    if warning := card.warning(weights, scene):
        print(warning, file=sys.stderr)
    band = band_of(weights, scene)
    if problem.surrogate is Surrogate.AUTO and model is None and band.front > WIDEST:
        return None, f"its band is {band.front:.0%} of the extent, more than {WIDEST:.0%}"
    return GnsForward(simulator, problem, observation, band=band, flows=flows), ""


@lru_cache(maxsize=1)
def loaded(weights: Path, stamp: int, scene: Scene, names: tuple[str, ...]) -> tuple[Simulator, dict[bytes, Flow]]:
    """The model in a file as it was at `stamp`, and its predictions of a scene for unknowns of these names."""
    return checkpoint.load(weights).simulator, {}


def guided(search: Loop, led: Inversion) -> tuple[Loop, bool]:
    """Run the MPM at and around the answers of a surrogate (`led`), until the answers so corrected no longer change.
    Also returns whether the MPM confirms one of them: if not, more runs near the others would be of no use. If the
    known runs are enough for an emulator, they correct the surrogate's answers at once."""
    unknowns, state = len(search.knowledge.problem.parameters), search
    size = wave_size(unknowns)
    if len(search.known) < fewest_runs(unknowns):
        answers = np.stack([answer.point for answer in led.answers])
        state = state.ran(np.repeat(answers, CONSTANTS.first_checks, axis=0), purpose=Purpose.CHECK)
        led = led.compared(state.points, state.numbers)
        state = state.ran(led.around(size, state.generator(0)))
    state = state.informed(guide=led)
    while True:
        while at_edge(state):
            # Double the region until no samples lie at its edge.
            led = led.refined(factor=2.0 * led.knowledge.factor)
            state = state.informed(guide=led)
        left, known_enough = state.left - CONSTANTS.checks, converged(state)
        # With several parameters the answers move until the emulator has converged, so checks come last.
        if unknowns == 1 or known_enough or left <= 0:
            state, corrected = checked(state, again=False, moves=1)
            if at_edge(state):
                continue
            left, confirmed = state.left - CONSTANTS.checks, corrected[0].confirmed
            # If it converged before the checks it counts as converged after them, even if they show less scatter.
            if not confirmed or known_enough or converged(state) or left <= 0:
                return state, confirmed
        state = state.ran(further(state, min(size, left))).informed()


def converged(state: Loop) -> bool:
    """Whether further runs around the surrogate's answers would hardly narrow the intervals."""
    return state.knowledge.posterior.emulator_share <= CONSTANTS.converged_around


def at_edge(state: Loop) -> bool:
    """Whether samples lie at the edge of the surrogate's region, because the MPM leads beyond it. Before the emulator
    has converged samples lie there too, which means nothing yet."""
    guide, posterior = state.knowledge.guide, state.knowledge.posterior
    if guide is None or posterior.likelihood.within is None or not converged(state):
        return False
    outermost = guide.beyond(posterior.samples.points) > -OUTERMOST * guide.fall
    return float(posterior.samples.weights[outermost].sum()) > CONSTANTS.at_edge
