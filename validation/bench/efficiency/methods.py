"""The methods that are compared on a problem: forward model, gradient, optimiser, step of the differences."""

import dataclasses
from dataclasses import dataclass
from enum import StrEnum

from inverse.parameters.parameter import Parameter
from inverse.problem import Problem
from inverse.settings import Method, OptimiserSettings
from validation.bench.paper import Paper

PAPER_STEP_DEG = 0.05
STEPS = {"deg": 2.0, "Pa": 100.0, "m/s": 0.15, "m": 0.02}
"""Steps whose differences exceed the MPM's scatter over its jitter, by the unit of the unknown."""
PAPER_PROBLEM = "friction-tall-42"
"""The problem on which the paper compares gradients."""
MOST_BY_DIFFERENCES = 20
"""Unknowns beyond which no further search is made by differences or without gradients: none ends in time."""


class ForwardModel(StrEnum):
    """What predicts the observation."""

    GNS = "GNS"
    MPM = "MPM"


class GradientBy(StrEnum):
    """How the gradient is computed."""

    AD = "AD"
    ADJOINT = "adjoint"
    DIFFERENCES = "differences"
    SECANTS = "secants"
    """None; what changed from run to run stands for the Jacobian (`inverse.secants`)."""


@dataclass(frozen=True, kw_only=True)
class SearchMethod:
    """A row of the comparison."""

    name: str
    model: ForwardModel
    gradient: GradientBy
    problem: Problem
    """With the optimiser and the steps of this row."""
    paper: float | None = None
    """The paper's seconds per iteration."""
    gauss_newton: bool = False
    """Minimise by Gauss-Newton, whatever the problem says: differences have the Jacobian of any observation."""

    @property
    def settings(self) -> OptimiserSettings:
        """How it is minimised, and when that ends."""
        settings = self.problem.optimiser
        return dataclasses.replace(settings, method=Method.GAUSS_NEWTON) if self.gauss_newton else settings

    @property
    def optimiser(self) -> str:
        """What minimises."""
        return str(self.settings.method)


def methods(problem: Problem, paper: Paper) -> list[SearchMethod]:
    """All methods for `problem`: the same start, the same rule to stop by, the optimiser of its file.

    Gauss-Newton needs the Jacobian, which differences have at no further cost, AD and the adjoint for a backward pass
    per observed number: where the file names it, the others use L-BFGS-B, and the MPM's differences run both. The
    adjoint always uses L-BFGS-B.
    """
    if problem.optimiser.method is Method.GAUSS_NEWTON:
        settings = dataclasses.replace(problem.optimiser, method=Method.LBFGSB)
        problem = dataclasses.replace(problem, optimiser=settings)
    is_paper = problem.name == PAPER_PROBLEM
    seconds = paper.seconds_per_iteration if is_paper else {}
    found = []
    few = len(problem.parameters) <= MOST_BY_DIFFERENCES
    found.append(_row("", ForwardModel.GNS, GradientBy.AD, problem, seconds.get("ad_gns")))
    wide = with_steps(problem, None)
    for model, key in ((ForwardModel.GNS, "fd_gns"), (ForwardModel.MPM, "fd_mpm")):
        if is_paper:
            fine = with_steps(problem, PAPER_STEP_DEG)
            found.append(_row("", model, GradientBy.DIFFERENCES, fine, seconds.get(key)))
        found.append(_row("", model, GradientBy.DIFFERENCES, wide, None))
    # With a single number and a single unknown L-BFGS-B's first step is Gauss-Newton's already.
    if len(problem.parameters) > 1 and few:
        newton = _row(", Gauss-Newton", ForwardModel.MPM, GradientBy.DIFFERENCES, wide, None)
        found.append(dataclasses.replace(newton, gauss_newton=True))
    found.append(_row("", ForwardModel.MPM, GradientBy.ADJOINT, with_method(problem, Method.LBFGSB), None))
    if len(problem.parameters) > 1:
        found.append(_row("", ForwardModel.MPM, GradientBy.SECANTS, with_method(problem, Method.SECANTS), None))
    return found


def with_method(problem: Problem, method: Method) -> Problem:
    """`problem` with another method of its optimiser."""
    return dataclasses.replace(problem, optimiser=dataclasses.replace(problem.optimiser, method=method))


def _row(suffix: str, model: ForwardModel, gradient: GradientBy, problem: Problem, paper: float | None) -> SearchMethod:
    by = f"differences of {steps_text(problem)}" if gradient is GradientBy.DIFFERENCES else str(gradient)
    return SearchMethod(name=f"{by}, {model}{suffix}", model=model, gradient=gradient, problem=problem, paper=paper)


def with_steps(problem: Problem, step: float | None) -> Problem:
    """`problem` with this step of its differences, or with that of `STEPS`; its bounds are a step narrower.

    So no difference leaves them.
    """

    def with_step(each: Parameter) -> Parameter:
        h = STEPS[each.kind.unit] if step is None else step
        return dataclasses.replace(each, step=h, lower=each.bounds[0] + h, upper=each.bounds[1] - h)

    return dataclasses.replace(problem, parameters=tuple(map(with_step, problem.parameters)))


def steps_text(problem: Problem) -> str:
    """The steps with their units, each once."""
    steps = {f"{h:g} {kind.unit}": None for kind, h in zip(problem.kinds, problem.steps, strict=True)}
    return " and ".join(steps)
