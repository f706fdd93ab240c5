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
from inverse.measured import DRAWS, MeasuredProfile, read_profile
from inverse.observations import Deposit, Observation, Profile, Values
from inverse.problem import Problem
from inverse.unknowns import kind, with_unknowns


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
    truth: dict[str, float] | None = None
    """Where known: the true unknowns."""

    def front_error(self, observation: Observation, deposit: NDArray[np.floating]) -> float:
        """Relative error of the front of `deposit`, positions [m], shape [N, D].

        Where the target's deposit is not known, both reach as far as the observation says.
        """
        known = self.deposit is not None
        reached = measures.front(deposit) if known else observation.edge(observation.exact(deposit))
        return (reached - self.edge) / self.edge


def hidden_scene(problem: Problem) -> Scene:
    """The scene of a twin experiment: the true unknowns and a jitter of its own."""
    names = list(problem.target.truth)
    scene = with_unknowns(problem.scene, names, [problem.target.truth[name] for name in names])
    return dataclasses.replace(scene, seed=problem.target.seed)


def read_target(problem: Problem, observation: Observation, simulate: Callable[[Scene], Trajectory]) -> Target:
    """The target of `problem`; a hidden one is made with `simulate`. Raises InputError."""
    settings = problem.target
    if settings.least:
        return Target(values=np.zeros(1), edge=math.nan)
    if settings.value is not None or settings.values is not None:
        values = np.array([settings.value] if settings.values is None else settings.values)
        return Target(values=values, edge=observation.edge(values))
    if settings.csv is not None:
        assert isinstance(observation, Profile)
        heights = measured_profile(problem, observation).at(observation.stations)
        values = observation.of_heights(heights)
        return Target(values=values, edge=observation.edge(values), profile=(observation.stations, heights))
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
    return Target(values=observation.exact(deposit), edge=measures.front(deposit), deposit=deposit, truth=truth)


def with_noise(problem: Problem, observation: Observation) -> Problem:
    """`problem`, a noise stated as a share made that of each number observed [m; of a share that passed -].

    A share of a measured number is that of the number; of a measured profile that of each of its heights, whose effect
    on the observation is found by drawing them. Its numbers then err together, so what counts is the standard deviation
    of the combination of them (a unit vector) that errs most. Raises InputError.
    """
    settings = problem.target
    if settings.noise_share == 0.0:
        return problem
    if settings.csv is not None:
        assert isinstance(observation, Profile)
        profile = measured_profile(problem, observation)
        drawn = [profile.drawn(settings.noise_share, seed).at(observation.stations) for seed in range(DRAWS)]
        covariance = np.cov([observation.of_heights(each) for each in drawn], rowvar=False)
        noise = math.sqrt(float(np.linalg.eigvalsh(covariance)[-1]))
    else:
        assert settings.value is not None, "a problem has been checked"
        noise = settings.noise_share * settings.value
    return dataclasses.replace(problem, target=dataclasses.replace(settings, noise=noise, noise_share=0.0))


def measured_profile(problem: Problem, observation: Profile) -> MeasuredProfile:
    """The profile of the problem's CSV, checked against its scene. Raises InputError."""
    released = observation.volume / observation.width
    return read_profile(problem.folder, problem.target, problem.scene.domain.size[0], released)
