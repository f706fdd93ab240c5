"""`python -m validation.bench.efficiency.scene_run WORK TIMES`: one gradient's work in a tall column, as JSON.

A process of its own for each: memory that another one left behind would count otherwise.
"""

import dataclasses
import json
import sys
import time
from enum import StrEnum
from pathlib import Path

import torch

from datasets.command_line import run
from datasets.errors import InputError
from datasets.library import read_scene
from datasets.particles import particle_count
from datasets.scene import Domain, Mass, Scene
from gns.inference import SHIPPED
from gns.model import checkpoint
from gns.model.simulator import Simulator
from inverse.forward.gns import MEMORY_GIB, GnsForward
from inverse.forward.mpm import MpmForward
from inverse.gradient import automatic
from inverse.observations import deposit as observations
from inverse.parameters.parameters import Vector
from inverse.problem import Observable, ObservationSettings, OptimiserSettings, Problem, Start, TargetSettings, Unknown
from mpm.simulate import simulate_many
from validation.bench.efficiency.race import WARM_S
from validation.report.memory import forgotten, peak, resident

SCENE = "column-tall-42"
STEP_DEG = 0.5
"""Between the angles of the runs of a difference; what they cost does not depend on it."""


class Work(StrEnum):
    """What is run."""

    AD = "ad"
    """Forward and backward through the GNS."""
    GNS = "gns"
    """One rollout, as differences of the GNS run one after the other."""
    MPM = "mpm"
    """One run, then runs side by side, as differences of the MPM."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Took:
    """What the work took."""

    points: int
    """Of the scene."""
    followed: int
    """Points that the method computes with."""
    steps: int
    """Of the GNS; 0 for the MPM."""
    forward: float
    """[s]."""
    rest: float
    """The backward pass, or the runs side by side [s]."""
    extra: int
    """Peak above what was held before [bytes]."""
    state: int
    """What a step of the GNS leaves behind for the backward pass [bytes]; 0 elsewhere."""


def column(times: float, *, duration: float = 1.0) -> Scene:
    """The tall column and its box, `times` as long and as high, on the same cells."""
    scene = read_scene(SCENE)
    (mass,) = scene.masses
    return dataclasses.replace(
        scene,
        domain=Domain(size=scaled(scene.domain.size, times), cell=scene.domain.cell),
        masses=(Mass(lower=mass.lower, size=scaled(mass.size, times)),),
        duration=duration,
    )


def scaled(lengths: tuple[float, ...], times: float) -> tuple[float, ...]:
    """`lengths` [m], `times` as long, free of what rounding adds."""
    return tuple(round(length * times, 9) for length in lengths)


def asked(scene: Scene) -> Problem:
    """Which angle of friction? From the front, the rollout from rest."""
    return Problem(
        name="column",
        folder=Path(),
        scene=scene,
        unknowns=(Unknown(name="friction_deg", initial=30.0, lower=12.0, upper=52.0),),
        observation=ObservationSettings(kind=Observable.FRONT),
        target=TargetSettings(value=0.5),
        optimiser=OptimiserSettings(start=Start.FROM_REST),
    )


def surrogate(scene: Scene, simulator: Simulator, memory_gib: float) -> GnsForward:
    """The GNS's forward of a column."""
    problem = asked(scene)
    observation = observations.build(problem.observation, scene)
    return GnsForward(simulator, None, problem, observation, memory_gib)


def took(work: Work, scene: Scene, *, model: Path = SHIPPED, runs: int = 2, memory_gib: float = MEMORY_GIB) -> Took:
    """Do the work in this process; what is compiled at a first call is no part of it."""
    problem = asked(scene)
    start = problem.initial
    short = column(1, duration=WARM_S)
    if work is Work.MPM:
        mpm = MpmForward(problem, observations.build(problem.observation, scene), simulate_many)
        MpmForward(asked(short), mpm.observation, simulate_many).observe([start])
        points, followed, steps, state = particle_count(scene), particle_count(scene), 0, 0
        forgotten()
        before = resident() or peak()
        began = time.perf_counter()
        mpm.observe([start])
        middle = time.perf_counter()
        mpm.observe(sides(start, runs))
        forward, rest = middle - began, time.perf_counter() - middle
    else:
        simulator = checkpoint.load(model).simulator.requires_grad_(False)
        target = start * 0.0
        automatic(surrogate(short, simulator, memory_gib), target)(start)
        gns = surrogate(scene, simulator, memory_gib)
        points, followed, steps = particle_count(scene), len(gns.indices), gns.steps
        state = gns.initial.state.positions.nbytes + gns.initial.state.displacements.nbytes
        forgotten()
        before = resident() or peak()
        if work is Work.AD:
            evaluated = automatic(gns, target)(start)
            forward, rest = evaluated.forward_s, evaluated.backward_s
        else:
            began = time.perf_counter()
            gns.observe([start])
            forward, rest = time.perf_counter() - began, 0.0
    return Took(
        points=points,
        followed=followed,
        steps=steps,
        forward=forward,
        rest=rest,
        extra=max(0, peak() - before),
        state=state,
    )


def sides(start: Vector, runs: int) -> list[Vector]:
    """As many different angles as differences ask for at once."""
    return [start + STEP_DEG * (number + 1) / runs for number in range(runs)]


def command(
    work: Work,
    times: float,
    /,
    *,
    duration: float = 1.0,
    runs: int = 2,
    threads: int = 1,
    memory_gib: float = MEMORY_GIB,
    model: Path = SHIPPED,
) -> None:
    """What one gradient's work takes in the tall column, TIMES as long and as high; prints seconds and memory as JSON.

    Parameters
    ----------
    work
        ad, gns or mpm.
    times
        The column's size over the paper's.
    duration
        Simulated time [s].
    runs
        mpm: runs side by side after the one that is alone, two for each unknown.
    threads
        Of PyTorch.
    memory_gib
        ad: activations that the backward pass may find ready.
    model
        Weights of the surrogate.
    """
    for key, value in (("TIMES", times), ("--runs", runs), ("--threads", threads)):
        if not value >= 1:
            raise InputError(f"expected at least 1, got {value:g}", key=key)
    torch.set_num_threads(threads)
    made = took(work, column(times, duration=duration), model=model, runs=runs, memory_gib=memory_gib)
    print(json.dumps(dataclasses.asdict(made)))


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.bench.efficiency.scene_run"))
