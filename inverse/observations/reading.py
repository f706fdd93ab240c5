"""From a problem's `[observation]` or `[[observations]]` to its target: operator, numbers and their errors."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from scipy.linalg import block_diag

from datasets import measures
from datasets.errors import InputError
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from inverse.observations import KINDS
from inverse.observations.joint import Joint, Part
from inverse.observations.observation import Context, Matrix, Measurement, Values
from inverse.observations.target import Target
from inverse.problem import Problem
from inverse.settings import MEASURED, ObservationSettings, noise_of


class Source(Protocol):
    """Where observed numbers come from, of a target."""

    @property
    def trajectory(self) -> str | None:
        """A trajectory that was observed."""

    @property
    def measured(self) -> bool:
        """Whether the observations bring their own numbers."""


class Observed(Protocol):
    """What a problem tells of its observations."""

    @property
    def scene(self) -> Scene:
        """The flow."""

    @property
    def folder(self) -> Path:
        """Relative paths start here."""

    @property
    def released(self) -> float | None:
        """Volume of the masses over the width [m^2]."""

    @property
    def observations(self) -> tuple[ObservationSettings, ...]:
        """Those that are compared together, if any."""

    @property
    def target(self) -> Source:
        """What came out."""


def read_target(problem: Problem, simulate: Callable[[Scene], Trajectory]) -> Target:
    """The target of `problem`; the flow of a twin is made with `simulate`. Raises InputError, with its key or file."""
    measurements = read_each(problem)
    run, truth = None, None
    if problem.target.twin:
        scene = problem.twin_scene
        run, truth = simulate(scene), {each.name: each.kind.read(scene) for each in problem.parameters}
    elif problem.target.trajectory is not None:
        run = read_run(problem, measurements)
    if problem.observations:
        return joint(problem, measurements, run, truth)
    return single(problem, measurements[0], run, truth)


def read_each(problem: Problem) -> list[Measurement]:
    """Every observation of `problem` with its numbers. Raises InputError, which names the key or the file."""
    if not problem.observations:
        merged = {key: getattr(problem.target, key) for key in MEASURED}
        settings = dataclasses.replace(problem.observation, **merged)
        return [_read(problem, settings, lambda key: f"{'target' if key in MEASURED else 'observation'}.{key}")]
    return read_joined(problem)


def read_joined(problem: Observed) -> list[Measurement]:
    """Every one of its `[[observations]]` with its numbers. Raises InputError, which names the key or the file."""
    return [
        _read(problem, settings, lambda key, index=index: f"observations[{index}].{key}".removesuffix("."))  # type: ignore[misc]
        for index, settings in enumerate(problem.observations)
    ]


def _read(problem: Observed, settings: ObservationSettings, path: Callable[[str], str]) -> Measurement:
    context = Context(
        scene=problem.scene,
        folder=problem.folder,
        released=problem.released,
        joint=bool(problem.observations),
    )
    kind = KINDS[settings.kind]
    try:
        noise_of(settings.noise)
        found = kind.read(settings, context)
        given = found.values is not None and len(found.values) > 0
        if problem.target.measured and not given:
            raise InputError(f"expected what was measured for {settings.kind}: {kind.source}")
        if not problem.target.measured and given:
            raise InputError("expected no numbers beside a twin or a trajectory")
    except InputError as error:
        raise error if error.where else InputError(error.message, key=path(error.key)) from None
    return found


def read_run(problem: Observed, measurements: Sequence[Measurement]) -> Trajectory:
    """The observed trajectory of a file. Raises InputError, which names it."""
    path = problem.folder / str(problem.target.trajectory)
    run = Trajectory.load(path)
    try:
        if run.scene.dimension != problem.scene.dimension:
            expected = f"a {problem.scene.dimension}D trajectory as the scene's"
            raise InputError(f"expected {expected}, got {run.scene.dimension}D")
        for each in measurements:
            each.observation.check_run(run, problem.scene)
    except InputError as error:
        raise error.at(str(path)) from None
    return run


def single(
    problem: Problem, measurement: Measurement, run: Trajectory | None, truth: dict[str, float] | None
) -> Target:
    """The target of one observation; run: the flow that was observed, where it is known."""
    observation, values, profile = measurement.observation, measurement.values, measurement.profile
    share, noise = noise_of(problem.target.noise)
    if problem.target.minimise:
        return Target(observation=observation, values=np.zeros(1), front=math.nan, noise=noise)
    if run is not None:
        deposit = run.positions[-1]
        return Target(
            observation=observation,
            values=observation.observe(run),
            front=measures.front(deposit),
            noise=noise,
            cell=run.scene.domain.cell,
            deposit=deposit,
            truth=truth,
        )
    assert values is not None, "what was measured has been read"
    front = observation.front(values)
    if profile is None:
        noise += share * float(abs(values[0]))
        return Target(observation=observation, values=values, front=front, noise=noise)
    errors = observation.errors(values, profile, share=share, noise=noise, cell=problem.scene.domain.cell)
    return Target(
        observation=observation,
        values=values,
        front=front,
        noise=math.sqrt(float(np.linalg.eigvalsh(errors.covariance)[-1])),
        covariance=errors.covariance,
        profile=errors.profile,
        deviation=errors.deviation,
        roughness=errors.roughness,
    )


def joint(
    problem: Observed,
    measurements: Sequence[Measurement],
    run: Trajectory | None,
    truth: dict[str, float] | None = None,
) -> Target:
    """The target of multiple observations: each number over its standard deviation (`inverse.observations.joint`)."""
    cell = problem.scene.domain.cell
    values: list[Values] = []
    prior: list[Values] = []
    covariance: list[Matrix] = []
    parts: list[Part] = []
    roughness = 1.0
    for settings, each in zip(problem.observations, measurements, strict=True):
        own = each.values
        if own is None:
            assert run is not None, "what was measured has been read"
            own = each.observation.observe(run)
            each = dataclasses.replace(each, profile=each.observation.profile_of(run))
        share, noise = noise_of(settings.noise)
        errors = each.observation.errors(own, each.profile, share=share, noise=noise, cell=cell)
        first = sum(len(before) for before in values)
        name = settings.name or name_of(settings, problem.observations[: len(parts)])
        parts.append(Part(name=name, observation=each.observation, numbers=slice(first, first + len(own))))
        values.append(own)
        covariance.append(errors.covariance)
        prior.append(each.observation.prior_scatter(own, cell))
        roughness = max(roughness, errors.roughness)
    noise_squared, scatter = np.concatenate([np.diag(each) for each in covariance]), np.concatenate(prior)
    scale = np.sqrt(noise_squared + scatter**2)
    if not np.all(scale > 0.0):
        name = next(part.name for part in parts if not np.all(scale[part.numbers] > 0.0))
        raise InputError(f"expected a noise above 0 for {name}, whose numbers are all 0", key="observations")
    whole = block_diag(*covariance) / np.outer(scale, scale)
    deposit = None if run is None else run.positions[-1]
    return Target(
        observation=Joint(parts, scale, scatter),
        values=np.concatenate(values) / scale,
        front=math.nan if deposit is None else measures.front(deposit),
        noise=float(np.sqrt(np.linalg.eigvalsh(whole)[-1])),
        covariance=whole,
        cell=None if run is None else run.scene.domain.cell,
        deposit=deposit,
        roughness=roughness,
        truth=truth,
    )


def name_of(settings: ObservationSettings, others: Sequence[ObservationSettings]) -> str:
    """The name of an observation that has none: its kind, counted where others have the same."""
    same = sum(other.kind == settings.kind for other in others)
    return settings.kind if same == 0 else f"{settings.kind} {same + 1}"
