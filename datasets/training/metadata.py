"""What `metadata.json` of a dataset says: the keys of geoelements' format and ours."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from datasets import __version__
from datasets.definitions.definition import Definition, Entry, Split
from datasets.training.statistics import MOVING_SPEED, MotionStatistics


def metadata(
    definition: Definition, entries: Sequence[Entry], *, seed: int, statistics: MotionStatistics
) -> dict[str, Any]:
    """The contents of `metadata.json` for a dataset of `entries`, which share the time between frames.

    The box and the length are those of the largest; what differs between scenes is [smallest, largest]. `statistics`
    are those of the training split.
    """
    scenes = [entry.scene for entry in entries]
    scene = scenes[0]
    materials = [asdict(each.material) for each in scenes]
    angles = [each.material.friction_deg for each in scenes]

    def shared(key: str) -> Any:
        return extremes([getattr(each, key) for each in scenes])

    return {
        # The keys of geoelements.
        "bounds": [[0.0, max(lengths)] for lengths in zip(*(each.domain.size for each in scenes), strict=True)],
        "sequence_length": max(each.frames for each in scenes),
        "default_connectivity_radius": definition.connectivity_radius,
        "dim": scene.dimension,
        "dt": scene.frame_dt,
        **statistics.metadata(),
        # Ours.
        "definition": definition.name,
        "seed": seed,
        "count": len(entries),
        "splits": {split.value: sum(entry.split is split for entry in entries) for split in Split},
        "statistics": {
            "split": Split.TRAIN.value,
            "moving_speed": MOVING_SPEED,
            "velocities": statistics.velocity.count,
            "accelerations": statistics.acceleration.count,
        },
        "cell": extremes([each.domain.cell for each in scenes]),
        "particles_per_axis": shared("particles_per_axis"),
        "step_fraction": shared("step_fraction"),
        "material": {key: extremes([each[key] for each in materials]) for key in materials[0] if key != "friction_deg"},
        "friction_deg": [min(angles), max(angles)],
        "floor_friction": shared("floor_friction"),
        "wall_friction": shared("wall_friction"),
        "baffle_friction": shared("baffle_friction"),
        "damping": shared("damping"),
        "version": __version__,
    }


def extremes(values: Sequence[Any]) -> Any:
    """The value that all have, else the smallest and the largest of those that are numbers."""
    if all(value == values[0] for value in values):
        return values[0]
    numbers = [value for value in values if value is not None]
    return [min(numbers), max(numbers)]
