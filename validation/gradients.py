"""The gradients compared on one column: by AD and by differences, through the surrogate and through the MPM."""

import dataclasses
from dataclasses import dataclass

import numpy as np

from gns.simulator import Simulator
from inverse import observations
from inverse.finite_difference import central
from inverse.forward import Forward
from inverse.gns_forward import GnsSource
from inverse.gradient import Evaluate, automatic
from inverse.inversion import invert
from inverse.mpm_forward import MpmForward
from inverse.observations import Values
from inverse.problem import Method, OptimiserSettings, Problem
from inverse.report import table
from inverse.result import Result
from inverse.target import read_target
from mpm.simulate import simulate, simulate_many
from validation.paper import Paper

COMPARED = "tall-42"
"""The scenario on which the paper compares gradients."""
PAPER_STEP_DEG = 0.05
WIDE_STEP_DEG = 2.0
"""A step whose difference stands clear of the MPM's scatter."""
PAPERS_WAY = OptimiserSettings(method=Method.GRADIENT_DESCENT, max_iterations=20, stop_below=5.0e-4)


@dataclass(frozen=True, kw_only=True)
class Way:
    """A row of the comparison."""

    name: str
    forward: Forward
    problem: Problem
    """With the optimiser's settings and the step of this row."""
    evaluate: Evaluate
    paper_seconds: float | None
    """The paper's seconds per iteration."""


def comparison(problem: Problem, simulator: Simulator, paper: Paper) -> list[str]:
    """The table, in Markdown, with what it shows: every method from the same start to the same target."""
    observation = observations.build(problem.observation, problem.scene)
    target = read_target(problem, observation, simulate)
    mpm = MpmForward(problem, observation, simulate_many)
    source = GnsSource(simulator, problem, observation)
    start = np.array([unknown.initial for unknown in problem.unknowns])
    frames = source.first_frames(mpm.scene(start))
    gns = source.start(None if frames is None else simulate(frames))
    paper_s = paper.seconds_per_iteration
    descent = dataclasses.replace(problem, optimiser=PAPERS_WAY)
    fine, wide = stepped(problem, PAPER_STEP_DEG), stepped(problem, WIDE_STEP_DEG)
    ways = [
        Way(name="AD, GNS", forward=gns, problem=problem, evaluate=automatic(gns, target.values), paper_seconds=None),
        Way(
            name="AD, GNS, the paper's gradient descent",
            forward=gns,
            problem=descent,
            evaluate=automatic(gns, target.values),
            paper_seconds=paper_s["ad_gns"],
        ),
    ]
    for model, forward, seconds in (("GNS", gns, paper_s["fd_gns"]), ("our MPM", mpm, paper_s["fd_mpm"])):
        for variant, step in ((fine, PAPER_STEP_DEG), (wide, WIDE_STEP_DEG)):
            ways.append(
                Way(
                    name=f"differences of {step:g} deg, {model}",
                    forward=forward,
                    problem=variant,
                    evaluate=central(forward, target.values, variant),
                    paper_seconds=seconds if variant is fine else None,
                )
            )
    rows, outcomes = [], []
    for way in ways:
        mpm.runs = 0
        result = invert(way.problem, target, way.evaluate)
        spent = mpm.runs
        (shown,) = mpm.observe([result.answer])
        rows.append(row(way, result, spent, shown))
        outcomes.append((way.name, abs(shown[0] - target.values[0]), result.total_seconds))
    return [
        f"## The gradients compared: {problem.name}",
        "",
        "Every method starts at the same angle and stops by the same rule; the paper's gradient descent by its own.",
        "",
        *table(HEAD, rows),
        "",
        f"Nearest to the target in the MPM: {min(outcomes, key=lambda outcome: outcome[1])[0]}. "
        f"Soonest done: {min(outcomes, key=lambda outcome: outcome[2])[0]}.",
        f"The paper's angle by differences with its GNS: {paper.fd_gns_phi_estimated:.2f} deg.",
    ]


HEAD = [
    "method",
    "seconds per iteration",
    "the paper's",
    "iterations",
    "MPM runs",
    "seconds",
    "angle found",
    "error",
    "front there in the MPM",
]


def row(way: Way, result: Result, spent: int, shown: Values) -> list[str]:
    """One method as a line."""
    (found,) = result.unknowns.values()
    target = result.target
    return [
        way.name,
        f"{result.seconds['per_iteration']:.2f}",
        "-" if way.paper_seconds is None else f"{way.paper_seconds:g}",
        str(len(result.evaluations)),
        str(spent),
        f"{result.total_seconds:.0f}",
        f"{found:.2f}",
        ", ".join(f"{error:.2f} %" for error in result.error_pct.values()),
        f"{100.0 * (shown[0] - target.values[0]) / target.values[0]:+.2f} %",
    ]


def stepped(problem: Problem, step: float) -> Problem:
    """`problem` with another step of its finite differences."""
    return dataclasses.replace(
        problem, unknowns=tuple(dataclasses.replace(unknown, step=step) for unknown in problem.unknowns)
    )
