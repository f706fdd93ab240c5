"""Where a surrogate leads: the MPM runs at its answers first, then around them, and corrects them.

No run is made beyond the surrogate's region (`inverse.optimise`) unless the MPM contradicts: where it is off by more
than the band allows, the region is so much wider, and twice as wide wherever the posterior comes to its edge.
"""

import dataclasses

import numpy as np

from inverse.found import MpmRun, Purpose
from inverse.optimise import Inversion
from inverse.posterior.emulator import fewest_runs
from inverse.posterior.posterior import next_points
from inverse.posterior.settings import CONSTANTS
from validation.loop.search import Search
from validation.loop.task import Task
from validation.loop.verdict import checked


def guided(task: Task, found: Inversion, known: tuple[MpmRun, ...] = ()) -> tuple[Search, bool]:
    """Runs at the answers that a surrogate `found`, around them, and on until its answers so corrected hold.

    With it, whether the MPM confirms one of them: if not, more runs near the others would be of no use.
    known: runs for other targets; where they are enough for an emulator, its answers are corrected by them at once.
    """
    unknowns, state = len(task.problem.parameters), Search(task=task, known=known)
    size = CONSTANTS.wave + unknowns if unknowns <= CONSTANTS.few_parameters else fewest_runs(unknowns)
    if len(known) < fewest_runs(unknowns):
        answers = np.stack([each.point for each in found.answers])
        state = state.ran(np.repeat(answers, CONSTANTS.first_checks, axis=0), Purpose.CHECK)
        found = found.compared(state.points, state.numbers)
        state = state.ran(found.around(size, task.generator(0)), Purpose.WAVE)
    state = dataclasses.replace(state, guide=found).inferred()
    while True:
        while state.at_edge:
            state = state.wider()
        left, known_enough = state.left - task.checks, state.converged
        # The answers of several parameters move until their emulator knows enough: checks of them come last.
        if unknowns == 1 or known_enough or left <= 0:
            state, corrected = checked(state, again=False, moves=1)
            if state.at_edge:
                continue
            left, confirmed = state.left - task.checks, corrected[0].confirmed
            # What was enough before the checks is so after them, though the scatter that they show may be smaller.
            if not confirmed or known_enough or state.converged or left <= 0:
                return state, confirmed
        points = next_points(state.posterior, min(size, left), task.generator(len(state.runs)))
        state = state.ran(points, Purpose.WAVE).inferred()
