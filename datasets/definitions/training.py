"""Training data from trajectories: the particles that a surrogate follows, and the motion statistics of a dataset.

With the positions x_t of a particle in frame t, per axis and with one frame as the unit of time:

    velocity      v_t = x_t - x_(t-1)
    acceleration  a_t = v_(t+1) - v_t

Their statistics cover only moving particles: a velocity counts if the particle moved faster than `MOVING_SPEED` in that
step, an acceleration if it did so before or after. Most particles of most frames lie still in a settled deposit; if
they counted, the spread would depend on the duration of the sequence rather than on the flow.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets import __version__
from datasets.definitions.definition import Entry, Split, Stream

MOVING_SPEED = 0.01
"""A particle slower than this [m/s] is at rest: it would need the whole second of a sequence to cross a grid cell."""


def thin(
    positions: NDArray[np.floating], volume: float | NDArray[np.floating], *, cell: float, kept: int, rng: Stream
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Keep `kept` random particles of each cell [m], with probability proportional to volume; they share its volume.
    positions: [m], shape [N, D]; volume: of the particles [m^D], one for all or shape [N]. Another draw from `rng`
    keeps others of the same flow, which augments the training data. Returns the indices of kept particles, ascending,
    and the volume that each represents [m^D], both of shape [n]."""
    cells = np.floor(positions.astype(np.float64) / cell).astype(np.int64)
    cells -= cells.min(axis=0)
    group = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    weight = np.broadcast_to(np.asarray(volume, np.float64), len(group))
    equal = bool((weight == weight[:1]).all())
    # Each particle of a cell comes first with a probability proportional to its volume. Particles at the surface of a
    # body, which form the fronts, are small; with equal probabilities too many of them would be chosen.
    shuffled = rng.permutation(len(group)) if equal else np.argsort(rng.exponential(size=len(group)) / weight)
    order = shuffled[np.argsort(group[shuffled], kind="stable")]
    _, first, count = np.unique(group[order], return_index=True, return_counts=True)
    rank = np.arange(len(order)) - np.repeat(first, count)
    shared = np.repeat(np.add.reduceat(weight[order], first) / np.minimum(count, kept), count)
    stays = rank < kept
    ascending = np.argsort(order[stays])
    return order[stays][ascending], shared[stays][ascending].astype(np.float32)


@dataclass(frozen=True, kw_only=True)
class MotionStatistics:
    """Moments of v_t [m per frame] and of a_t [m per frame^2]; moments of two parts can be added."""

    count: NDArray[np.int64]  # samples of v_t and of a_t, shape [2, 1]
    mean: NDArray[np.float64]  # mean per axis, shape [2, D]
    squares: NDArray[np.float64]  # sum of squared deviations from the mean per axis, shape [2, D]

    @staticmethod
    def from_samples(*samples: NDArray[np.float64]) -> "MotionStatistics":
        """The moments of v_t and of a_t, shape [S, D] each; S may be 0."""
        mean = [sample.mean(axis=0) if len(sample) else np.zeros(sample.shape[1]) for sample in samples]
        squares = [((sample - middle) ** 2).sum(axis=0) for sample, middle in zip(samples, mean, strict=True)]
        count = np.array([[len(sample)] for sample in samples])
        return MotionStatistics(count=count, mean=np.array(mean), squares=np.array(squares))

    def __add__(self, other: "MotionStatistics") -> "MotionStatistics":
        """Pairwise update of Chan, Golub and LeVeque (1983), without cancellation for any sizes of the parts."""
        count = self.count + other.count
        shift, either = other.mean - self.mean, np.maximum(count, 1)
        mean = self.mean + shift * (other.count / either)
        squares = self.squares + other.squares + shift**2 * (self.count * other.count / either)
        return MotionStatistics(count=count, mean=mean, squares=squares)

    @property
    def std(self) -> NDArray[np.float64]:
        """Standard deviation per axis (of the population), shape [2, D]."""
        return np.asarray(np.sqrt(self.squares / np.maximum(self.count, 1)))


def motion_statistics(positions: NDArray[np.floating], frame_dt: float) -> MotionStatistics:
    """The statistics of one trajectory: positions [m], shape [T, N, D]; time between frames [s]."""
    # Differences in double precision: those of float32 positions near 1 m are exact only to 1e-7.
    velocity = np.diff(positions.astype(np.float64), axis=0)
    acceleration = np.diff(velocity, axis=0)
    moving = np.linalg.norm(velocity, axis=-1) > MOVING_SPEED * frame_dt
    return MotionStatistics.from_samples(velocity[moving], acceleration[moving[:-1] | moving[1:]])


def metadata(name: str, entries: Sequence[Entry], *, seed: int | None, statistics: MotionStatistics) -> dict[str, Any]:
    """The contents of `metadata.json` for a dataset of `entries`, which share the time between frames; values that
    differ between scenes are [smallest, largest]. seed: if it was drawn; statistics: of the first entry's split."""
    scenes = [entry.scene for entry in entries]
    scene = scenes[0]
    # Each mass's own: what the scene has for masses without one may be the material of none.
    materials = [asdict(member.material_of(mass)) for member in scenes for mass in member.masses]
    angles = [material.pop("friction_deg") for material in materials]
    counted = dict(zip(("velocities", "accelerations"), statistics.count[:, 0].tolist(), strict=True))

    def shared(key: str) -> Any:
        return extremes([getattr(member, key) for member in scenes])

    return {
        # The keys of geoelements.
        "bounds": [[0.0, max(lengths)] for lengths in zip(*(member.domain.size for member in scenes), strict=True)],
        "sequence_length": max(member.frames for member in scenes),
        "default_connectivity_radius": 2.0 * scene.domain.cell,
        "dim": scene.dimension,
        "dt": shared("frame_dt"),
        "vel_mean": statistics.mean[0].tolist(),
        "vel_std": statistics.std[0].tolist(),
        "acc_mean": statistics.mean[1].tolist(),
        "acc_std": statistics.std[1].tolist(),
        # Ours.
        "definition": name,
        "seed": seed,
        "count": len(entries),
        "splits": {split.value: sum(entry.split is split for entry in entries) for split in Split},
        "statistics": {"split": entries[0].split.value, "moving_speed": MOVING_SPEED, **counted},
        "cell": extremes([member.domain.cell for member in scenes]),
        "particles_per_axis": shared("particles_per_axis"),
        "step_fraction": shared("step_fraction"),
        "material": extremes(materials),
        "friction_deg": [min(angles), max(angles)],
        **{key: shared(key) for key in ("floor_friction", "wall_friction", "baffle_friction", "damping")},
        "version": __version__,
    }


def extremes(values: Sequence[Any]) -> Any:
    """The common value of all, else the smallest and the largest of the numbers; for tables, those of each key."""
    if all(value == values[0] for value in values):
        return values[0]
    if all(isinstance(value, dict) for value in values):
        keys = dict.fromkeys(key for value in values for key in value)
        return {key: extremes([value[key] for value in values if key in value]) for key in keys}
    numbers = [value for value in values if isinstance(value, float | int)]
    return [min(numbers), max(numbers)] if numbers else sorted({str(value) for value in values})
