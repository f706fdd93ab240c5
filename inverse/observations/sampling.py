"""Observations at given times, and what measured positions and times have to be.

Between two frames positions are linear in time: a step of the surrogate may last longer than a flow takes to pass a
gauge, whose height then is far from linear.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets.errors import InputError
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from inverse.observations.measured_profile import check_box
from inverse.observations.observation import Rollout, Values


def brackets(time: Values, times: Values) -> tuple[NDArray[np.int64], Values]:
    """For each of `times` the frame before it and its fraction of the interval to the next, both of shape [M]."""
    times = np.clip(times, time[0], time[-1])
    before = np.clip(np.searchsorted(time, times, side="right") - 1, 0, max(0, len(time) - 2))
    if len(time) == 1:
        return before, np.zeros(len(times))
    return before, (times - time[before]) / (time[before + 1] - time[before])


def at_times(
    operator: Callable[[NDArray[np.floating]], Values], trajectory: Trajectory, times: Values
) -> NDArray[np.float64]:
    """`operator` of the positions [N, D] at each of `times` [s], shape [times, ...]."""
    positions, different, which = trajectory.positions, *np.unique(times, return_inverse=True)
    before, share = brackets(trajectory.time, different)
    after = np.minimum(before + 1, len(trajectory.time) - 1)
    between = zip(before, after, share.astype(positions.dtype), strict=True)
    return np.stack([operator((1.0 - s) * positions[b] + s * positions[a]) for b, a, s in between])[which]


def predicted_at_times(operator: Callable[[Tensor], Tensor], rollout: Rollout, times: Values) -> Tensor:
    """As `at_times`, differentiable."""
    positions, different, which = rollout.positions, *np.unique(times, return_inverse=True)
    before, share = brackets(rollout.times, different)
    after = np.minimum(before + 1, len(rollout.times) - 1)
    between = zip(before.tolist(), after.tolist(), share.tolist(), strict=True)
    values = torch.stack([operator(torch.lerp(positions[b], positions[a], s)) for b, a, s in between])
    return values[torch.from_numpy(which)]


def require_count(values: Values | None, count: int) -> Values | None:
    """`values`, if there are so many. Raises InputError."""
    if values is not None and len(values) != count:
        raise InputError(f"expected {count} numbers, got {len(values)}", key="values")
    return values


def require_inside(x: Values, length: float, path: Path | None = None) -> Values:
    """`x` [m], if they lie in the box of `length` [m]. Raises InputError, which names the file `path`."""
    try:
        check_box(x, length)
    except InputError as error:
        raise (error if path is None else error.at(str(path))) from None
    return x


def require_times(times: Values, scene: Scene, path: Path | None = None) -> Values:
    """`times` [s], if the scene lasts for them. Raises InputError, which names the file `path`."""
    if not np.all((times >= 0.0) & (times <= scene.duration * (1.0 + 1e-9))):
        got = times[(times < 0.0) | (times > scene.duration)][0]
        message = f"expected times in [0, {scene.duration:g}] s, which the scene lasts, got {got:g}"
        raise InputError(message, where="" if path is None else str(path), key="" if path else "times")
    return times
