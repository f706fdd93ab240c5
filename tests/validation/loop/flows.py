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
SHAPE = 1.0 - torch.sqrt(1.0 - (torch.arange(PARTICLES).double() + 0.5) / PARTICLES)
FRONT = front(SHAPE.numpy()[:, None])
WIDTH = 4.0  # of the bounds of each velocity [m/s]


def length(friction_deg: Any) -> Any:
    """Length of the deposit [m]: 15 mm a degree at 15 degrees, 5 mm at 45."""
    return 1.0 - 0.02 * (friction_deg - 12.0) + 0.5 * 0.0003 * (friction_deg - 12.0) ** 2


@dataclass
class FakeMpm:
    """Deposits by the formula of the masses' mean angle, with a scatter that depends on the jitter seed."""

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
        x, time = self.x(scene), np.array([0.0, scene.duration])
        positions = [np.stack([x, 0.1 * np.ones(len(x))], axis=1)] * 2
        return flow_of(scene, positions, time=time, summary={"remarks": ["the sand still moves"]})

    def x(self, scene: Scene) -> NDArray[np.float64]:
        angle = float(np.mean([scene.material_of(mass).friction_deg for mass in scene.masses]))
        scatter = self.scatter * (self.uneven if angle > 30.0 else 1.0)
        scatter *= np.random.default_rng([scene.seed, round(angle * 1e6)]).normal()
        shape, share = self.shape(angle).numpy(), 1.0 - self.shortened * scene.domain.cell
        return np.asarray((self.length(angle) + scatter) * share * shape)

    def length(self, angle: Any) -> Any:
        return length(angle)

    def shape(self, angle: Any) -> Tensor:
        """Of a deposit of unit length, shape [N]."""
        return SHAPE


class Folded(FakeMpm):
    """Deposits as long at two angles, on either side of 30 degrees, but thinner in the middle at one of them."""

    def length(self, angle: Any) -> Any:
        return 1.0 - 0.5 * ((angle - 30.0) / 20.0) ** 2

    def shape(self, angle: Any) -> Tensor:
        return SHAPE ** (1.0 + 0.2 * (angle - 30.0) / 20.0)


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

    def x(self, scene: Scene) -> NDArray[np.float64]:
        velocities = np.array([mass.velocity[0] if mass.velocity else 0.0 for mass in scene.masses])
        waves = np.random.default_rng(scene.seed).normal(size=12) @ self.waves
        return np.asarray(self.x0 + self.push @ (velocities + self.bend * velocities**2) + self.scatter * waves)


@dataclass(frozen=True)
class Formula:
    """A surrogate by a formula: deposits `factor` times as long as the MPM's."""

    observation: Observation
    mpm: Any
    factor: float = 1.0
    band: float = 0.05  # of its length, of 95 of 100 deposits

    def x(self, angle: Tensor) -> Tensor:
        """Of the particles [m], shape [N]."""
        return self.factor * self.mpm.length(angle) * self.mpm.shape(angle)

    def predict(self, parameters: Tensor, /) -> Tensor:
        """Shape [S, m]."""
        return torch.stack([self.observed(self.x(point[0])) for point in parameters])

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
        x = self.x(torch.from_numpy(parameters)[0])
        return (self.observed((1.0 + self.band / 1.96) * x) - self.observed(x)).numpy()[None]


class LayersFormula(Formula):
    """As `Layers`, displacements `factor` times as large."""

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

    @classmethod
    def of(cls, problem: Problem, mpm: FakeMpm) -> "Case":
        """The problem with the target that `mpm` makes, before any other run of it."""
        target = read_target(problem, mpm.run)
        mpm.scenes.clear()
        return cls(problem=problem, target=target, mpm=mpm)

    def task(self, out: Path) -> Task:
        return Task(problem=self.problem, target=self.target, folder=out / "mpm", simulate=self.mpm)

    def led(self, factor: float, **band: float) -> "Case":
        """The same where a surrogate of this factor is asked."""
        formula = LayersFormula if isinstance(self.mpm, Layers) else Formula
        asked = formula(self.target.observation, self.mpm, factor, **band)
        return replace(self, problem=replace(self.problem, surrogate=Surrogate.GNS), surrogate=asked)

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
        surrogate=Surrogate.NONE,
    )
    return Case.of(problem, mpm or FakeMpm(scatter=scatter))


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
    return Case.of(problem, Layers(count=count, particles=particle_count(scene), scatter=scatter, bend=bend))
