"""The section about long rollouts: they stay in the box and out of the baffles, and the deposit comes to rest."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from tqdm import tqdm

from datasets import measures
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from inverse.report.markdown import table
from mpm import simulate
from validation.bench.accuracy.page import paragraph
from validation.bench.stability.invariants import inside_box, outside_baffles
from validation.bench.surrogate.courses import course
from validation.bench.surrogate.figures import bold, off
from validation.bench.surrogate.held_out import coarsely
from validation.bench.surrogate.models import Model
from validation.bench.surrogate.rollouts import Roller, Rollout, Task

MOTION = 0.01
"""Most kinetic energy that may be left, mean over the last tenth of the time, over its greatest [-]."""
CREEP = 1.0
"""Most that the front may move over the second half of the time [mm/s]."""


@dataclass(frozen=True, kw_only=True)
class Long:
    """A long rollout from rest."""

    scene: str
    model: str
    duration: float
    """[s]."""
    finite: bool
    outside: float
    """How far any point ever is outside the box [cells of the scene]."""
    inside: float | None
    """How deep any point ever is inside a baffle [cells of the scene]; where there are baffles."""
    clear: bool
    """Whether both are within rounding."""
    motion: float
    """Kinetic energy left over its greatest [-]."""
    creep: float
    """Of the front over the second half [mm/s]."""
    front: float
    """At the end [m]."""
    mpm_front: float
    """The MPM's [m]."""
    mpm_motion: float
    """The same as `motion` of the MPM, from all its points."""
    mpm_creep: float
    """[mm/s]."""

    @property
    def bounded(self) -> bool:
        """The verdict."""
        return self.finite and self.clear and self.motion <= MOTION and abs(self.creep) <= CREEP


def measure(scenes: Mapping[str, Scene], models: Sequence[Model], roller: Roller) -> list[Long]:
    """Roll out every scene with every model of its dimension."""
    pairs = [
        (name, scene, model)
        for name, scene in scenes.items()
        for model in models
        if model.settings.dimension == scene.dimension
    ]
    found = []
    with tqdm(total=len(pairs), desc="long", unit="rollout", dynamic_ncols=True) as bar:
        truths = {name: simulate(coarsely(scene)) for name, scene in scenes.items()}
        rollouts = roller([Task(model=model.path, scene=scene) for _, scene, model in pairs])
        for (name, scene, model), rollout in zip(pairs, rollouts, strict=True):
            found.append(judged(name, scene, model.name, rollout, truths[name]))
            bar.update()
    return found


def judged(name: str, scene: Scene, model: str, rollout: Rollout, truth: Trajectory) -> Long:
    """What is to be said of one rollout."""
    flow = Trajectory(
        positions=rollout.positions,
        time=rollout.step * np.arange(len(rollout.positions), dtype=np.float64),
        velocity0=rollout.velocity0,
        friction=np.zeros(len(rollout.indices), np.float32),
        scene=scene,
    )
    box, baffles = inside_box(flow), outside_baffles(flow)
    went = course(rollout.positions, rollout, scene)
    kinetic = np.array(truth.summary["energy"]["kinetic"])
    fronts = np.array([measures.front(each) for each in truth.positions])
    return Long(
        scene=name,
        model=model,
        duration=scene.duration,
        finite=bool(np.isfinite(rollout.positions).all()),
        outside=box.value,
        inside=None if baffles is None else baffles.value,
        clear=box.ok and (baffles is None or baffles.ok),
        motion=left(went.kinetic),
        creep=creep(went.front, scene.duration),
        front=float(went.front[-1]),
        mpm_front=float(fronts[-1]),
        mpm_motion=left(kinetic),
        mpm_creep=creep(fronts, scene.duration),
    )


def left(kinetic: np.ndarray) -> float:
    """Mean over the last tenth over the greatest of a series [K]."""
    return float(kinetic[-max(1, len(kinetic) // 10) :].mean() / kinetic.max())


def creep(front: np.ndarray, duration: float) -> float:
    """Movement of a front [m], shape [K], over the second half of `duration` [s]; [mm/s]."""
    return float(1000.0 * (front[-1] - front[len(front) // 2]) / (0.5 * duration))


def prolonged(scene: Scene, duration: float) -> Scene:
    """`scene`, watched for longer."""
    return dataclasses.replace(scene, duration=duration)


def text(found: Sequence[Long]) -> list[str]:
    """The section."""
    rows = [
        [
            f"`{each.scene}`, {each.duration:g} s",
            f"`{each.model}`",
            "bounded" if each.bounded else "**not bounded**",
            "yes" if each.finite else "**no**",
            f"{each.outside:.1e}",
            "-" if each.inside is None else f"{each.inside:.1e}",
            f"{bold(f'{each.motion:.1e}', each.motion > MOTION)} ({each.mpm_motion:.1e})",
            f"{bold(f'{each.creep:+.2f}', abs(each.creep) > CREEP)} ({each.mpm_creep:+.2f})",
            f"{each.front:.4f} ({each.mpm_front:.4f}; {off(each.front / each.mpm_front - 1.0)})",
        ]
        for each in found
    ]
    head = ["scene", "model", "verdict", "all finite", "outside the box [cells]", "inside a baffle [cells]"]
    tail = ["motion left (MPM)", "creep of the front [mm/s] (MPM)", "front at the end [m] (MPM; error)"]
    return [
        "## Long rollouts",
        "",
        *paragraph(f"""
            From rest, with the MPM beside. Bounded: all numbers finite, in every frame no point outside the box or
            inside a baffle (beyond rounding), motion left (kinetic energy over the last tenth of the time over its
            greatest) at most {MOTION:g}, and in the second half of the time the front creeps by at most {CREEP:g} mm/s.
        """),
        *table([*head, *tail], rows),
        "",
    ]
