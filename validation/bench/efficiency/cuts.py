"""The paper's heap cut into 1, 2, 10 and 100 blocks of their own velocity: seconds and worth of one gradient."""

import dataclasses
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from datasets.library import read_scene
from datasets.particles import particle_count
from datasets.scene import Mass, Scene
from gns.model.simulator import Simulator
from inverse.finite_difference import jacobian
from inverse.forward.gns import GnsSource
from inverse.forward.interface import Differentiable, Forward
from inverse.forward.mpm import MpmForward
from inverse.gradient import automatic
from inverse.observations import deposit as observations
from inverse.observations.deposit import Values
from inverse.observations.target import read_target
from inverse.parameters.parameters import Vector
from inverse.problem import Observable, ObservationSettings, Problem, TargetSettings, Unknown
from mpm import simulate, simulate_many
from validation.bench.efficiency.race import WARM_S
from validation.bench.efficiency.rows import Gradient

SCENE = "layers-10"
CUTS = ((1, 1), (1, 2), (1, 10), (10, 10))
"""Blocks along x and along y."""
AT_FLOOR, AT_TOP = 1.5, 0.15
"""True velocities [m/s], about the paper's; a block has that of its middle."""
SHARE = 0.5
"""Of the true velocities: where the gradient is taken."""
REACH = 3.0
"""Bounds of a velocity, which no gradient asks for [m/s]."""
LAYER_STEP, BLOCK_STEP = 0.15, 0.5
"""Step of the differences [m/s]; that of a hundredth of the heap, which moves the deposit less, is longer."""
MOST_COLUMNS = 10
"""Unknowns whose differences are run; the seconds of more are multiplied."""
OTHER_SEED = 20_003
AD, FD_GNS, FD_MPM, AGAIN = "AD, GNS", "differences, GNS", "differences, our MPM", "the same, another jitter"


@dataclass(frozen=True, kw_only=True)
class Models:
    """What the gradients of one cut are taken of."""

    gns: Differentiable
    gns_target: Values
    mpm: Forward
    again: Forward
    """The MPM with another jitter: as far as two such gradients differ, no gradient is known any better."""
    target: Values
    components: int


def heap(columns: int, layers: int) -> Scene:
    """The heap in `columns` times `layers` blocks at their true velocities, cut between its points.

    However it is cut, it is of the same points: no cut goes through a point's share of a cell.
    """
    whole = read_scene(SCENE)
    share = whole.particle_spacing
    across = round(whole.masses[0].size[0] / share)
    up = round(max(mass.lower[1] + mass.size[1] for mass in whole.masses) / share)
    x, y = (np.round(np.linspace(0, count, parts + 1)) for count, parts in ((across, columns), (up, layers)))
    masses = []
    for j, i in product(range(layers), range(columns)):
        middle = (y[j] + y[j + 1]) / 2.0 / up
        masses.append(
            Mass(
                lower=(float(x[i] * share), float(y[j] * share)),
                size=(float((x[i + 1] - x[i]) * share), float((y[j + 1] - y[j]) * share)),
                velocity=(AT_FLOOR + (AT_TOP - AT_FLOOR) * float(middle), 0.0),
            )
        )
    return dataclasses.replace(whole, masses=tuple(masses))


def problem(columns: int, layers: int, *, duration: float | None = None) -> Problem:
    """Which velocities did the blocks have? The gradient is taken at half of the true ones."""
    scene = heap(columns, layers)
    scene = scene if duration is None else dataclasses.replace(scene, duration=duration)
    step = BLOCK_STEP if columns > 1 else LAYER_STEP
    return Problem(
        name=f"heap-{len(scene.masses)}",
        folder=Path(),
        scene=scene,
        unknowns=tuple(
            Unknown(
                name=f"masses[{index}].velocity_x",
                initial=SHARE * (mass.velocity or (0.0,))[0],
                lower=-REACH,
                upper=REACH,
                step=step,
            )
            for index, mass in enumerate(scene.masses)
        ),
        observation=ObservationSettings(kind=Observable.DEPOSIT),
        target=TargetSettings(hidden=True),
    )


def models(asked: Problem, simulator: Simulator) -> Models:
    """GNS and MPM of one cut."""
    observation = observations.build(asked.observation, asked.scene)
    target = read_target(asked, observation, simulate).values
    gns = GnsSource(simulator, asked, observation).start(None)
    other = dataclasses.replace(asked, scene=dataclasses.replace(asked.scene, seed=OTHER_SEED))
    return Models(
        gns=gns,
        gns_target=gns.wanted(target),
        mpm=MpmForward(asked, observation, simulate_many),
        again=MpmForward(other, observation, simulate_many),
        target=target,
        components=observation.components,
    )


def spread(count: int, most: int = MOST_COLUMNS) -> NDArray[np.int64]:
    """Which unknowns' differences are run, ascending: all, or `most` of them from the first to the last.

    The places of a golden-section sequence: in a heap of 10 x 10 they are of many columns and many layers.
    """
    if count <= most:
        return np.arange(count)
    golden = (np.sqrt(5.0) - 1.0) / 2.0
    return np.unique((golden * np.arange(1, most + 1) % 1.0 * count).astype(np.int64))


def gradients(asked: Problem, of: Models, *, most: int = MOST_COLUMNS) -> list[Gradient]:
    """One gradient by each method at the problem's start, timed, and held against the MPM's differences."""
    start, unknowns = asked.initial, len(asked.unknowns)
    places = spread(unknowns, most)
    evaluated = automatic(of.gns, of.gns_target, components=of.components)(start)
    found = [(AD, evaluated.forward_s + evaluated.backward_s, evaluated.slope[places], unknowns)]
    for name, forward, target in (
        (FD_GNS, of.gns, of.gns_target),
        (FD_MPM, of.mpm, of.target),
        (AGAIN, of.again, of.target),
    ):
        seconds, slope = differences(forward, target, asked, places, of.components)
        found.append((name, seconds, slope, len(places)))
    reference = next(slope for name, _, slope, _ in found if name == FD_MPM)
    return [
        Gradient(
            method=name,
            unknowns=unknowns,
            seconds=seconds,
            columns=columns,
            cosine=None if name == FD_MPM else cosine(slope, reference),
            error=None if name == FD_MPM else float(np.linalg.norm(slope - reference) / np.linalg.norm(reference)),
        )
        for name, seconds, slope, columns in found
    ]


def differences(
    forward: Forward, target: Values, asked: Problem, places: NDArray[np.int64], components: int
) -> tuple[float, Vector]:
    """Seconds of a whole gradient by central differences, and the loss's slope in the unknowns at `places`."""
    start = asked.initial
    began = time.perf_counter()
    (observation,) = forward.observe([start])
    middle = time.perf_counter()
    columns = jacobian(Some(inner=forward, start=start, places=places), start[places], asked.steps[places])
    end = time.perf_counter()
    slope = 2.0 * components * (observation - target) @ columns / len(target)
    return middle - began + (end - middle) * len(start) / len(places), slope


@dataclass(frozen=True, kw_only=True)
class Some:
    """A forward of some of its unknowns; the others stay at `start`."""

    inner: Forward
    start: Vector
    places: NDArray[np.int64]

    def observe(self, unknowns: Sequence[Vector]) -> list[Values]:
        """The observation [M] for each vector of those unknowns."""
        whole = [self.start.copy() for _ in unknowns]
        for each, values in zip(whole, unknowns, strict=True):
            each[self.places] = values
        return self.inner.observe(whole)


def cosine(a: Vector, b: Vector) -> float:
    """Of the angle between two vectors."""
    return float(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)))


def over_unknowns(
    simulator: Simulator, *, cuts: Sequence[tuple[int, int]] = CUTS, duration: float | None = None
) -> tuple[int, dict[str, float], tuple[Gradient, ...]]:
    """Points of the heap, step of the differences by number of unknowns [m/s], and all gradients."""
    found: list[Gradient] = []
    steps: dict[str, float] = {}
    # What is compiled at a first call is no part of a gradient.
    short = problem(1, 1, duration=WARM_S)
    warm = models(short, simulator)
    gradients(short, warm)
    with tqdm(list(cuts), desc="unknowns", unit="cut", dynamic_ncols=True) as bar:
        for columns, layers in bar:
            asked = problem(columns, layers, duration=duration)
            bar.set_postfix_str(f"{len(asked.unknowns)} unknowns")
            found += gradients(asked, models(asked, simulator))
            steps[str(len(asked.unknowns))] = float(asked.steps[0])
    return particle_count(asked.scene), steps, tuple(found)
