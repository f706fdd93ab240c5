"""What `metadata.json` of a dataset says: the keys of the peers' format and ours."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from datasets import __version__
from datasets.definitions.definition import Definition, Entry, Split
from datasets.training.statistics import MOVING_SPEED, MotionStatistics


def metadata(
    definition: Definition, entries: Sequence[Entry], *, seed: int, statistics: MotionStatistics
) -> dict[str, Any]:
    """The contents of `metadata.json` for a dataset of `entries`, all in the same box and of the same frames.

    `statistics` are those of the training split.
    """
    scene = entries[0].scene
    material = asdict(scene.material)
    del material["friction_deg"]
    angles = [entry.scene.material.friction_deg for entry in entries]
    return {
        # The peers' keys.
        "bounds": [[0.0, length] for length in scene.domain.size],
        "sequence_length": scene.frames,
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
        "cell": scene.domain.cell,
        "particles_per_axis": scene.particles_per_axis,
        "step_fraction": scene.step_fraction,
        "material": material,
        "friction_deg": [min(angles), max(angles)],
        "floor_friction": scene.floor_friction,
        "wall_friction": scene.wall_friction,
        "baffle_friction": scene.baffle_friction,
        "damping": scene.damping,
        "version": __version__,
    }
