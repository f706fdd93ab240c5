"""Deposits that have come to rest, and whether a rollout four times as long leaves them there."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from datasets import measures
from datasets.records import Record
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from validation.bench.stability.invariants import inside_box, outside_baffles
from validation.bench.surrogate.accuracy import Map
from validation.bench.surrogate.held_out import HeldOut, References
from validation.bench.surrogate.models import Model, RolloutTask, roll_out
from validation.bench.surrogate.records import Records, digest

TIMES = 4
"""How many times as long a rollout is as its scene."""
CREEP = 0.1
"""Criterion of the front's speed over the second half [mm/s]."""


@dataclass(frozen=True, kw_only=True)
class LongRollout(Record):
    """A deposit over the second half of a long rollout."""

    creep: float
    """Speed of the faster of the deposit's ends, outwards [mm/s]."""
    transport: float
    """Rms distance along x that equal shares of the deposit move, over the time [mm/s]."""
    contained: bool
    """Whether in every frame no particle is outside the box or inside a baffle, beyond rounding."""


@dataclass(frozen=True, kw_only=True)
class Rest:
    """Long rollouts by model, in the order of the scenes."""

    scenes: Sequence[HeldOut]
    rollouts: dict[str, list[LongRollout]]


def settled(scenes: Sequence[HeldOut], references: References, number: int) -> list[HeldOut]:
    """So many scenes whose reference comes to rest before its end, the first of every kind first."""
    ordered = sorted(scenes, key=lambda each: each.number)
    found: list[HeldOut] = []
    for each in ordered:
        if len(found) == number:
            break
        (flow,) = references([each.scene])
        if flow.summary["rest_time"] is not None:
            found.append(each)
    return found


def measure(scenes: Sequence[HeldOut], models: Sequence[Model], keep: Path, map_tasks: Map) -> Rest:
    """Long rollouts of all scenes by all models; those that `keep` has are not made again."""
    stored = Records(keep / "rest.json", LongRollout)
    keys = {(model.name, each.name): digest(model.digest, each.scene, TIMES) for model in models for each in scenes}
    missing = [
        (keys[model.name, each.name], RolloutTask(model=model.path, scene=longer(each.scene)))
        for model in models
        for each in scenes
        if keys[model.name, each.name] not in stored.found
    ]
    rollouts = map_tasks(roll_out, [task for _, task in missing])
    bar = tqdm(rollouts, total=len(missing), desc="rest", unit="rollout", dynamic_ncols=True)
    for (key, _), rollout in zip(missing, bar, strict=True):
        stored.add([(key, second_half(rollout))])
    return Rest(
        scenes=scenes,
        rollouts={model.name: [stored.found[keys[model.name, each.name]] for each in scenes] for model in models},
    )


def longer(scene: Scene) -> Scene:
    """The scene `TIMES` times as long."""
    return dataclasses.replace(scene, duration=TIMES * scene.duration)


def second_half(rollout: Trajectory) -> LongRollout:
    """How a deposit moves in the second half of a rollout, and whether the solids held it all the time."""
    middle = len(rollout.positions) // 2
    seconds = float(rollout.time[-1] - rollout.time[middle])
    before, after = rollout.positions[middle], rollout.positions[-1]
    moved = measures.transport_distance(after, rollout.volumes, before, rollout.volumes)
    old, new = measures.ends(before), measures.ends(after)
    checks = [inside_box(rollout), outside_baffles(rollout)]
    return LongRollout(
        creep=1000.0 * max(old[0] - new[0], new[1] - old[1], key=abs) / seconds,
        transport=1000.0 * moved / seconds,
        contained=all(check is None or check.ok for check in checks),
    )
