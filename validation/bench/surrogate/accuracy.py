"""Every held-out scene by every model, and how far the reference itself is from one on finer cells."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from datasets.trajectory import Trajectory
from gns.units import Units
from validation.bench.surrogate.held_out import HeldOut, References, on_cell, other_jitter
from validation.bench.surrogate.models import Model, RolloutTask, roll_out
from validation.bench.surrogate.records import Records, digest
from validation.bench.surrogate.scores import Deposit, Score, compare, deposit

Map = Callable[[Callable[[RolloutTask], Trajectory], Iterable[RolloutTask]], Iterable[Trajectory]]
"""The built-in `map`, or that of an executor."""
AT_ONCE = 16
"""Rollouts whose positions are held at once."""


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """Scores by model, in the order of the scenes."""

    scenes: Sequence[HeldOut]
    scores: Mapping[str, Sequence[Score]]
    finer: Sequence[Deposit]
    """The reference against one on cells half as large, of some scenes."""
    jitter: Sequence[Deposit]
    """The reference against another jitter, of the same scenes."""

    def of_kind(self, model: str, kind: str | None) -> list[Score]:
        """The scores of a model on scenes of a kind, of all where it is None."""
        pairs = zip(self.scenes, self.scores[model], strict=True)
        return [score for scene, score in pairs if kind in (None, scene.kind)]


def measure(
    scenes: Sequence[HeldOut], models: Sequence[Model], references: References, keep: Path, map_tasks: Map
) -> dict[str, list[Score]]:
    """The scores of every model on every scene, in their order; those that `keep` has are not made again."""
    stored = Records(keep / "scores.json", Score)
    keys = {(model.name, each.name): digest(model.digest, each.scene) for model in models for each in scenes}
    for model in models:
        missing = [each for each in scenes if keys[model.name, each.name] not in stored.found]
        with tqdm(total=len(missing), desc=model.name, unit="rollout", dynamic_ncols=True) as bar:
            for first in range(0, len(missing), AT_ONCE):
                some = missing[first : first + AT_ONCE]
                tasks = [RolloutTask(model=model.path, scene=each.scene) for each in some]
                truths = references([each.scene for each in some])
                scores = [
                    compare(rollout, truth, Units.of_scene(each.scene, model.settings).length * model.settings.cell)
                    for each, rollout, truth in zip(some, map_tasks(roll_out, tasks), truths, strict=True)
                ]
                stored.add((keys[model.name, each.name], score) for each, score in zip(some, scores, strict=True))
                bar.update(len(some))
    return {model.name: [stored.found[keys[model.name, each.name]] for each in scenes] for model in models}


def spread_over_kinds(scenes: Sequence[HeldOut], number: int) -> list[HeldOut]:
    """So many scenes, the first of every kind, then the second of every kind, and so on."""
    return sorted(scenes, key=lambda each: each.number)[:number]


def reference_errors(scenes: Sequence[HeldOut], references: References) -> tuple[list[Deposit], list[Deposit]]:
    """The reference's deposits against those on cells half as large, and against those of another jitter."""
    own = references([each.scene for each in scenes])
    finer = references([on_cell(each.scene, 0.5 * each.scene.domain.cell) for each in scenes])
    others = references([other_jitter(each.scene) for each in scenes])
    return (
        [deposit(flow.positions[-1], flow.volumes, truth) for flow, truth in zip(own, finer, strict=True)],
        [deposit(flow.positions[-1], flow.volumes, truth) for flow, truth in zip(others, own, strict=True)],
    )
