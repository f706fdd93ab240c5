"""The gradients compared on the paper's column: the part of `validation.efficiency` that is about it."""

from gns.simulator import Simulator
from inverse.problem import Problem
from inverse.report import table
from validation.efficiency import methods
from validation.efficiency.methods import ways
from validation.efficiency.page import HEAD, race_row
from validation.efficiency.race import prepare, race
from validation.paper import Paper

COMPARED = methods.COMPARED.removeprefix("friction-")
"""The scenario on which the paper compares gradients."""
LIMIT = 25.0
"""Seconds for each method."""


def comparison(problem: Problem, simulator: Simulator, paper: Paper) -> list[str]:
    """The table, in Markdown: every method from the same start to the same target."""
    rows = race(ways(problem, paper), prepare(problem, simulator), LIMIT, curve=1)
    return [
        f"## The gradients compared: {problem.name}",
        "",
        f"Every method starts at the same angle and has {LIMIT:g} s; the loss is that of an MPM run at the answer,",
        "with a jitter of its own. `python -m validation.efficiency` tells more.",
        "",
        *table(HEAD, [race_row(row) for row in rows]),
    ]
