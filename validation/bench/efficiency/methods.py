"""The methods that are compared on a problem: whose flow, whose gradient, which optimiser, which step."""

import dataclasses
from dataclasses import dataclass
from enum import StrEnum

from inverse.parameters.parameters import kind
from inverse.problem import Method, OptimiserSettings, Problem, Unknown
from validation.bench.columns.paper import Paper

PAPER_STEP_DEG = 0.05
CLEAR = {"deg": 2.0, "Pa": 100.0, "m/s": 0.15, "m": 0.02}
"""Steps whose differences stand clear of the scatter that a jitter gives the MPM, by the unit of the unknown."""
COMPARED = "friction-tall-42"
"""The problem on which the paper compares gradients."""
PAPERS_WAY = OptimiserSettings(method=Method.GRADIENT_DESCENT, max_iterations=20, stop_below=5.0e-4)


class Model(StrEnum):
    """Whose flow."""

    GNS = "GNS"
    MPM = "our MPM"


class Slope(StrEnum):
    """Whose gradient."""

    AD = "AD"
    DIFFERENCES = "differences"
    NONE = "Optuna"


@dataclass(frozen=True, kw_only=True)
class Way:
    """A row of the comparison."""

    name: str
    model: Model
    slope: Slope
    problem: Problem
    """With the optimiser and the steps of this row."""
    paper: float | None = None
    """The paper's seconds per iteration."""
    newton: bool = False
    """Minimise by Gauss-Newton, whatever the problem says: differences have the Jacobian of any observation."""

    @property
    def settings(self) -> OptimiserSettings:
        """How it is minimised, and when that is over."""
        settings = self.problem.optimiser
        return dataclasses.replace(settings, method=Method.GAUSS_NEWTON) if self.newton else settings

    @property
    def optimiser(self) -> str:
        """What minimises."""
        return str(self.settings.sampler if self.slope is Slope.NONE else self.settings.method)


def ways(problem: Problem, paper: Paper) -> list[Way]:
    """All methods for `problem`: the same start, the same rule to stop by, the optimiser of its file.

    A Gauss-Newton search wants the Jacobian, which differences have at no further cost and AD for a backward pass per
    observed number: there the others take L-BFGS-B, and the MPM's differences run both.
    """
    several = len(problem.unknowns) > 1
    # A single number and a single unknown: L-BFGS-B's first step is Gauss-Newton's already.
    if problem.optimiser.method is Method.GAUSS_NEWTON:
        settings = dataclasses.replace(problem.optimiser, method=Method.LBFGSB)
        problem = dataclasses.replace(problem, optimiser=settings)
    clear = stepped(problem, None)
    seconds = paper.seconds_per_iteration if problem.name == COMPARED else {}
    found = [Way(name="AD, GNS", model=Model.GNS, slope=Slope.AD, problem=problem, paper=seconds.get("ad_gns"))]
    if problem.name == COMPARED:
        descent = dataclasses.replace(problem, optimiser=PAPERS_WAY)
        name, price = "AD, GNS, the paper's descent", seconds.get("ad_gns")
        found.append(Way(name=name, model=Model.GNS, slope=Slope.AD, problem=descent, paper=price))
    for model, key in ((Model.GNS, "fd_gns"), (Model.MPM, "fd_mpm")):
        if problem.name == COMPARED:
            name = f"differences of {PAPER_STEP_DEG:g} deg, {model}"
            fine = stepped(problem, PAPER_STEP_DEG)
            found.append(Way(name=name, model=model, slope=Slope.DIFFERENCES, problem=fine, paper=seconds.get(key)))
        name = f"differences of {told(clear)}, {model}"
        found.append(Way(name=name, model=model, slope=Slope.DIFFERENCES, problem=clear))
    if several:
        name = f"differences of {told(clear)}, {Model.MPM}, Gauss-Newton"
        found.append(Way(name=name, model=Model.MPM, slope=Slope.DIFFERENCES, problem=clear, newton=True))
    for model in Model:
        found.append(Way(name=f"Optuna, {model}", model=model, slope=Slope.NONE, problem=problem))
    return found


def stepped(problem: Problem, step: float | None) -> Problem:
    """`problem` with this step of its differences, or with one that is clear of the scatter.

    The bounds come nearer by a step, so that no difference leaves them.
    """

    def with_step(unknown: Unknown) -> Unknown:
        h = CLEAR[kind(unknown.name).unit] if step is None else step
        return dataclasses.replace(unknown, step=h, lower=unknown.lower + h, upper=unknown.upper - h)

    return dataclasses.replace(problem, unknowns=tuple(with_step(unknown) for unknown in problem.unknowns))


def told(problem: Problem) -> str:
    """The steps in words."""
    steps = {f"{h:g} {kind(name).unit}": None for name, h in zip(problem.names, problem.steps, strict=True)}
    return " and ".join(steps)
