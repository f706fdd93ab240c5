"""Long rollouts from rest: they stay in the box and out of the baffles, and the deposit comes to rest."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from tqdm import tqdm

from datasets import measures
from datasets.particles import particle_count
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from mpm import simulate
from validation.bench.stability.invariants import inside_box, outside_baffles
from validation.bench.surrogate.comparison import Map, Series, flow_series
from validation.bench.surrogate.rollouts import Rollout, RolloutTask, ShippedModel, run_task

MOTION = 0.01
"""Most kinetic energy that may be left, mean over the last tenth of the time, over its greatest [-]."""
CREEP = 1.0
"""Most that the front may move over the second half of the time [mm/s]."""
RECORD = 3.5e8
"""Largest record of an MPM run [bytes]."""
FEWER = 20
"""How many times further apart the frames of a larger one are."""


@dataclass(frozen=True, kw_only=True)
class LongRollout:
    """Bounds of a long rollout, beside the MPM's."""

    scene: str
    model: str
    duration: float
    """[s]."""
    outside: float
    """Largest distance of any particle in any frame outside the box [cells of the scene]; nan where not finite."""
    inside: float
    """Largest depth of any particle in any frame inside a baffle [cells of the scene]; nan without baffles."""
    contained: bool
    """Whether all is finite and both are within rounding."""
    motion: tuple[float, float]
    """Kinetic energy left over its greatest, of the surrogate and of the MPM [-]."""
    creep: tuple[float, float]
    """Of the front over the second half [mm/s]."""
    front: tuple[float, float]
    """At the end [m]."""

    @property
    def bounded(self) -> bool:
        """Whether all criteria are met."""
        return self.contained and self.motion[0] <= MOTION and abs(self.creep[0]) <= CREEP


def measure(scenes: Mapping[str, Scene], models: Sequence[ShippedModel], map_tasks: Map) -> list[LongRollout]:
    """Roll out every scene with every model of its dimension."""
    pairs = [(name, model) for name in scenes for model in models if model.settings.dimension == scenes[name].dimension]
    flows = {name: simulate(sparse(scene)) for name, scene in scenes.items()}
    tasks = [RolloutTask(model=model.path, scene=scenes[name]) for name, model in pairs]
    rollouts = tqdm(map_tasks(run_task, tasks), total=len(tasks), desc="long", unit="rollout", dynamic_ncols=True)
    return [
        bounds(name, scenes[name], model.name, rollout, flows[name])
        for (name, model), rollout in zip(pairs, rollouts, strict=True)
    ]


def sparse(scene: Scene) -> Scene:
    """`scene` with fewer frames where all of them would not fit into `RECORD`.

    A frame is a whole number of steps, so that the step is a few per cent longer then: what fits stays as it is.
    """
    size = 4.0 * scene.dimension * particle_count(scene) * scene.frames
    frames = scene.duration / (FEWER * scene.frame_dt)
    if size <= RECORD or abs(frames - round(frames)) > 1e-6:
        return scene
    return replace(scene, frame_dt=FEWER * scene.frame_dt)


def bounds(name: str, scene: Scene, model: str, rollout: Rollout, mpm: Trajectory) -> LongRollout:
    """The criteria of one rollout."""
    flow = Trajectory(
        positions=rollout.positions,
        time=rollout.step * np.arange(len(rollout.positions), dtype=np.float64),
        velocity0=rollout.velocity0,
        friction=np.zeros(len(rollout.indices), np.float32),
        scene=scene,
    )
    box, baffles = inside_box(flow), outside_baffles(flow)
    series = flow_series(rollout.positions, rollout, scene)
    fronts = np.array([measures.front(each) for each in mpm.positions])
    return LongRollout(
        scene=name,
        model=model,
        duration=scene.duration,
        outside=box.value,
        inside=float("nan") if baffles is None else baffles.value,
        contained=bool(np.isfinite(rollout.positions).all()) and box.ok and (baffles is None or baffles.ok),
        motion=(left(series.kinetic), left(np.array(mpm.summary["energy"]["kinetic"]))),
        creep=(creep(series.front, scene.duration), creep(fronts, scene.duration)),
        front=(float(series.front[-1]), float(fronts[-1])),
    )


def left(kinetic: Series) -> float:
    """Mean over the last tenth over the greatest of a series [K]."""
    return float(kinetic[-max(1, len(kinetic) // 10) :].mean() / kinetic.max())


def creep(front: Series, duration: float) -> float:
    """Speed of a front [m], shape [K], over the second half of `duration` [s]; [mm/s]."""
    return float(1000.0 * (front[-1] - front[len(front) // 2]) / (0.5 * duration))
