"""Flows by a formula in place of the MPM: what loops are tested on."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets import Mass, Material, Scene, Trajectory
from datasets.flow.measures import front
from datasets.scene.particles import particle_count
from inverse import Parameter, Problem, Result, TargetSettings
from inverse.observations import KINDS, DepositSettings, Observation, Values
from inverse.observations.target import Target
from inverse.parameters import Vector
from inverse.settings import Surrogate
from inverse.target import read_target
from mpm import ALL, Recording
from tests.scenes import flow_of, scene_of
from validation.loop import surrogate
from validation.loop.solve import run
from validation.loop.task import Task

PARTICLES = 600
# Quantiles of a wedge: the deposit thins out towards its front.
SHAPE = 1.0 - np.sqrt(1.0 - (np.arange(PARTICLES) + 0.5) / PARTICLES)
FRONT = front(SHAPE[:, None])
WIDTH = 4.0  # of the bounds of each velocity [m/s]


def length(friction_deg: Any) -> Any:
    """Length of the deposit [m]: 15 mm a degree at 15 degrees, 5 mm at 45."""
    return 1.0 - 0.02 * (friction_deg - 12.0) + 0.5 * 0.0003 * (friction_deg - 12.0) ** 2


def scatter_of(seed: int, angle: float) -> float:
    """That of `FakeMpm` at a friction angle [deg] by the jitter seed, in standard deviations."""
    return float(np.random.default_rng([seed, round(angle * 1e6)]).normal())


def at_rest(x: NDArray[np.float64], scene: Scene) -> Trajectory:
    """A flow of `scene` whose particles are at `x` [m], shape [N], all the time."""
    positions, time = [np.stack([x, 0.1 * np.ones(len(x))], axis=1)] * 2, np.array([0.0, scene.duration])
    return flow_of(scene, positions, time=time, summary={"remarks": ["the sand still moves"]})


@dataclass
class FakeMpm:
    """Deposits by the formula, with a scatter that depends on the jitter seed."""

    scatter: float = 0.0  # [m]
    uneven: float = 1.0  # the scatter above 30 degrees over that below
    shortened: float = 0.0  # by what share of its length per metre of a cell, a deposit is shorter [1/m]
    killed_after: int = 10**6
    scenes: list[Scene] = field(default_factory=list)  # all that was simulated

    def __call__(self, scenes: Sequence[Scene], /, *, record: Recording = ALL) -> list[Trajectory]:
        flows = []
        for scene in scenes:
            flow = self.run(scene)
            frames = record.kept(len(flow.time))
            flows.append(replace(flow, positions=flow.positions[frames], time=flow.time[frames]))
        return flows

    def run(self, scene: Scene) -> Trajectory:
        if len(self.scenes) >= self.killed_after:
            raise KeyboardInterrupt
        self.scenes.append(scene)
        return at_rest(self.x(scene), scene)

    def x(self, scene: Scene) -> NDArray[np.float64]:
        angle, share = scene.material.friction_deg, 1.0 - self.shortened * scene.domain.cell
        scatter = self.scatter * (self.uneven if angle > 30.0 else 1.0)
        return np.asarray((length(angle) + scatter_of(scene.seed, angle) * scatter) * share * SHAPE)


class Folded(FakeMpm):
    """Deposits as long at two angles, on either side of 30 degrees, but thinner in the middle at one of them."""

    def x(self, scene: Scene) -> NDArray[np.float64]:
        off = (scene.material.friction_deg - 30.0) / 20.0
        scatter = np.random.default_rng(scene.seed).normal() * self.scatter
        return np.asarray((1.0 - 0.5 * off**2 + scatter) * SHAPE ** (1.0 + 0.2 * off))


class TwinAngles(FakeMpm):
    """Deposits that depend on the sum of two angles alone."""

    def x(self, scene: Scene) -> NDArray[np.float64]:
        angles = [scene.material_of(mass).friction_deg for mass in scene.masses]
        scatter = np.random.default_rng([scene.seed, round(1e6 * sum(angles))]).normal() * self.scatter
        return np.asarray((length(0.5 * sum(angles)) + scatter) * SHAPE)


@dataclass
class Layers(FakeMpm):
    """Particles moved along x by each layer's velocity and by its neighbours'."""

    count: int = 2  # layers
    particles: int = 600
    bend: float = 0.0  # [m s^2/m^2]

    def __post_init__(self) -> None:
        index = (np.arange(self.particles) + 0.5) / self.particles
        centres = (np.arange(self.count) + 0.5) / self.count
        self.x0 = 0.3 + 0.3 * np.sqrt(index)
        # Broad bumps that overlap: the effects of neighbours are similar.
        self.push = 0.05 * np.exp(-(((index[:, None] - centres) * self.count / 1.5) ** 2))
        self.waves = np.random.default_rng(5).normal(size=(12, self.particles)) / np.sqrt(12.0)

    def moved(self, velocities: Vector) -> NDArray[np.float64]:
        return np.asarray(self.x0 + self.push @ velocities + self.bend * self.push @ velocities**2)

    def x(self, scene: Scene) -> NDArray[np.float64]:
        velocities = np.array([mass.velocity[0] if mass.velocity else 0.0 for mass in scene.masses])
        waves = np.random.default_rng(scene.seed).normal(size=12) @ self.waves
        return np.asarray(self.moved(velocities) + self.scatter * waves)


@dataclass(frozen=True)
class Formula:
    """A surrogate by a formula: as long as `FakeMpm`'s deposits, or `factor` times as long."""

    observation: Observation
    factor: float = 1.0
    band: float = 0.05  # of its length, of 95 of 100 deposits

    def x(self, angle: Tensor) -> Tensor:
        """Of the particles [m], shape [N]."""
        places: Tensor = length(angle) * torch.from_numpy(SHAPE)
        return places

    def predict(self, parameters: Tensor, /) -> Tensor:
        """Shape [S, m]."""
        return torch.stack([self.observed(self.factor * self.x(point[0])) for point in parameters])

    def observe(self, parameters: Sequence[Vector], /) -> list[Values]:
        """Shape [m] each."""
        return list(self.predict(torch.from_numpy(np.stack(parameters))).numpy())

    def observed(self, x: Tensor) -> Tensor:
        """Smoothly, shape [m]."""
        return self.observation.smooth(torch.stack([x, 0.1 * torch.ones_like(x)], dim=1), torch.ones(len(x)))

    def select(self, target: Values, /) -> Values:
        """All of it."""
        return target

    def errors(self, parameters: Vector, /) -> NDArray[np.float64]:
        """The change by a stretch of its deposit, shape [1, m]."""
        x = self.factor * self.x(torch.from_numpy(parameters)[0])
        return (self.observed((1.0 + self.band / 1.96) * x) - self.observed(x)).numpy()[None]


class FoldedFormula(Formula):
    """As `Folded`."""

    def x(self, angle: Tensor) -> Tensor:
        off = (angle - 30.0) / 20.0
        return (1.0 - 0.5 * off**2) * torch.from_numpy(SHAPE) ** (1.0 + 0.2 * off)


@dataclass(frozen=True)
class LayersFormula(Formula):
    """As `Layers`, displacements `factor` times as large."""

    mpm: Layers = field(default_factory=Layers)

    def predict(self, parameters: Tensor, /) -> Tensor:
        x0, push = torch.from_numpy(self.mpm.x0), torch.from_numpy(self.mpm.push)
        moves = parameters + self.mpm.bend * parameters**2
        return torch.stack([self.observed(x0 + self.factor * push @ move) for move in moves])

    def errors(self, parameters: Vector, /) -> NDArray[np.float64]:
        """The change by larger displacements, and of each particle by itself, shape [1 + m, m]."""
        (predicted,) = self.predict(torch.from_numpy(parameters)[None]).numpy()
        (rest,) = self.predict(torch.zeros(1, len(parameters), dtype=torch.float64)).numpy()
        alone = 0.5 * self.band / 1.96 * np.ptp(predicted) * len(predicted) ** 0.25
        return np.concatenate([self.band / 1.96 * (predicted - rest)[None], alone * np.eye(len(predicted))])


@dataclass(frozen=True, kw_only=True)
class Case:
    """A problem with all that it takes to solve it."""

    problem: Problem
    target: Target
    mpm: FakeMpm
    surrogate: Any = None

    def task(self, out: Path) -> Task:
        return Task(problem=self.problem, target=self.target, folder=out / "mpm", simulate=self.mpm)

    def led(self, surrogate: Formula) -> "Case":
        """The same where this surrogate is asked."""
        asked = replace(self.problem, surrogate=Surrogate.GNS)
        return replace(self, problem=asked, surrogate=surrogate)

    def solve(self, out: Path) -> Result:
        learned = self.surrogate, "it was not trained on it"
        with mock.patch.object(surrogate, "learned", return_value=learned):
            return run(self.task(out))


def wedge(
    folder: Path,
    *,
    truth: float = 24.0,
    kind: str = "front",
    mpm: FakeMpm | None = None,
    scatter: float = 0.0,
    seed: int = 7,
    **measured: Any,
) -> Case:
    """The friction angle of a wedge, by `mpm` or one with `scatter` [m]; measured: of the observation."""
    body, sand = Mass(lower=(0.0, 0.0), size=(0.3, 0.2)), Material(friction_deg=33.3)
    scene = scene_of(body, size=(1.2, 0.4), cell=0.01, material=sand)
    twin = TargetSettings(twin=True, seed=seed, truth={"friction_deg": truth})
    stated = {"value", "csv"} & measured.keys()
    problem = Problem(
        name="wedge",
        folder=folder,
        scene=scene,
        parameters=(Parameter(name="friction_deg", initial=30.0, lower=12.0, upper=52.0),),
        observations=(KINDS[kind](**measured),),
        target=TargetSettings() if stated else twin,
    )
    mpm = mpm or FakeMpm(scatter=scatter)
    read = read_target(problem, mpm.run)
    mpm.scenes.clear()
    return Case(problem=problem, target=read, mpm=mpm)


def layers(folder: Path, *, count: int = 2, scatter: float = 0.0, bend: float = 0.0, seed: int = 3) -> Case:
    """The velocities of layers, from 1.5 m/s at the lowest to 0.15 at the highest."""
    masses = tuple(Mass(lower=(0.0, 0.2 * row), size=(0.5, 0.2), velocity=(9.0, 0.0)) for row in range(count))
    scene = scene_of(*masses, size=(2.0, 4.0), cell=0.05)
    names = [f"masses[{row}].velocity_x" for row in range(count)]
    truth = dict(zip(names, np.linspace(1.5, 0.15, count).tolist(), strict=True))
    problem = Problem(
        name="layers",
        folder=folder,
        scene=scene,
        parameters=tuple(Parameter(name=name, initial=0.0, lower=-1.0, upper=WIDTH - 1.0) for name in names),
        observations=(DepositSettings(),),
        target=TargetSettings(twin=True, seed=seed, truth=truth),
    )
    mpm = Layers(count=count, particles=particle_count(scene), scatter=scatter, bend=bend)
    read = read_target(problem, mpm.run)
    mpm.scenes.clear()
    return Case(problem=problem, target=read, mpm=mpm)
