"""Seconds and memory of a gradient as the scene grows: the tall column on the same cells, each case in a process."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import torch
from tqdm import tqdm

from datasets.library import read_scene
from datasets.particles import particle_count
from datasets.processes import processors
from datasets.scene import Domain, Mass, Scene
from gns import checkpoint
from gns.library import shipped
from inverse.forward.adjoint import AdjointForward
from inverse.forward.gns import MEMORY_GIB, GnsForward
from inverse.forward.mpm import MpmForward
from inverse.jacobian import automatic
from inverse.observations import build
from inverse.parameters.parameter import Parameter
from inverse.problem import Problem
from inverse.settings import ObservationSettings
from mpm.simulation import simulate_many
from validation.bench.efficiency.records import (
    AD,
    AD_LONG,
    ADJOINT,
    FD_GNS,
    FD_MPM,
    LONG_STEPS,
    Cost,
    Origin,
    OverParticles,
)
from validation.bench.efficiency.search import WARM_UP_S
from validation.report.measuring import isolated, peak, reset_peak, resident

SCENE = "column-tall-42"
STEP_DEG = 0.5
"""Between the angles of the runs of a difference; their cost does not depend on it."""
UNKNOWNS = (1, 10)
ADJOINT_MIB = 6144.0
"""Most that the adjoint may take beside the arrays of the run; it takes what its checkpoints require."""


class Work(StrEnum):
    """What a process runs."""

    AD = "AD"
    """Forward and backward through the GNS."""
    LONG = "AD, many steps"
    """The same through `LONG_STEPS` steps, none of whose activations are kept."""
    GNS = "GNS"
    """One rollout, as differences of the GNS run one after the other."""
    ADJOINT = "adjoint"
    """A run of the MPM with checkpoints, its replay and its reverse."""
    MPM = "MPM"
    """One run, then runs side by side, as differences of the MPM."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """What a process of its own runs."""

    work: Work
    scale: float
    """Length and height of the column over the paper's."""
    scene: str = SCENE
    """Of which the column; another one is as it ships."""
    runs: int = 2
    """Of the MPM side by side after the one alone, two for each unknown."""


@dataclass(frozen=True, kw_only=True)
class Usage:
    """Time and memory of a task."""

    dimension: int
    particles: int
    """Of the scene."""
    nodes: int
    """Of the graph; the particles where the MPM runs."""
    forward: float
    """[s]."""
    rest: float
    """The backward pass, or the runs side by side [s]."""
    extra: int
    """Peak above what was held before [bytes]."""


@dataclass(frozen=True, kw_only=True)
class Size:
    """A column and how many of the MPM's runs are made; the rest is multiplied."""

    scale: float
    scene: str = SCENE
    most_runs: int = 2 * UNKNOWNS[-1]
    """Most runs of the MPM side by side."""
    long: bool = True
    """Whether the gradient through `LONG_STEPS` is run too."""

    def task(self, work: Work, runs: int = 2) -> Task:
        """Of this size."""
        return Task(work=work, scale=self.scale, scene=self.scene, runs=runs)


SOLID = "baffles-2"
"""A scene in 3D."""
SIZES = (
    Size(scale=1.0),
    Size(scale=2.0),
    Size(scale=5.0, most_runs=2),
    Size(scale=1.0, scene=SOLID, most_runs=2, long=False),
)
"""3,200, 12,800 and 80,000 particles in 2D, 11,115 in 3D."""
QUICK = (Size(scale=1.0, most_runs=2, long=False),)
Run = Callable[[Task], Usage]


def column(scale: float, name: str = SCENE) -> Scene:
    """The tall column and its box, `scale` times as long and as high, on the same cells; another scene as it ships."""
    scene = read_scene(name)
    if name != SCENE:
        return scene
    (mass,) = scene.masses

    def scaled(lengths: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(round(length * scale, 9) for length in lengths)

    return dataclasses.replace(
        scene,
        domain=Domain(size=scaled(scene.domain.size), cell=scene.domain.cell),
        masses=(Mass(lower=mass.lower, size=scaled(mass.size)),),
    )


def friction_problem(scene: Scene) -> Problem:
    """The angle of friction from the front."""
    return Problem(
        name="column",
        folder=Path(),
        scene=scene,
        parameters=(Parameter(name="friction_deg", initial=30.0, lower=12.0, upper=52.0),),
        observations=(ObservationSettings(kind="front", value=0.5),),
    )


def usage(task: Task, model: Path | None = None) -> Usage:
    """Run a task in this process; kernels are compiled on a short flow before."""
    torch.set_num_threads(processors())
    scene = column(task.scale, task.scene)
    problem = friction_problem(scene)
    short = friction_problem(dataclasses.replace(column(1.0, task.scene), duration=WARM_UP_S))
    observation = build(problem.observations[0], scene)
    start, particles = problem.initial, particle_count(scene)
    if task.work is Work.MPM:
        mpm = MpmForward(problem, observation, simulate_many)
        MpmForward(short, observation, simulate_many).observe([start])
        nodes = particles
        reset_peak()
        before, began = resident() or peak(), time.perf_counter()
        mpm.observe([start])
        middle = time.perf_counter()
        mpm.observe([start + STEP_DEG * (number + 1) / task.runs for number in range(task.runs)])
        forward, rest = middle - began, time.perf_counter() - middle
    elif task.work is Work.ADJOINT:
        target, nodes = start * 0.0, particles
        automatic(AdjointForward(short, observation, simulate_many), target)(start)
        adjoint = AdjointForward(problem, observation, simulate_many, memory_mib=ADJOINT_MIB)
        reset_peak()
        before = resident() or peak()
        evaluated = automatic(adjoint, target)(start)
        forward, rest = evaluated.forward_s, evaluated.backward_s
    else:
        simulator = checkpoint.load(model or shipped(scene.dimension)).simulator.requires_grad_(False)
        # A model scales every scene to the body of its training data; as it is, a larger one has more nodes.
        simulator.settings = dataclasses.replace(simulator.settings, body_length=None)
        if task.work is Work.LONG:
            long = dataclasses.replace(scene, duration=LONG_STEPS * simulator.settings.step)
            problem = dataclasses.replace(problem, scene=long)
        target = start * 0.0
        automatic(GnsForward(simulator, short, observation), target)(start)
        kept_gib = 0.0 if task.work is Work.LONG else MEMORY_GIB
        gns = GnsForward(simulator, problem, observation, kept_gib)
        nodes = len(gns.indices)
        reset_peak()
        before, began = resident() or peak(), time.perf_counter()
        if task.work in (Work.AD, Work.LONG):
            evaluated = automatic(gns, target)(start)
            forward, rest = evaluated.forward_s, evaluated.backward_s
        else:
            gns.observe([start])
            forward, rest = time.perf_counter() - began, 0.0
    extra = max(0, peak() - before)
    return Usage(dimension=scene.dimension, particles=particles, nodes=nodes, forward=forward, rest=rest, extra=extra)


def in_process(task: Task) -> Usage:
    """A task in a process of its own. Raises WorkFailed."""
    return isolated(usage, task)


def over_particles(
    origin: Origin,
    *,
    sizes: Sequence[Size] = SIZES,
    run: Run = in_process,
    kept: Sequence[Cost] = (),
    keep: Callable[[OverParticles], None] = lambda _: None,
) -> OverParticles:
    """Every gradient in every size, one after the other.

    kept: costs that need not be measured again; keep: is called after each case with all that there are.
    """
    found = OverParticles(origin=origin, costs=tuple(kept))
    with tqdm(total=len(sizes) * len(CASES), desc="particles", unit="case", dynamic_ncols=True) as progress:
        for size in sizes:
            scene = column(size.scale, size.scene)
            for method, costs in CASES.items():
                progress.set_postfix_str(f"{method}, {size.scene}, scale {size.scale:g}")
                same = (method, scene.dimension, particle_count(scene))
                if same not in [(each.method, each.dimension, each.particles) for each in found.costs]:
                    found = dataclasses.replace(found, costs=(*found.costs, *costs(run, size)))
                    keep(found)
                progress.update()
    order = [(scene.dimension, particle_count(scene)) for scene in (column(each.scale, each.scene) for each in sizes)]
    return dataclasses.replace(
        found,
        costs=tuple(
            sorted(
                (each for each in found.costs if (each.dimension, each.particles) in order),
                key=lambda each: (order.index((each.dimension, each.particles)), [*CASES].index(each.method)),
            )
        ),
    )


def _cost(method: str, used: Usage, unknowns: int, *, seconds: float, memory: int, measured: str) -> Cost:
    return Cost(
        method=method,
        dimension=used.dimension,
        particles=used.particles,
        nodes=used.nodes,
        unknowns=unknowns,
        seconds=seconds,
        memory=memory,
        measured=measured,
    )


def _by_ad(run: Run, size: Size) -> list[Cost]:
    """Forward and backward, once, whatever the number of unknowns."""
    used = run(size.task(Work.AD))
    seconds = used.forward + used.rest
    return [_cost(AD, used, each, seconds=seconds, memory=used.extra, measured="") for each in UNKNOWNS]


def _by_adjoint(run: Run, size: Size) -> list[Cost]:
    """Forwards and backwards, once, whatever the number of unknowns."""
    used = run(size.task(Work.ADJOINT))
    seconds = used.forward + used.rest
    return [_cost(ADJOINT, used, each, seconds=seconds, memory=used.extra, measured="") for each in UNKNOWNS]


def _by_long_ad(run: Run, size: Size) -> list[Cost]:
    """The same through many steps, where that is asked for."""
    if not size.long:
        return []
    used = run(size.task(Work.LONG))
    return [_cost(AD_LONG, used, 1, seconds=used.forward + used.rest, memory=used.extra, measured="")]


def _by_gns(run: Run, size: Size) -> list[Cost]:
    """Rollouts one after the other: one, and two more for each unknown."""
    used = run(size.task(Work.GNS))
    return [
        _cost(FD_GNS, used, each, seconds=(1 + 2 * each) * used.forward, memory=used.extra, measured="one rollout")
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
            known[runs] = run(size.task(Work.MPM, runs=runs))
        used = known[runs]
        seconds = used.forward + used.rest * required / runs
        # Runs side by side each hold particles and frames of their own.
        memory = used.extra * required // runs
        measured = "" if runs == required else f"{runs} of {required} runs side by side"
        found.append(_cost(FD_MPM, used, unknowns, seconds=seconds, memory=memory, measured=measured))
    return found


CASES: dict[str, Callable[[Run, Size], list[Cost]]] = {
    AD: _by_ad,
    AD_LONG: _by_long_ad,
    FD_GNS: _by_gns,
    ADJOINT: _by_adjoint,
    FD_MPM: _by_mpm,
}
"""The costs of a method in a size."""
