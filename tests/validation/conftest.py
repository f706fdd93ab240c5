"""A flow with a formula: a deposit whose length falls with the angle of friction, and a surrogate that has it wrong."""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets.material import Material
from datasets.scene import Domain, Mass, Scene
from datasets.trajectory import Trajectory
from inverse.observations import deposit as observations
from inverse.observations.deposit import Observation, Values
from inverse.observations.target import Target, read_target
from inverse.parameters.parameters import Vector
from inverse.problem import LoopSettings, Observable, ObservationSettings, Problem, TargetSettings, Unknown
from mpm.output.request import ALL, Recording

POINTS = 600
# Quantiles of a wedge: the deposit thins out towards its front.
SHAPE = 1.0 - np.sqrt(1.0 - (np.arange(POINTS) + 0.5) / POINTS)


def length(friction_deg: float) -> float:
    """Length of the deposit [m]: 15 mm a degree at 15 degrees, 5 mm at 45."""
    return 1.0 - 0.02 * (friction_deg - 12.0) + 0.5 * 0.0003 * (friction_deg - 12.0) ** 2


def at_rest(x: NDArray[np.float64], scene: Scene) -> Trajectory:
    """A flow of `scene` whose points lie at `x` [m], shape [N], all the time."""
    positions = np.stack([np.stack([x, 0.1 * np.ones(len(x))], axis=1)] * 2).astype(np.float32)
    return Trajectory(
        positions=positions,
        time=np.array([0.0, scene.duration]),
        velocity0=np.zeros((len(x), 2), np.float32),
        friction=np.full(len(x), scene.material.friction, np.float32),
        scene=scene,
    )


def kept(flow: Trajectory, record: Recording) -> Trajectory:
    """The frames of a flow that were asked for."""
    frames = record.kept(len(flow.time))
    return dataclasses.replace(flow, positions=flow.positions[frames], time=flow.time[frames])


@dataclass
class FakeMpm:
    """Deposits by the formula, with a scatter that depends on the jitter seed."""

    scatter: float = 0.0
    """[m]."""
    killed_after: int = 10**6
    scenes: list[Scene] = field(default_factory=list)
    """All that was simulated."""

    def __call__(self, scenes: Sequence[Scene], /, *, record: Recording = ALL) -> list[Trajectory]:
        return [kept(self.run(scene), record) for scene in scenes]

    def run(self, scene: Scene) -> Trajectory:
        if len(self.scenes) >= self.killed_after:
            raise KeyboardInterrupt
        self.scenes.append(scene)
        angle = scene.material.friction_deg
        chance = np.random.default_rng([scene.seed, round(angle * 1e6)]).normal() * self.scatter
        x = (length(angle) + chance) * SHAPE
        return at_rest(x, scene)


@dataclass(kw_only=True)
class FakeSurrogate:
    """The formula with another slope and another length."""

    observation: Observation
    steepness: float
    """Its slope over the true one."""
    offset: float
    """Its length over the true one, at 30 degrees."""
    evaluations: int = 0

    def predict(self, unknowns: Tensor) -> Tensor:
        self.evaluations += 1
        angle = unknowns[0]
        true = 1.0 - 0.02 * (angle - 12.0) + 0.5 * 0.0003 * (angle - 12.0) ** 2
        middle = length(30.0)
        x = (self.offset * middle + self.steepness * (true - middle)) * torch.from_numpy(SHAPE)
        return self.observation.smooth(torch.stack([x, 0.1 * torch.ones(POINTS)], 1), torch.ones(POINTS))

    def observe(self, unknowns: Sequence[Vector]) -> list[Values]:
        return [self.predict(torch.from_numpy(values)).numpy() for values in unknowns]

    def wanted(self, target: Values) -> Values:
        return target

    def deposit(self, unknowns: Vector) -> NDArray[np.floating]:
        return np.stack([length(float(unknowns[0])) * SHAPE, 0.1 * np.ones(POINTS)], axis=1)

    # As a source of surrogates it is always the same one.
    def first_frames(self, scene: Scene) -> Scene:
        return dataclasses.replace(scene, duration=0.05)

    def start(self, beginning: Trajectory) -> "FakeSurrogate":
        return self


@dataclass(frozen=True, kw_only=True)
class Case:
    """A problem with all that it takes to solve it."""

    problem: Problem
    target: Target
    observation: Observation
    source: FakeSurrogate
    mpm: FakeMpm


MakeCase = Callable[..., Case]


@pytest.fixture
def make_case(tmp_path: Path) -> MakeCase:
    """Builds a case; everything that makes it hard is a keyword."""

    def make(
        *,
        truth: float = 24.0,
        kind: Observable = Observable.FRONT,
        steepness: float = 1.0,
        offset: float = 1.0,
        scatter: float = 0.0,
        settings: TargetSettings | None = None,
        loop: LoopSettings | None = None,
        initial: float = 30.0,
    ) -> Case:
        scene = Scene(
            domain=Domain(size=(1.2, 0.4), cell=0.01),
            material=Material(friction_deg=33.3),
            masses=(Mass(lower=(0.0, 0.0), size=(0.3, 0.2)),),
        )
        problem = Problem(
            name="wedge",
            folder=tmp_path,
            scene=scene,
            unknowns=(Unknown(name="friction_deg", initial=initial, lower=12.0, upper=52.0),),
            observation=ObservationSettings(kind=kind),
            target=settings or TargetSettings(hidden=True, seed=7, truth={"friction_deg": truth}),
            loop=loop or LoopSettings(),
        )
        observation = observations.build(problem.observation, scene)
        mpm = FakeMpm(scatter=scatter)
        target = read_target(problem, observation, mpm.run)
        mpm.scenes.clear()
        source = FakeSurrogate(observation=observation, steepness=steepness, offset=offset)
        return Case(problem=problem, target=target, observation=observation, source=source, mpm=mpm)

    return make
