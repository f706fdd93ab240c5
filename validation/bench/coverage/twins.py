"""Twin experiments whose truth is drawn from the prior, and where their posterior has it.

A truth v0 is drawn from the prior, its flow by the MPM with a jitter seed of its own is observed with noise as stated,
and the loop solves for it. If the posterior is right, the share of it that is denser than v0 is uniform over the twins,
and so is the share of each parameter's marginal below v0 (Talts, Betancourt, Simpson, Vehtari & Gelman, Validating
Bayesian inference algorithms with simulation-based calibration, arXiv:1804.06788, 2018; Hyndman, Computing and graphing
highest density regions, Am. Stat. 50 (1996) 120-126).
"""

import dataclasses
import tempfile
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from datasets.records import Record, from_mapping, read_json
from inverse.forward.interface import Simulate
from inverse.problem import Problem, read_problem
from inverse.result import Result
from inverse.settings import TargetSettings
from inverse.target import Target, read_target
from mpm import LAST, simulate_many
from validation.loop.solve import run
from validation.loop.task import Task

FIRST_SEED = 100_000
"""Jitter seed of the first twin's target, then upwards; its inversion has others."""


@dataclass(frozen=True, kw_only=True)
class Family:
    """Twins of one problem."""

    title: str
    problem: str
    """Name of a shipped problem, whose scene, parameters and observation the twins have."""
    noise: float = 0.0
    """Standard deviation of the noise on each number, as a fraction of the front."""
    finer: float = 1.0
    """Cells of the target's flow, as a share of the scene's: what the inversion's own cells get wrong."""


FAMILIES = {
    "front": Family(title="Friction, front", problem="friction-tall-42"),
    "front-noise": Family(title="Friction, front with 1 % noise", problem="friction-short-21", noise=0.01),
    "profile": Family(title="Friction, profile", problem="friction-tall-42-profile"),
    "cohesion": Family(title="Friction and cohesion, profile", problem="cohesion-friction"),
    "front-fine": Family(title="Friction, front, target of half the cells", problem="friction-tall-42", finer=0.5),
    "profile-fine": Family(
        title="Friction, profile, target of half the cells", problem="friction-tall-42-profile", finer=0.5
    ),
    "layers": Family(title="Friction of four layers, deposit", problem="slope-layers"),
    "velocities": Family(title="Velocities of ten layers, deposit", problem="velocity-layers-10"),
    "baffles": Family(title="Two baffles, toe", problem="baffles-2"),
}


@dataclass(frozen=True, kw_only=True)
class Twin(Record):
    """Where the posterior has the truth."""

    seed: int
    denser: float
    """Share of the posterior that is denser than the truth: above 0.95 it is outside of the 95 % region."""
    below: dict[str, float]
    """Share of each parameter's marginal below the true value."""
    inside: int
    """Parameters whose half-width about the answer nearest to the truth holds the true value."""
    answers: int
    verdict: str
    runs: int
    seconds: float


def path_of(number: int, folder: Path) -> Path:
    """The file of a twin in the folder of its family."""
    return folder / f"{number:03d}.json"


def read_twin(path: Path) -> Twin | None:
    """The twin at `path`; None where it was not solved yet."""
    return None if (known := read_json(path)) is None else from_mapping(Twin, known)


def solve_twin(family: Family, number: int, threads: int | None = None) -> Twin:
    """Solve the twin of this number; threads: of the MPM, all cores unless given."""
    simulate: Simulate = simulate_many if threads is None else partial(simulate_many, threads=threads)
    problem, target = drawn(family, number)
    with tempfile.TemporaryDirectory() as runs:
        result = run(Task(problem=problem, target=target, folder=Path(runs), simulate=simulate))
    return located(result, FIRST_SEED + number)


def drawn(family: Family, number: int) -> tuple[Problem, Target]:
    """The problem, which states its noise, and its target; of the twin's deposit the target keeps nothing."""
    asked, rng = read_problem(family.problem), np.random.default_rng([FIRST_SEED, number])
    lower, upper = np.array(asked.bounds).T
    truth = asked.named(lower + (upper - lower) * rng.random(len(lower)))
    scene = dataclasses.replace(asked.scene, seed=int(rng.integers(2**31)))
    domain = dataclasses.replace(scene.domain, cell=family.finer * scene.domain.cell)
    twin = dataclasses.replace(
        asked,
        scene=dataclasses.replace(scene, domain=domain),
        target=TargetSettings(twin=True, seed=FIRST_SEED + number, truth=truth),
    )
    made = read_target(twin, lambda flow: simulate_many([flow], record=LAST)[0])
    sigma = family.noise * made.front
    values = made.values + sigma * rng.standard_normal(len(made.values))
    target = Target(
        observation=made.observation,
        values=values,
        front=made.observation.front(values),
        deviation=np.full(len(values), sigma),
        cell=made.cell,
        truth=made.truth,
    )
    return dataclasses.replace(asked, scene=scene, target=TargetSettings(twin=True, truth=truth)), target


def located(result: Result, seed: int) -> Twin:
    """Where the posterior of `result` has its truth."""
    found, truth = result.posterior, result.target.truth
    assert truth is not None
    values = np.array([truth[name] for name in result.problem.names])
    assert found is not None
    point = (values - result.problem.box.lower) / result.problem.box.range
    samples = found.samples
    excluded = np.any((point < found.region.low) | (point > found.region.high))
    density = -np.inf if excluded else float(found.likelihood(point[None])[0])
    off = [np.abs(values - each.parameters) / np.maximum(each.half_widths, 1e-300) for each in result.answers]
    return Twin(
        seed=seed,
        denser=float(samples.weights[samples.log_likelihood > density].sum()),
        below=result.problem.named(samples.weights @ (samples.points < point)),
        inside=int(np.sum(min(off, key=np.max) <= 1.0)),
        answers=len(result.answers),
        verdict=result.verdict.value,
        runs=len(result.mpm_runs),
        seconds=result.seconds["total"],
    )
