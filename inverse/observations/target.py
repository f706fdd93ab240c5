"""The target: what was observed, and, for a twin experiment, the truth that the inversion must not see."""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datasets import measures
from datasets.errors import InputError
from datasets.particles import particle_count
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from inverse.observations.combined import Combined
from inverse.observations.deposit import Deposit, Observation, OfDeposit, Profile, Values, build
from inverse.observations.profile import MeasuredProfile, profile_of
from inverse.observations.sampled import REPRESENTATION, SampledProfile, sampled
from inverse.parameters.parameters import kind, with_unknowns
from inverse.problem import Problem


@dataclass(frozen=True, kw_only=True)
class Target:
    """What the inversion is given (`values`) and what only the report may look at (the rest)."""

    values: Values
    """The observation, shape [M]."""
    edge: float
    """How far the deposit reaches [m]: what the front of an MPM run is held against; nan where nothing tells."""
    deposit: NDArray[np.floating] | None = None
    """Where known: positions of the deposit [m], shape [N, D]."""
    profile: tuple[NDArray[np.float64], Values] | None = None
    """Where it was measured: stations and heights of the deposit [m], both of shape [S]."""
    deviation: Values | None = None
    """Of a measured profile: standard deviation of each of these heights [m], shape [S]."""
    roughness: float = 1.0
    """By how much the heights of a measured profile scatter more than their stated noise; it is part of `deviation`."""
    noise: float = 0.0
    """Standard deviation of each of the values by errors of the measurement; of values that err together (below) that
    of the combination of them, a unit vector, that errs most."""
    covariance: NDArray[np.float64] | None = None
    """Of the values by errors of the measurement, shape [M, M]; where absent they err independently, by `noise`."""
    truth: dict[str, float] | None = None
    """Where known: the true unknowns."""
    combined: Combined | None = None
    """Of several observations: what they are, and in which units their numbers are."""

    def front_error(self, observation: Observation, deposit: NDArray[np.floating]) -> float:
        """Relative error of the front of `deposit`, positions [m], shape [N, D].

        Where the target's deposit is not known, both reach as far as the observation says.
        """
        if self.deposit is not None:
            reached = measures.front(deposit)
        elif isinstance(observation, OfDeposit):
            reached = observation.edge(observation.exact(deposit))
        else:
            return math.nan
        return (reached - self.edge) / self.edge


def hidden_scene(problem: Problem) -> Scene:
    """The scene of a twin experiment: the true unknowns and a jitter of its own."""
    names = list(problem.target.truth)
    scene = with_unknowns(problem.scene, names, [problem.target.truth[name] for name in names])
    return dataclasses.replace(scene, seed=problem.target.seed)


def read_target(problem: Problem, observation: OfDeposit, simulate: Callable[[Scene], Trajectory]) -> Target:
    """The target of `problem`; a hidden one is made with `simulate`. Raises InputError."""
    settings = problem.target
    if settings.least:
        return Target(values=np.zeros(1), edge=math.nan, noise=settings.noise)
    if settings.value is not None or settings.values is not None:
        values = np.array([settings.value] if settings.values is None else settings.values)
        noise = settings.noise + settings.noise_share * float(abs(values[0]))
        return Target(values=values, edge=observation.edge(values), noise=noise)
    if settings.csv is not None:
        assert isinstance(observation, Profile)
        profile = measured_profile(problem)
        heights = profile.at(observation.stations)
        values = observation.of_heights(heights)
        seen = (observation.stations, heights)
        if not isinstance(observation, SampledProfile):
            return Target(values=values, edge=observation.edge(values), profile=seen, noise=settings.noise)
        deviation, rough = deviation_of(
            profile, share=settings.noise_share, noise=settings.noise, cell=problem.scene.domain.cell
        )
        covariance = observation.covariance(profile, deviation)
        return Target(
            values=values,
            edge=observation.edge(values),
            profile=seen,
            roughness=rough,
            deviation=np.interp(observation.stations, profile.x, deviation, left=0.0, right=0.0),
            noise=math.sqrt(float(np.linalg.eigvalsh(covariance)[-1])),
            covariance=covariance,
        )
    truth = None
    if settings.hidden:
        scene = hidden_scene(problem)
        trajectory = simulate(scene)
        truth = {unknown.name: kind(unknown.name).read(scene) for unknown in problem.unknowns}
    else:
        path = problem.folder / str(settings.trajectory)
        trajectory = Trajectory.load(path)
        if trajectory.scene.dimension != problem.scene.dimension:
            raise InputError(
                f"expected a {problem.scene.dimension}D trajectory as the scene's, got {trajectory.scene.dimension}D",
                where=str(path),
            )
    deposit = trajectory.positions[-1]
    points = particle_count(problem.scene)
    if isinstance(observation, Deposit) and len(deposit) != points:
        raise InputError(
            f"expected the {points} points of the problem's scene for a target of kind deposit, got {len(deposit)}",
            where=str(settings.trajectory),
        )
    return Target(
        values=observation.exact(deposit),
        edge=measures.front(deposit),
        deposit=deposit,
        truth=truth,
        noise=settings.noise,
    )


def observation_of(problem: Problem) -> OfDeposit:
    """The one thing that is compared of a deposit of `problem`; of a measured profile its rows alone.

    Raises InputError. For several observations see `inverse.observations.measurements`.
    """
    if problem.target.csv is None:
        return build(problem.observation, problem.scene)
    rows = measured_profile(problem).x
    return sampled(problem.target.heights)(problem.scene, problem.observation.spacing, rows)


def deviation_of(profile: MeasuredProfile, *, share: float, noise: float, cell: float) -> tuple[Values, float]:
    """Standard deviation [m] of each height of a measured profile, shape [R], and by how much it is above the stated.

    Stated are a `share` of each height and, of all alike, `noise` [m]; the error of representation in cells of `cell`
    [m] comes on top (`inverse.observations.sampled`). Rows that scatter more than that have more noise than was stated.
    """
    stated = profile.deviation(share=share, noise=math.hypot(noise, REPRESENTATION * cell))
    rough = profile.roughness(stated)
    return rough * stated, rough


def measured_profile(problem: Problem) -> MeasuredProfile:
    """The profile of the problem's CSV, checked against its scene. Raises InputError."""
    settings = problem.target
    return profile_of(
        problem.folder / str(settings.csv),
        unit=settings.unit,
        datum=settings.datum,
        heights=settings.heights,
        length=problem.scene.domain.size[0],
        released=None if problem.changes_volume else problem.released,
        ground=problem.ground,
    )
