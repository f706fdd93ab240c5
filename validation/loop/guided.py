"""Where a surrogate leads: the MPM runs at its answers first, then around them, and corrects them.

No run is made beyond the surrogate's region (`inverse.surrogate`) unless the MPM contradicts: where it is off by more
than the band allows, the region is so much wider, and twice as wide wherever the posterior comes to its edge.
"""

import dataclasses

import numpy as np

from inverse.found import Purpose
from inverse.posterior.emulator import fewest_runs
from inverse.posterior.posterior import next_points
from inverse.posterior.settings import CONSTANTS
from inverse.surrogate import Inversion
from validation.loop.search import Search
from validation.loop.task import Task
from validation.loop.verdict import checked


def guided(task: Task, found: Inversion) -> Search:
    """Runs at the answers that a surrogate `found`, around them, and on until its answers so corrected hold."""
    unknowns, answers = len(task.problem.parameters), np.stack([each.point for each in found.answers])
    count = CONSTANTS.first_checks if len(answers) == 1 else CONSTANTS.first_checks - 1
    state = Search(task=task).ran(np.repeat(answers, count, axis=0), Purpose.CHECK)
    found = found.compared(state.points, state.numbers)
    size = CONSTANTS.wave + unknowns if unknowns <= CONSTANTS.few_parameters else fewest_runs(unknowns)
    state = state.ran(found.around(size, task.generator(0)), Purpose.WAVE)
    state = dataclasses.replace(state, guide=found).inferred()
    while True:
        while state.at_edge:
            state = state.wider()
        state, _ = checked(state)
        if state.at_edge:
            continue
        left = state.left - task.checks
        if state.posterior.emulator_share <= CONSTANTS.converged_around or left <= 0:
            return state
        points = next_points(state.posterior, min(size, left), task.generator(len(state.runs)))
        state = state.ran(points, Purpose.WAVE).inferred()
