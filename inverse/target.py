"""The target of an inversion: measured numbers of the observations, or those of a twin or of an observed flow."""

import dataclasses
from collections.abc import Callable

import numpy as np

from datasets.errors import keyed, naming, require
from datasets.flow import measures
from datasets.flow.trajectory import Trajectory
from datasets.maps import require_same_place
from datasets.scene import Scene
from datasets.scene.particles import particle_count
from inverse.observations.target import Target, joined
from inverse.problem import Problem


def read_target(problem: Problem, simulate: Callable[[Scene], Trajectory]) -> Target:
    """The target of `problem`; `simulate` makes a twin's flow, to which drawn noise is added. Raises InputError."""
    if problem.target.measured:
        target = joined(problem.measured, part_names(problem))
        return dataclasses.replace(target, front=target.observation.front(target.values))
    truth = None
    if problem.target.twin:
        scene = problem.twin_scene
        truth = {number.name: number.kind.read(scene) for number in problem.numbers} | problem.target.truth
        run = problem.clocked(simulate(scene), np.array([truth[number.name] for number in problem.numbers]))
    else:
        run = read_run(problem)
    parts = []
    for index, settings in enumerate(problem.observations):
        with keyed(f"observations[{index}]"):
            parts.append(settings.of_run(problem.scene, run))
    target = joined(parts, part_names(problem))
    if problem.target.twin and target.deviation.any():
        rng = np.random.default_rng(problem.target.seed)
        errors = target.errors.drawn(rng)
        if target.dof is not None:
            # Student's t: a normal number divided by the root of (chi-square / its degrees of freedom).
            dof = np.minimum(target.dof, 1e9)
            errors = errors * np.sqrt(dof / rng.chisquare(dof))
        target = dataclasses.replace(target, values=target.values + errors)
    deposit, cell = run.positions[-1], run.scene.domain.cell
    front = measures.front(deposit, run.volumes)
    return dataclasses.replace(target, front=front, cell=cell, deposit=deposit, truth=truth or None)


def part_names(problem: Problem) -> list[str]:
    """The name of each observation in reports; a second observation of the same kind has a number."""
    kinds, names = [settings.kind for settings in problem.observations], []
    for index, settings in enumerate(problem.observations):
        before = kinds[:index].count(settings.kind)
        names.append(settings.name or (f"{settings.kind} {before + 1}" if before else settings.kind))
    return names


def read_run(problem: Problem) -> Trajectory:
    """The observed trajectory of a file. Raises InputError, which names the file."""
    path = problem.folder / str(problem.target.trajectory)
    run = Trajectory.load(path)
    with naming(path):
        dimension, its = problem.scene.dimension, run.scene.dimension
        require(its == dimension, "", f"a {dimension}D trajectory as the scene's", f"{its}D")
        require_same_place(problem.scene, run.scene, "the scene's")
        count, got = particle_count(problem.scene), run.positions.shape[1]
        fits = got == count or not any(operator.every_particle for operator in problem.operators)
        require(fits, "", f"the {count} particles of the problem's scene for a deposit", got)
    return run
