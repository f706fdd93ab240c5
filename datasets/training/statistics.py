"""What `metadata.json` says of a dataset: mean and spread of velocities and accelerations, ranges of its scenes.

With the positions x_t of a particle in frame t, per axis and with one frame as the unit of time:

    velocity      v_t = x_t - x_(t-1)
    acceleration  a_t = v_(t+1) - v_t

What is counted: **moving particles only**. A velocity counts where the particle moved in that step faster than
`MOVING_SPEED`; an acceleration where it did so before or after. Most particles of most frames lie still in a settled
deposit; counting them would shrink the spread by how long the sequence was watched, not by how the sand flows.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets import __version__
from datasets.definitions.definition import Entry, Split

MOVING_SPEED = 0.01
"""A particle slower than this [m/s] is at rest: it would need the whole second of a sequence to cross a grid cell."""


@dataclass(frozen=True, kw_only=True)
class Moments:
    """Count, mean and sum of squared deviations of a sample; two of them add up to those of the joint sample."""

    count: int
    mean: NDArray[np.float64]
    """Mean per axis, shape [D]."""
    squares: NDArray[np.float64]
    """Sum of squared deviations from the mean per axis, shape [D]."""

    @staticmethod
    def from_samples(samples: NDArray[np.float64]) -> "Moments":
        """The moments of `samples`, shape [S, D]; S may be 0."""
        if len(samples) == 0:
            return Moments(count=0, mean=np.zeros(samples.shape[1]), squares=np.zeros(samples.shape[1]))
        mean = samples.mean(axis=0)
        return Moments(count=len(samples), mean=mean, squares=((samples - mean) ** 2).sum(axis=0))

    def __add__(self, other: "Moments") -> "Moments":
        """Pairwise update of Chan, Golub and LeVeque (1983): nothing cancels, whatever the sizes of the parts."""
        count = self.count + other.count
        if count == 0:
            return self
        shift = other.mean - self.mean
        return Moments(
            count=count,
            mean=self.mean + shift * (other.count / count),
            squares=self.squares + other.squares + shift**2 * (self.count * other.count / count),
        )

    @property
    def std(self) -> NDArray[np.float64]:
        """Standard deviation per axis (of the population), shape [D]."""
        return np.asarray(np.sqrt(self.squares / max(self.count, 1)))


@dataclass(frozen=True, kw_only=True)
class MotionStatistics:
    """Moments of the frame differences of one or more trajectories."""

    velocity: Moments
    """Of v_t [m per frame]."""
    acceleration: Moments
    """Of a_t [m per frame^2]."""

    def __add__(self, other: "MotionStatistics") -> "MotionStatistics":
        return MotionStatistics(
            velocity=self.velocity + other.velocity, acceleration=self.acceleration + other.acceleration
        )

    def metadata(self) -> dict[str, list[float]]:
        """The keys of geoelements `vel_mean`, `vel_std`, `acc_mean`, `acc_std`, one number per axis."""
        return {
            "vel_mean": self.velocity.mean.tolist(),
            "vel_std": self.velocity.std.tolist(),
            "acc_mean": self.acceleration.mean.tolist(),
            "acc_std": self.acceleration.std.tolist(),
        }


def motion_statistics(positions: NDArray[np.floating], frame_dt: float) -> MotionStatistics:
    """The statistics of one trajectory: positions [m], shape [T, N, D]; time between frames [s]."""
    # Differences in double precision: those of float32 positions near 1 m are exact only to 1e-7.
    velocity = np.diff(positions.astype(np.float64), axis=0)
    acceleration = np.diff(velocity, axis=0)
    moving = np.linalg.norm(velocity, axis=-1) > MOVING_SPEED * frame_dt
    return MotionStatistics(
        velocity=Moments.from_samples(velocity[moving]),
        acceleration=Moments.from_samples(acceleration[moving[:-1] | moving[1:]]),
    )


def metadata(
    name: str, entries: Sequence[Entry], *, connectivity_radius: float, seed: int | None, statistics: MotionStatistics
) -> dict[str, Any]:
    """The contents of `metadata.json` for a dataset of `entries`, which share the time between frames.

    The box and the length are those of the largest; what differs between scenes is [smallest, largest].
    name: of its definition; connectivity_radius: [m], for readers of other formats; seed: where it was drawn;
    statistics: of the split of the first entry, that of the training.
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
        "default_connectivity_radius": connectivity_radius,
        "dim": scene.dimension,
        "dt": scene.frame_dt,
        **statistics.metadata(),
        # Ours.
        "definition": name,
        "seed": seed,
        "count": len(entries),
        "splits": {split.value: sum(entry.split is split for entry in entries) for split in Split},
        "statistics": {
            "split": entries[0].split.value,
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
