"""A rollout against the MPM's runs of the same scene: fronts, profiles, distances, energies."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from datasets import measures
from datasets.particles import particle_count
from datasets.scene import Scene
from datasets.training.samples import frames_per_step
from datasets.trajectory import Floats, Trajectory
from gns.initial import Start, first_frames
from gns.score import SPACING
from mpm import LAST, simulate, simulate_many
from mpm.simulation import LARGE
from validation.bench.surrogate.rollouts import Rollout, RolloutTask, ShippedModel, run_task

Key = TypeVar("Key")
Map = Callable[[Callable[[RolloutTask], Rollout], Sequence[RolloutTask]], Iterable[Rollout]]
"""The built-in `map`, or that of an executor."""
Series = NDArray[np.float64]
MOMENTS = (0.25, 0.5, 1.0)
"""Fractions of a flow's time at which positions are compared."""
AT_WALL = 0.99
"""Particles beyond this fraction of the box are at the far wall."""


@dataclass(frozen=True, kw_only=True)
class FlowSeries:
    """A flow over time, of some of its particles, K steps from its start to its end."""

    front: Series
    """[m], shape [K + 1]."""
    runout: Series
    """[m], shape [K + 1]."""
    kinetic: Series
    """Kinetic energy of the mean velocities over each step, over all energy at the start [-], shape [K]."""
    potential: Series
    """Potential energy above the floor over the same [-], shape [K + 1]."""
    depth: Series
    """Upstream of the first baffles [m], shape [K + 1]; nan where there are none."""
    profile: Series
    """Of the deposit, volume per length of x, in 2D a height [m^(D-1)], shape [S]."""
    deposit: Floats
    """The last positions [m], shape [n, D]."""


@dataclass(frozen=True, kw_only=True)
class MpmRuns:
    """The MPM's runs of a scene."""

    flow: Trajectory
    """That of the scene itself."""
    fronts: tuple[float, ...]
    """Of the deposits over jitter seeds, the scene's own first [m]."""
    mse: float
    """Mean squared distance of the particles of the other seeds' deposits from its own [m^2]; nan of one seed."""


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """One rollout beside the MPM; errors relative to the MPM's value [-]."""

    model: str
    start: Start
    scene: Scene
    step: float
    """[s]."""
    volume: Floats
    """Of the nodes [m^D], shape [n]."""
    surrogate: FlowSeries
    mpm: FlowSeries
    """Of the surrogate's particles."""
    front: float
    """Of the MPM's deposit, all particles [m]."""
    runout: float
    """Largest x of the same [m]."""
    scatter: float
    """Standard deviation of the MPM's front over jitter seeds, over the front [-]; nan of one seed."""
    mpm_mse: float
    """See `MpmRuns.mse` [m^2]."""
    rmse: tuple[float, ...]
    """Root mean square distance of the particles at `MOMENTS` [m]."""

    @property
    def at_wall(self) -> bool:
        """Whether the MPM's flow comes to the far wall, which then bounds everyone's front."""
        return self.runout > AT_WALL * self.scene.domain.size[0]

    @property
    def front_error(self) -> float:
        """Of the deposit's front, against all of the MPM's particles."""
        return float(self.surrogate.front[-1] / self.front - 1.0)

    @property
    def same_front_error(self) -> float:
        """The same against the MPM's front of the surrogate's particles."""
        return float(self.surrogate.front[-1] / self.mpm.front[-1] - 1.0)

    @property
    def runout_error(self) -> float:
        """Of the largest x, against all of the MPM's particles."""
        return float(self.surrogate.runout[-1] / self.runout - 1.0)

    @property
    def profile_error(self) -> float:
        """Area between the height profiles of the deposits over that under the MPM's."""
        return measures.profile_error(self.surrogate.profile, self.mpm.profile)

    @property
    def mse(self) -> float:
        """Mean squared distance of the particles at the end [m^2]."""
        return self.rmse[-1] ** 2

    @property
    def kinetic_error(self) -> float:
        """Largest difference over time, over all energy at the start."""
        return float(np.abs(self.surrogate.kinetic - self.mpm.kinetic).max())

    @property
    def potential_error(self) -> float:
        """Largest difference over time, over all energy at the start."""
        return float(np.abs(self.surrogate.potential - self.mpm.potential).max())

    @property
    def depth_errors(self) -> tuple[float, float]:
        """Mean and largest difference over time of the upstream depths, over the MPM's greatest depth."""
        difference = np.abs(self.surrogate.depth - self.mpm.depth) / self.mpm.depth.max()
        return float(difference.mean()), float(difference.max())


def mpm_runs(scene: Scene, seeds: int) -> MpmRuns:
    """Run a scene with several jitters: small ones side by side, large ones one after the other."""
    scenes = [dataclasses.replace(scene, seed=scene.seed + number) for number in range(seeds)]
    if particle_count(scene) < LARGE:
        flows = simulate_many(scenes)
        flow, deposits = flows[0], [each.positions[-1] for each in flows]
    else:
        flow = simulate(scene)
        deposits = [flow.positions[-1], *(simulate(each, record=LAST).positions[-1] for each in scenes[1:])]
    squares = [np.square(each.astype(np.float64) - deposits[0]).sum(axis=1).mean() for each in deposits[1:]]
    fronts = tuple(measures.front(each) for each in deposits)
    return MpmRuns(flow=flow, fronts=fronts, mse=float(np.mean(squares)) if squares else float("nan"))


def compare_all(
    scenes: Mapping[Key, Scene], models: Sequence[ShippedModel], seeds: int, map_tasks: Map, what: str
) -> dict[Key, list[Comparison]]:
    """Every scene by the MPM, and by every model from both starts; `what` labels the progress bar."""
    found: dict[Key, list[Comparison]] = {}
    variants = [(model, start) for model in models for start in Start]
    for key, scene in tqdm(scenes.items(), desc=what, unit="scene", dynamic_ncols=True):
        runs = mpm_runs(scene, seeds)
        frames = first_frames(runs.flow)
        tasks = [
            RolloutTask(model=model.path, scene=scene, frames=frames if start is Start.FROM_MPM_FRAMES else None)
            for model, start in variants
        ]
        found[key] = [
            compare(model.name, start, rollout, runs)
            for (model, start), rollout in zip(variants, map_tasks(run_task, tasks), strict=True)
        ]
    return found


def compare(model: str, start: Start, rollout: Rollout, runs: MpmRuns) -> Comparison:
    """A rollout against the MPM's runs of the same scene."""
    flow, fronts = runs.flow, runs.fronts
    stride = frames_per_step(flow.scene.frame_dt, rollout.step, "MPM")
    same = flow.positions[::stride][: len(rollout.positions), rollout.indices]
    distance = np.square(rollout.positions - same).sum(axis=2).mean(axis=1) ** 0.5
    front = measures.front(flow.positions[-1])
    return Comparison(
        model=model,
        start=start,
        scene=flow.scene,
        step=rollout.step,
        volume=rollout.volume,
        surrogate=flow_series(rollout.positions, rollout, flow.scene),
        mpm=flow_series(same, rollout, flow.scene),
        front=front,
        runout=measures.runout(flow.positions[-1]),
        scatter=float(np.std(fronts, ddof=1)) / front if len(fronts) > 1 else float("nan"),
        mpm_mse=runs.mse,
        rmse=tuple(float(distance[round(fraction * (len(same) - 1))]) for fraction in MOMENTS),
    )


def flow_series(positions: Floats, rollout: Rollout, scene: Scene) -> FlowSeries:
    """Of `positions` [m], shape [K + 1, n, D], of the particles of `rollout`."""
    volume = rollout.volume.astype(np.float64)
    mass = scene.material.density * volume
    potential = measures.potential_energy(positions, mass, scene.gravity)
    energy = float(potential[0] + measures.kinetic_energy(rollout.velocity0, mass))
    velocities = np.diff(positions.astype(np.float64), axis=0) / rollout.step

    def depth(frame: Floats) -> float:
        return measures.upstream_depth(frame, volume, scene) if scene.baffles else float("nan")

    def series(measure: Callable[[Floats], Any]) -> Series:
        return np.array([measure(frame) for frame in positions])

    return FlowSeries(
        front=series(measures.front),
        runout=series(measures.runout),
        kinetic=measures.kinetic_energy(velocities, mass) / energy,
        potential=potential / energy,
        depth=series(depth),
        profile=measures.height_profile(positions[-1], volume, measures.profile_stations(scene, SPACING)),
        deposit=positions[-1],
    )


def by_variant(comparisons: Iterable[Comparison]) -> dict[tuple[str, Start], list[Comparison]]:
    """Grouped by model and start, in the order in which they come."""
    variants: dict[tuple[str, Start], list[Comparison]] = {}
    for each in comparisons:
        variants.setdefault((each.model, each.start), []).append(each)
    return variants
