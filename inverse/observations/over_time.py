"""What is measured while a flow is under way, or beside its deposit: fronts, gauges, forces, outlines.

Between two frames everything is taken to change linearly. The exact forms are of the MPM's runs, the smooth ones of the
surrogate's rollouts; forces it does not tell.
"""

import math
from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets import measures
from datasets.errors import InputError
from datasets.particles import mass_centroids, mass_volumes, particle_volumes, released_volume
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from inverse.observations.deposit import Observation, OfDeposit, Rollout, Values, harrell_davis


class FrontOverTime(Observation):
    """The front, the x that 99.5 % of the particles are behind, at given times."""

    over_time = True

    def __init__(self, times: Values) -> None:
        """times: [s] after the start, shape [M]."""
        self.times = times

    def observe(self, trajectory: Trajectory) -> Values:
        def front(positions: NDArray[np.floating]) -> Values:
            return np.array([measures.front(positions)])

        return at_times(front, trajectory, self.times)[:, 0]

    def predict(self, rollout: Rollout) -> Tensor:
        def front(positions: Tensor) -> Tensor:
            return harrell_davis(positions[:, 0], rollout.volumes, measures.FRONT_QUANTILE).reshape(1)

        return predicted_at_times(front, rollout, self.times)[:, 0]

    def edge(self, values: Values) -> float:
        return math.nan


class Gauges(Observation):
    """The height at gauges, in the end or each at a time of its own: M numbers.

    h_g = sum_i V_i w(x_i - x_g) / int w dx,    w(s) = max(0, 1 - |s| / spacing)

    with V the volumes of the particles: at its initial density, as a profile. In 3D w is also of z where that is given;
    else the height is the mean across the flow.
    """

    def __init__(
        self, scene: Scene, x: Values, *, spacing: float, z: float | None = None, times: Values | None = None
    ) -> None:
        """x: of each number [m], shape [M]; times: of each [s], shape [M], the end where absent; spacing, z: [m]."""
        self.x, self.z, self.spacing, self.times = x, z, spacing, times
        self.over_time = times is not None
        self.area = hat_area(x, spacing, scene.domain.size[0])
        if scene.dimension == 3:
            width = scene.domain.size[2]
            self.area = self.area * (width if z is None else float(hat_area(np.array([z]), spacing, width)[0]))

    def observe(self, trajectory: Trajectory) -> Values:
        scene = trajectory.scene
        volumes = particle_volumes(scene, trajectory.positions.shape[1])
        # Of particles from elsewhere only the mean volume is known, as in a profile.
        volumes = volumes * (released_volume(scene) / volumes.sum())

        def heights(positions: NDArray[np.floating]) -> Values:
            with torch.no_grad():
                return np.asarray(self._heights(torch.from_numpy(positions), torch.from_numpy(volumes)).numpy())

        if self.times is None:
            return heights(trajectory.positions[-1])
        return np.asarray(at_times(heights, trajectory, self.times).diagonal())

    def predict(self, rollout: Rollout) -> Tensor:
        def heights(positions: Tensor) -> Tensor:
            return self._heights(positions, rollout.volumes)

        if self.times is None:
            return heights(rollout.positions[-1])
        return predicted_at_times(heights, rollout, self.times).diagonal()

    def _heights(self, positions: Tensor, volumes: Tensor) -> Tensor:
        away = (positions[:, 0].double()[:, None] - torch.from_numpy(self.x)).abs() / self.spacing
        share = (1.0 - away).clamp(min=0.0)
        if self.z is not None:
            across = (positions[:, 2].double() - self.z).abs() / self.spacing
            share = share * (1.0 - across).clamp(min=0.0)[:, None]
        return (volumes.double() @ share) / torch.from_numpy(self.area)

    def edge(self, values: Values) -> float:
        return math.nan


class Impulse(Observation):
    """The momentum that a solid has taken from the flow along an axis, in the end or at given times.

    In 2D per metre of width. Solids are the baffles, counted from 0, then the others.
    """

    unit = "N s"
    over_time = True
    by_surrogate = False

    def __init__(self, solid: int, axis: int, times: Values | None = None) -> None:
        """times: [s], shape [M]; the end where absent."""
        self.solid, self.axis, self.times = solid, axis, times

    def observe(self, trajectory: Trajectory) -> Values:
        taken = impulse_of(trajectory, self.solid, self.axis)
        if self.times is None:
            return taken[-1:].copy()
        return np.asarray(np.interp(self.times, trajectory.time, taken))

    def predict(self, rollout: Rollout) -> Tensor:
        raise NotImplementedError("the surrogate tells no forces; `by_surrogate` says so")

    def edge(self, values: Values) -> float:
        return math.nan


class PeakForce(Observation):
    """The largest force on a solid along an axis: max_t |I(t + w/2) - I(t - w/2)| / w, w the window, I the impulse.

    In 2D per metre of width.
    """

    unit = "N"
    over_time = True
    by_surrogate = False

    def __init__(self, solid: int, axis: int, window: float) -> None:
        """window: [s]."""
        self.solid, self.axis, self.window = solid, axis, window

    def observe(self, trajectory: Trajectory) -> Values:
        taken, time = impulse_of(trajectory, self.solid, self.axis), trajectory.time
        inner = (time >= time[0] + (0.5 - 1e-9) * self.window) & (time <= time[-1] - (0.5 - 1e-9) * self.window)
        middles = time[inner]
        before, after = (np.interp(middles + side * self.window, time, taken) for side in (-0.5, 0.5))
        return np.array([np.abs(after - before).max(initial=0.0) / self.window])

    def predict(self, rollout: Rollout) -> Tensor:
        raise NotImplementedError("the surrogate tells no forces; `by_surrogate` says so")

    def edge(self, values: Values) -> float:
        return math.nan


class Outline(OfDeposit):
    """How far a deposit in 3D reaches in several directions of the plan, from where its masses began.

    Along a direction n it is the quantile of (p - c) . n over the particles that a front is along x, c the centroid of
    the masses in plan: the support function of the deposit's outline, without the fate of single particles.
    """

    def __init__(self, scene: Scene, directions_deg: Values) -> None:
        """directions_deg: from +x towards +z, shape [M]."""
        turned = np.deg2rad(directions_deg)
        self.directions = np.stack([np.cos(turned), np.sin(turned)])
        volumes = mass_volumes(scene)
        self.centre = (volumes @ mass_centroids(scene) / volumes.sum())[[0, 2]]

    def exact(self, positions: NDArray[np.floating]) -> Values:
        reached = (positions[:, [0, 2]].astype(np.float64) - self.centre) @ self.directions
        return np.asarray(np.quantile(reached, measures.FRONT_QUANTILE, axis=0))

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        reached = (positions[:, [0, 2]].double() - torch.from_numpy(self.centre)) @ torch.from_numpy(self.directions)
        return torch.stack([harrell_davis(each, volumes, measures.FRONT_QUANTILE) for each in reached.T])

    def of_line(self, vertices: NDArray[np.float64]) -> Values:
        """Of a measured outline, vertices x and z [m], shape [V, 2], in any order; shape [M]."""
        return np.asarray(((vertices - self.centre) @ self.directions).max(axis=0))

    def edge(self, values: Values) -> float:
        return math.nan


def hat_area(places: Values, spacing: float, length: float) -> Values:
    """int w of `Gauges` at `places` [m] between the walls 0 and `length` [m], shape as `places`."""
    cut = [0.5 * np.maximum(0.0, spacing - room) ** 2 / spacing for room in (places, length - places)]
    return np.asarray(spacing - cut[0] - cut[1])


def around(time: Values, wanted: Values) -> tuple[NDArray[np.int64], Values]:
    """For each `wanted` time the frame before it and how far on it lies to the next [-], both of shape [M]."""
    wanted = np.clip(wanted, time[0], time[-1])
    before = np.clip(np.searchsorted(time, wanted, side="right") - 1, 0, max(0, len(time) - 2))
    if len(time) == 1:
        return before, np.zeros(len(wanted))
    return before, (wanted - time[before]) / (time[before + 1] - time[before])


def at_times(
    of: Callable[[NDArray[np.floating]], Values], trajectory: Trajectory, times: Values
) -> NDArray[np.float64]:
    """What `of` says of the positions [N, D] at each of `times` [s], linear between frames; shape [times, ...]."""
    before, share = around(trajectory.time, times)
    last = len(trajectory.time) - 1
    seen = {int(each): of(trajectory.positions[each]) for each in {*before, *np.minimum(before + 1, last)}}
    return np.stack(
        [
            (1.0 - part) * seen[int(frame)] + part * seen[min(int(frame) + 1, last)]
            for frame, part in zip(before, share, strict=True)
        ]
    )


def predicted_at_times(of: Callable[[Tensor], Tensor], rollout: Rollout, times: Values) -> Tensor:
    """As `at_times`, differentiable."""
    before, share = around(rollout.times, times)
    last = len(rollout.times) - 1
    seen = {int(each): of(rollout.positions[each]) for each in {*before, *np.minimum(before + 1, last)}}
    return torch.stack(
        [
            (1.0 - part) * seen[int(frame)] + part * seen[min(int(frame) + 1, last)]
            for frame, part in zip(before, share, strict=True)
        ]
    )


def impulse_of(trajectory: Trajectory, solid: int, axis: int) -> Values:
    """Momentum that a solid has taken along an axis, shape [T]. Raises InputError where none was recorded."""
    taken = trajectory.solid_impulse
    if taken is None or solid >= taken.shape[1]:
        raise InputError(f"expected a run that recorded the impulse on solid {solid}, it did not")
    return np.asarray(taken[:, solid, axis])
