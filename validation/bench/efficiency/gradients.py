"""The paper's column of ten layers cut into 1 to 100 blocks of unknown velocity: seconds and error of one gradient."""

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
from gns.model.simulator import Simulator
from inverse.forward.gns import GnsSource
from inverse.forward.interface import Differentiable, Forward
from inverse.forward.mpm import MpmForward
from inverse.jacobian import automatic
from inverse.observations import Values
from inverse.observations.reading import read_target
from inverse.parameters import Vector
from inverse.problem import Problem
from inverse.settings import ObservationSettings, Parameter, TargetSettings
from mpm.simulation import simulate, simulate_many
from validation.bench.efficiency.records import AD, FD_GNS, FD_JITTER, FD_MPM, Gradient, Origin, OverUnknowns
from validation.bench.efficiency.search import WARM_UP_S

SCENE = "layers-10"
CUTS = ((1, 1), (1, 2), (1, 10), (10, 10))
"""Blocks along x and along y."""
AT_FLOOR, AT_TOP = 1.5, 0.15
"""True velocities [m/s], about the paper's; a block has that of its middle."""
FRACTION = 0.5
"""Of the true velocities: where the gradient is evaluated."""
BOUND = 3.0
"""Of a velocity; no gradient needs it [m/s]."""
LAYER_STEP, BLOCK_STEP = 0.15, 0.5
"""Step of the differences [m/s]; a hundredth of the sand moves the deposit less, so that its step is longer."""
MOST_COLUMNS = 10
"""Unknowns whose differences are run; the seconds of more are multiplied."""
OTHER_SEED = 20_003


@dataclasses.dataclass(frozen=True, kw_only=True)
class Models:
    """Forward models of one cut, and their targets."""

    gns: Differentiable
    gns_target: Values
    mpm: Forward
    other_jitter: Forward
    """The MPM with another jitter: the difference of two such gradients is their scatter."""
    target: Values
    components: int

    @staticmethod
    def build(problem: Problem, simulator: Simulator) -> "Models":
        """GNS and MPM of one cut."""
        made = read_target(problem, simulate)
        observation, target = made.observation, made.values
        gns = GnsSource(simulator, problem, observation).start(None)
        other = dataclasses.replace(problem, scene=dataclasses.replace(problem.scene, seed=OTHER_SEED))
        return Models(
            gns=gns,
            gns_target=gns.select(target),
            mpm=MpmForward(problem, observation, simulate_many),
            other_jitter=MpmForward(other, observation, simulate_many),
            target=target,
            components=observation.components,
        )


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
                step=BLOCK_STEP if columns > 1 else LAYER_STEP,
            )
            for index, mass in enumerate(scene.masses)
        ),
        observation=ObservationSettings(kind="deposit"),
        target=TargetSettings(twin=True),
    )


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
    evaluated = automatic(models.gns, models.gns_target, components=models.components)(start)
    found = {AD: (evaluated.forward_s + evaluated.backward_s, evaluated.slope[chosen])}
    for name, forward, target in (
        (FD_GNS, models.gns, models.gns_target),
        (FD_MPM, models.mpm, models.target),
        (FD_JITTER, models.other_jitter, models.target),
    ):
        found[name] = differences(forward, target, problem, chosen, models.components)
    reference = found[FD_MPM][1]
    norm = float(np.linalg.norm(reference))
    return [
        Gradient(
            method=name,
            unknowns=unknowns,
            seconds=seconds,
            columns=unknowns if name == AD else len(chosen),
            cosine=None if name == FD_MPM else float(slope @ reference / (np.linalg.norm(slope) * norm)),
            error=None if name == FD_MPM else float(np.linalg.norm(slope - reference)) / norm,
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
