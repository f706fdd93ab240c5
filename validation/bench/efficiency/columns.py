"""Seconds and memory of a gradient as the scene grows: the tall column on the same cells, each case in a process."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import torch
from gns.initial import Start
from tqdm import tqdm

from datasets.library import read_scene
from datasets.particles import particle_count
from datasets.scene import Domain, Mass, Scene
from gns.model import checkpoint
from gns.rollout import SHIPPED
from inverse.forward.gns import MEMORY_GIB, GnsForward
from inverse.forward.mpm import MpmForward
from inverse.jacobian import automatic
from inverse.observations import build
from inverse.problem import Problem
from inverse.settings import ObservationSettings, OptimiserSettings, Parameter, TargetSettings
from mpm.process import processors
from mpm.simulation import simulate_many
from validation.bench.efficiency.records import AD, FD_GNS, FD_MPM, Cost, Origin, OverParticles
from validation.bench.efficiency.search import WARM_UP_S
from validation.report.memory import forgotten, peak, resident
from validation.report.process import isolated

SCENE = "column-tall-42"
STEP_DEG = 0.5
"""Between the angles of the runs of a difference; their cost does not depend on it."""
UNKNOWNS = (1, 10)
WHOLE_S = 1.0
"""How long the flow lasts [s]."""


class Work(StrEnum):
    """What a process runs."""

    AD = "AD"
    """Forward and backward through the GNS."""
    GNS = "GNS"
    """One rollout, as differences of the GNS run one after the other."""
    MPM = "MPM"
    """One run, then runs side by side, as differences of the MPM."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """What a process of its own runs."""

    work: Work
    scale: float
    """Length and height of the column over the paper's."""
    duration: float = WHOLE_S
    runs: int = 2
    """Of the MPM side by side after the one alone, two for each unknown."""
    memory_gib: float = MEMORY_GIB
    """Activations that the backward pass may find ready."""


@dataclass(frozen=True, kw_only=True)
class Usage:
    """Time and memory of a task."""

    particles: int
    """Of the scene."""
    nodes: int
    """Of the graph; the particles where the MPM runs."""
    steps: int
    """Of the GNS; 0 for the MPM."""
    forward: float
    """[s]."""
    rest: float
    """The backward pass, or the runs side by side [s]."""
    extra: int
    """Peak above what was held before [bytes]."""
    state: int
    """What a step of the GNS leaves for the backward pass [bytes]; 0 for the MPM."""


@dataclass(frozen=True, kw_only=True)
class Size:
    """A column and how much of its gradients is run; the rest is multiplied."""

    scale: float
    gns_s: float = WHOLE_S
    """Simulated time of the GNS [s]."""
    most_runs: int = 2 * UNKNOWNS[-1]
    """Most runs of the MPM side by side."""


SIZES = (Size(scale=1.0), Size(scale=2.0), Size(scale=5.6, gns_s=0.1, most_runs=2))
"""3,200, 12,800 and 100,352 particles."""
QUICK = (Size(scale=1.0, gns_s=0.1, most_runs=2),)
Run = Callable[[Task], Usage]


def column(scale: float, *, duration: float = WHOLE_S) -> Scene:
    """The tall column and its box, `scale` times as long and as high, on the same cells."""
    scene = read_scene(SCENE)
    (mass,) = scene.masses

    def scaled(lengths: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(round(length * scale, 9) for length in lengths)

    return dataclasses.replace(
        scene,
        domain=Domain(size=scaled(scene.domain.size), cell=scene.domain.cell),
        masses=(Mass(lower=mass.lower, size=scaled(mass.size)),),
        duration=duration,
    )


def friction_problem(scene: Scene) -> Problem:
    """The angle of friction from the front, the rollout from rest."""
    return Problem(
        name="column",
        folder=Path(),
        scene=scene,
        parameters=(Parameter(name="friction_deg", initial=30.0, lower=12.0, upper=52.0),),
        observation=ObservationSettings(kind="front"),
        target=TargetSettings(value=0.5),
        optimiser=OptimiserSettings(start=Start.FROM_REST),
    )


def usage(task: Task, model: Path = SHIPPED) -> Usage:
    """Run a task in this process; kernels are compiled on a short flow before."""
    torch.set_num_threads(processors())
    scene = column(task.scale, duration=task.duration)
    problem, short = friction_problem(scene), friction_problem(column(1.0, duration=WARM_UP_S))
    observation = build(problem.observation, scene)
    start, particles = problem.initial, particle_count(scene)
    if task.work is Work.MPM:
        mpm = MpmForward(problem, observation, simulate_many)
        MpmForward(short, observation, simulate_many).observe([start])
        nodes, steps, state = particles, 0, 0
        forgotten()
        before, began = resident() or peak(), time.perf_counter()
        mpm.observe([start])
        middle = time.perf_counter()
        mpm.observe([start + STEP_DEG * (number + 1) / task.runs for number in range(task.runs)])
        forward, rest = middle - began, time.perf_counter() - middle
    else:
        simulator = checkpoint.load(model).simulator.requires_grad_(False)
        target = start * 0.0
        automatic(GnsForward(simulator, None, short, observation, task.memory_gib), target)(start)
        gns = GnsForward(simulator, None, problem, observation, task.memory_gib)
        nodes, steps = len(gns.indices), gns.steps
        state = gns.initial.state.positions.nbytes + gns.initial.state.displacements.nbytes
        forgotten()
        before, began = resident() or peak(), time.perf_counter()
        if task.work is Work.AD:
            evaluated = automatic(gns, target)(start)
            forward, rest = evaluated.forward_s, evaluated.backward_s
        else:
            gns.observe([start])
            forward, rest = time.perf_counter() - began, 0.0
    extra = max(0, peak() - before)
    return Usage(particles=particles, nodes=nodes, steps=steps, forward=forward, rest=rest, extra=extra, state=state)


def in_process(task: Task) -> Usage:
    """A task in a process of its own. Raises WorkFailed."""
    return isolated(usage, task)


def over_particles(origin: Origin, *, sizes: Sequence[Size] = SIZES, run: Run = in_process) -> OverParticles:
    """Every gradient in every size, one after the other."""
    found: list[Cost] = []
    with tqdm(total=len(sizes) * 3, desc="particles", unit="case", dynamic_ncols=True) as bar:
        for size in sizes:
            for costs in (_by_ad, _by_gns, _by_mpm):
                bar.set_postfix_str(f"{size.scale:g} times the column")
                found += costs(run, size)
                bar.update()
    return OverParticles(origin=origin, costs=tuple(found))


def _cost(method: str, used: Usage, unknowns: int, *, seconds: float, memory: int, measured: str) -> Cost:
    return Cost(
        method=method,
        particles=used.particles,
        nodes=used.nodes,
        unknowns=unknowns,
        seconds=seconds,
        memory=memory,
        measured=measured,
    )


def _by_ad(run: Run, size: Size) -> list[Cost]:
    """Forward and backward, once, whatever the number of unknowns."""
    whole = size.gns_s >= WHOLE_S
    # A few steps would keep a larger share of their activations than all do: what is multiplied keeps none.
    memory_gib = MEMORY_GIB if whole else 0.0
    used = run(Task(work=Work.AD, scale=size.scale, duration=size.gns_s, memory_gib=memory_gib))
    factor = WHOLE_S / size.gns_s
    # The states that the missing steps would leave for the backward pass.
    memory = used.extra + round(used.steps * (factor - 1.0)) * used.state
    measured = "" if whole else f"{used.steps} steps forward and backward"
    seconds = (used.forward + used.rest) * factor
    return [_cost(AD, used, each, seconds=seconds, memory=memory, measured=measured) for each in UNKNOWNS]


def _by_gns(run: Run, size: Size) -> list[Cost]:
    """Rollouts one after the other: one, and two more for each unknown."""
    used = run(Task(work=Work.GNS, scale=size.scale, duration=size.gns_s))
    measured = "one rollout" if size.gns_s >= WHOLE_S else f"{used.steps} steps of one rollout"
    seconds = used.forward * WHOLE_S / size.gns_s
    return [
        _cost(FD_GNS, used, each, seconds=(1 + 2 * each) * seconds, memory=used.extra, measured=measured)
        for each in UNKNOWNS
    ]


def _by_mpm(run: Run, size: Size) -> list[Cost]:
    """One run, then two more for each unknown side by side."""
    found = []
    known: dict[int, Usage] = {}
    for unknowns in UNKNOWNS:
        required = 2 * unknowns
        runs = min(required, size.most_runs)
        if runs not in known:
            known[runs] = run(Task(work=Work.MPM, scale=size.scale, runs=runs))
        used = known[runs]
        seconds = used.forward + used.rest * required / runs
        # Runs side by side each hold particles and frames of their own.
        memory = used.extra * required // runs
        measured = "" if runs == required else f"{runs} of {required} runs side by side"
        found.append(_cost(FD_MPM, used, unknowns, seconds=seconds, memory=memory, measured=measured))
    return found
