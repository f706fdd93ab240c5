"""Predictors of thousands of flows for a design problem: the learned surrogate, or the MPM on larger cells."""

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache, partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

import gns
from datasets.errors import require
from datasets.flow import measures
from datasets.processes import end_with_parent, processors, without_main
from datasets.scene import Scene
from gns.library import shipped
from gns.simulator import Simulator, unroll
from gns.surroundings.initial import check, initial_state
from gns.surroundings.state import Conditions, State
from inverse.forward import Simulate
from inverse.posterior import Matrix, Row
from mpm import ALL, LAST, simulate_many
from validation.design.problem import DesignProblem, Limit
from validation.design.race import Predict

TOGETHER = 64  # flows in a batch on a GPU; scenes built at a time
COARSER = 2.0  # cell size of the predicting MPM over the scene's


def predictor(problem: DesignProblem, simulate: Simulate = simulate_many) -> Predict:
    """The predictor of responses that the problem asks for. Raises InputError if it cannot predict them."""
    if problem.surrogate == "coarse":
        problem.scene.with_cell(COARSER * problem.scene.domain.cell)
        respond = partial(coarse, problem.limit, simulate)
    else:
        expected = "front or runout, or surrogate = 'coarse': a learned surrogate predicts no force"
        require(not problem.limit.force, "limit.quantity", expected, problem.limit.quantity)
        check(problem.scene, gns.load(shipped(problem.scene)).settings)
        learned = partial(in_batches, "cuda") if torch.cuda.is_available() else on_processors
        respond = partial(learned, problem.limit.quantity)
    made = 0

    def predict(points: Matrix) -> Row:
        nonlocal made
        found = list[float]()
        for first in tqdm(range(0, len(points), TOGETHER), desc="predictions", unit="batch", leave=False, disable=None):
            scenes = problem.scenes_at(points[first : first + TOGETHER], made)
            found += respond(scenes)
            made += len(scenes)
        return np.array(found)

    return predict


def coarse(limit: Limit, simulate: Simulate, scenes: Sequence[Scene]) -> list[float]:
    """Responses by the MPM on larger cells."""
    larger = [scene.with_cell(COARSER * scene.domain.cell) for scene in scenes]
    flows = simulate(larger, record=ALL if limit.force else LAST)
    return [float(limit.kept(flow).summary[limit.quantity]) for flow in flows]


def in_batches(device: str, quantity: str, scenes: Sequence[Scene]) -> list[float]:
    """Responses by the surrogate, with the scenes of one size in one batch, which suits a GPU."""
    model, responses = known_model(shipped(scenes[0])).to(device), dict[int, float]()
    begun = [initial_state(scene, model.settings) for scene in scenes]
    for units in {start.conditions.units for start in begun}:
        numbers = [number for number, start in enumerate(begun) if start.conditions.units == units]
        starts = [begun[number] for number in numbers]
        state = State.joined([start.state for start in starts]).to(device)
        conditions = Conditions.joined([start.conditions for start in starts]).to(device)
        with torch.no_grad():
            moved = unroll(model, state, conditions, starts[0].steps)[-1].cpu().numpy()
        ends = np.cumsum([len(start.indices) for start in starts])[:-1]
        for number, deposit, start in zip(numbers, np.split(moved, ends), starts, strict=True):
            extents = measures.extents(start.scene, deposit, start.conditions.volume.numpy())
            responses[number] = float(extents[quantity])
    return [responses[number] for number in range(len(scenes))]


def on_processors(quantity: str, scenes: Sequence[Scene]) -> list[float]:
    """Responses by the surrogate on every processor, one process with one thread each: more threads gain nothing."""
    share = max(1, len(scenes) // processors())
    with without_main():
        return list(predicting_processes().map(partial(predicted, quantity), scenes, chunksize=share))


@lru_cache(maxsize=1)
def predicting_processes() -> ProcessPoolExecutor:
    """The processes, kept for all batches: each takes seconds to start and to load the model."""
    return ProcessPoolExecutor(processors(), get_context("spawn"), end_with_parent)


def predicted(quantity: str, scene: Scene) -> float:
    """The response of a scene by the surrogate."""
    return float(gns.simulate(scene, model=known_model(shipped(scene))).summary[quantity])


@lru_cache(maxsize=1)
def known_model(path: Path) -> Simulator:
    """A model, loaded once."""
    return gns.load(path)
