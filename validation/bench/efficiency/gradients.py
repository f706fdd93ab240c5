"""The paper's column of ten layers cut into 1 to 1,000 blocks of unknown velocity: seconds and error of one gradient.

Other gradients are compared with the MPM's differences averaged over `JITTERS` seeds: along the path of one run the
adjoint has its corners, which the mean over runs has not.
"""

import dataclasses
import time
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from datasets.library import read_scene
from datasets.particles import particle_count
from datasets.scene import Mass, Scene
from gns.simulator import Simulator
from inverse.forward.adjoint import AdjointForward
from inverse.forward.gns import GnsForward
from inverse.forward.interface import Differentiable, Forward
from inverse.forward.mpm import MpmForward
from inverse.jacobian import automatic
from inverse.observations import Values
from inverse.parameters import Vector
from inverse.parameters.parameter import Parameter
from inverse.problem import Problem
from inverse.settings import ObservationSettings, OptimiserSettings, TargetSettings
from inverse.target import read_target
from mpm.simulation import simulate, simulate_many
from validation.bench.efficiency.records import (
    AD,
    ADJOINT,
    ADJOINT_MEAN,
    FD_GNS,
    FD_JITTER,
    FD_MPM,
    JITTERS,
    Gradient,
    Origin,
    OverUnknowns,
)
from validation.bench.efficiency.search import WARM_UP_S

SCENE = "layers-10"
CUTS = ((1, 1), (1, 2), (1, 10), (10, 10), (25, 40))
"""Blocks along x and along y."""
AT_FLOOR, AT_TOP = 1.5, 0.15
"""True velocities [m/s], about the paper's; a block has that of its middle."""
FRACTION = 0.5
"""Of the true velocities: where the gradient is evaluated."""
BOUND = 3.0
"""Of a velocity; no gradient needs it [m/s]."""
STEPS = ((10, 0.15), (100, 0.5), (1_000, 2.0))
"""Up to so many unknowns the step of the differences [m/s]: a smaller part of the sand moves the deposit less."""
HUNDRED, GUESS, LOWER, UPPER = "velocity-blocks-100", 0.75, -1.0, 3.0
"""The problem of a hundred blocks: its name, the start of every unknown and the bounds of `velocity-layers-10`
[m/s]."""
MOST_COLUMNS = 10
"""Unknowns whose differences are run; the seconds of more are multiplied."""
OTHER_SEEDS = tuple(range(20_003, 20_002 + JITTERS))
"""Jitters of the MPM besides the scene's own."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Models:
    """Forward models of one cut, and their targets."""

    gns: Differentiable
    gns_target: Values
    mpm: Sequence[Forward]
    """With the scene's jitter and with others: the difference of two such gradients is their scatter."""
    adjoint: Sequence[Differentiable]
    """With the same jitters."""
    target: Values
    components: int

    @staticmethod
    def build(problem: Problem, simulator: Simulator) -> "Models":
        """GNS and MPM of one cut."""
        made = read_target(problem, simulate)
        observation, target = made.observation, made.values
        gns = GnsForward(simulator, problem, observation)
        seeded = [problem, *(with_seed(problem, seed) for seed in OTHER_SEEDS)]
        return Models(
            gns=gns,
            gns_target=gns.select(target),
            mpm=[MpmForward(each, observation, simulate_many) for each in seeded],
            adjoint=[AdjointForward(each, observation, simulate_many) for each in seeded],
            target=target,
            components=observation.components,
        )


def with_seed(problem: Problem, seed: int) -> Problem:
    """`problem` with another jitter."""
    return dataclasses.replace(problem, scene=dataclasses.replace(problem.scene, seed=seed))


def blocks(columns: int, layers: int) -> Scene:
    """The layers' sand in `columns` times `layers` blocks at their true velocities, cut between its particles.

    However it is cut, its particles are the same: no cut goes through a particle's share of a cell.
    """
    whole = read_scene(SCENE)
    spacing = whole.particle_spacing
    across = round(whole.masses[0].size[0] / spacing)
    up = round(max(mass.lower[1] + mass.size[1] for mass in whole.masses) / spacing)
    x, y = (np.round(np.linspace(0, count, parts + 1)) for count, parts in ((across, columns), (up, layers)))
    masses = []
    for j, i in product(range(layers), range(columns)):
        middle = (y[j] + y[j + 1]) / 2.0 / up
        masses.append(
            Mass(
                lower=(float(x[i] * spacing), float(y[j] * spacing)),
                size=(float((x[i + 1] - x[i]) * spacing), float((y[j + 1] - y[j]) * spacing)),
                velocity=(AT_FLOOR + (AT_TOP - AT_FLOOR) * float(middle), 0.0),
            )
        )
    return dataclasses.replace(whole, masses=tuple(masses))


def blocks_problem(columns: int, layers: int, *, duration: float | None = None) -> Problem:
    """The velocities of the blocks from their deposit; it starts at `FRACTION` of the true ones."""
    scene = blocks(columns, layers)
    scene = scene if duration is None else dataclasses.replace(scene, duration=duration)
    return Problem(
        name=f"blocks-{len(scene.masses)}",
        folder=Path(),
        scene=scene,
        parameters=tuple(
            Parameter(
                name=f"masses[{index}].velocity_x",
                initial=FRACTION * (mass.velocity or (0.0,))[0],
                lower=-BOUND,
                upper=BOUND,
                step=next(step for most, step in STEPS if len(scene.masses) <= most),
            )
            for index, mass in enumerate(scene.masses)
        ),
        observations=(ObservationSettings(kind="deposit"),),
        target=TargetSettings(twin=True),
    )


def hundred_problem() -> Problem:
    """As `velocity-layers-10`, of a hundred blocks."""
    problem = blocks_problem(10, 10)
    unknowns = [
        dataclasses.replace(each, initial=GUESS, lower=LOWER, upper=UPPER, step=None) for each in problem.parameters
    ]
    settings = OptimiserSettings(max_iterations=40)
    return dataclasses.replace(problem, name=HUNDRED, parameters=tuple(unknowns), optimiser=settings)


def sampled(count: int, most: int = MOST_COLUMNS) -> NDArray[np.int64]:
    """Which unknowns' differences are run, ascending: all, or `most` of them.

    A golden-section sequence: among 10 x 10 blocks they are of many columns and many layers.
    """
    if count <= most:
        return np.arange(count)
    golden = (np.sqrt(5.0) - 1.0) / 2.0
    return np.unique((golden * np.arange(1, most + 1) % 1.0 * count).astype(np.int64))


def gradients(problem: Problem, models: Models, *, most: int = MOST_COLUMNS) -> list[Gradient]:
    """One gradient by each method at the problem's start, timed and compared with the MPM's differences."""
    start, unknowns = problem.initial, len(problem.parameters)
    chosen = sampled(unknowns, most)

    def reverse(forward: Differentiable, target: Values) -> tuple[float, Vector]:
        evaluated = automatic(forward, target, components=models.components)(start)
        return evaluated.forward_s + evaluated.backward_s, evaluated.slope[chosen]

    found = {AD: reverse(models.gns, models.gns_target)}
    found[FD_GNS] = differences(models.gns, models.gns_target, problem, chosen, models.components)
    ours = [reverse(each, models.target) for each in models.adjoint]
    found[ADJOINT], found[ADJOINT_MEAN] = ours[0], (sum(s for s, _ in ours), np.mean([g for _, g in ours], axis=0))
    others = [differences(each, models.target, problem, chosen, models.components) for each in models.mpm]
    found[FD_MPM], found[FD_JITTER] = others[:2]
    reference = np.mean([slope for _, slope in others], axis=0)
    norm = float(np.linalg.norm(reference))
    return [
        Gradient(
            method=name,
            unknowns=unknowns,
            seconds=seconds,
            columns=unknowns if name in (AD, ADJOINT, ADJOINT_MEAN) else len(chosen),
            cosine=float(slope @ reference / (np.linalg.norm(slope) * norm)),
            error=float(np.linalg.norm(slope - reference)) / norm,
        )
        for name, (seconds, slope) in found.items()
    ]


def differences(
    forward: Forward, target: Values, problem: Problem, chosen: NDArray[np.int64], components: int
) -> tuple[float, Vector]:
    """Seconds of a whole gradient by central differences, and the loss's slope in the `chosen` unknowns.

    d/du of the loss is 2 sum (y - y*) dy/du over the number of points, as in `inverse.jacobian`.
    """
    start, steps = problem.initial, problem.steps[chosen]
    moves = np.diag(problem.steps)[chosen]
    began = time.perf_counter()
    (observation,) = forward.observe([start])
    middle = time.perf_counter()
    values = np.array(forward.observe([start + move for move in moves] + [start - move for move in moves]))
    end = time.perf_counter()
    columns = (values[: len(chosen)] - values[len(chosen) :]).T / (2.0 * steps)
    slope = 2.0 * components * (observation - target) @ columns / len(target)
    return middle - began + (end - middle) * len(start) / len(chosen), slope


def over_unknowns(
    simulator: Simulator, origin: Origin, *, cuts: Sequence[tuple[int, int]] = CUTS, duration: float | None = None
) -> OverUnknowns:
    """All gradients of all cuts; kernels are compiled on a short flow before."""
    short = blocks_problem(1, 1, duration=WARM_UP_S)
    gradients(short, Models.build(short, simulator))
    found: list[Gradient] = []
    steps: dict[str, float] = {}
    for columns, layers in tqdm(cuts, desc="unknowns", unit="cut", dynamic_ncols=True):
        problem = blocks_problem(columns, layers, duration=duration)
        found += gradients(problem, Models.build(problem, simulator))
        steps[str(len(problem.parameters))] = float(problem.steps[0])
    return OverUnknowns(origin=origin, particles=particle_count(problem.scene), steps=steps, gradients=tuple(found))
