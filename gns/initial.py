"""What a rollout begins with: a scene at time 0, or the end of the MPM's first frames; and what is around its flow."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets import memory
from datasets.errors import InputError
from datasets.particles import initial_particles, mass_counts, released_volume
from datasets.scene import Scene
from datasets.training.samples import Surroundings, check_known, thin
from datasets.trajectory import Floats, Trajectory
from gns.settings import ModelSettings
from gns.state import Conditions, Ground, State, Tensors
from gns.units import Units

ABSENT = -10.0
"""Coordinates [m] of a box of zero size that stands for a baffle which a sample does not have, and of ground."""


@dataclass(frozen=True, kw_only=True)
class InitialState(Tensors):
    """All that a rollout begins with. An unknown of an inversion replaces a part of it, differentiably.

    initial = initial_state(scene, simulator.settings)
    positions = unroll(simulator, initial.state, initial.conditions, initial.steps)
    """

    state: State
    """Positions and past displacements of the particles."""
    conditions: Conditions
    """Material, volumes, box, gravity, baffles."""
    scene: Scene
    """The scene that is rolled out."""
    step: float
    """Time that one step of the model spans [s]."""
    steps: int
    """Steps to the end of the scene."""
    known: Floats
    """Positions one step apart from time 0 to the start of the rollout, both included [m], shape [F, n, D]."""
    velocity0: Floats
    """Velocities at time 0 [m/s], shape [n, D]."""
    indices: NDArray[np.int64]
    """Indices of the particles among all of the scene's, shape [n]."""

    @property
    def times(self) -> NDArray[np.float64]:
        """Times of the known positions and of those to come [s], shape [F + steps]."""
        return self.step * np.arange(len(self.known) + self.steps, dtype=np.float64)

    @property
    def mass(self) -> NDArray[np.int32]:
        """Index of the scene's mass that each particle belongs to, shape [n].

        Raises InputError where the particles are not those of the scene's masses.
        """
        counts = mass_counts(self.scene)
        if self.indices.max() >= sum(counts):
            raise InputError(f"expected the {sum(counts)} particles of the scene's masses, there are more")
        return np.repeat(np.arange(len(counts), dtype=np.int32), counts)[self.indices]

    def of_mass(self, mass: int | None) -> Tensor:
        """Whether each particle belongs to `mass`, for None to any mass of the scene's shared material; bool, [n]."""
        shared = np.array([each.material is None for each in self.scene.masses])
        return torch.from_numpy(shared[self.mass] if mass is None else self.mass == mass)

    def with_conditions(self, **changes: Any) -> "InitialState":
        """The same state under other conditions, those of `Conditions` by name."""
        return dataclasses.replace(self, conditions=dataclasses.replace(self.conditions, **changes))


def initial_state(scene: Scene, settings: ModelSettings, frames: Trajectory | None = None) -> InitialState:
    """The initial state of `scene` for a model of these settings; which particles stay is always the same choice.

    frames: a run of the scene by the MPM, whose last frame is where the rollout begins; without it the rollout begins
    at rest, that is at time 0. Raises InputError for a scene outside of what the model represents (`check`), and for
    frames that do not fit.
    """
    check(scene, settings)
    units = Units.of_model(scene, settings)
    step = units.time * settings.step
    particles = initial_particles(scene)
    if frames is None:
        known = particles.positions[None].astype(np.float32)
    else:
        if frames.positions.shape[1] != len(particles.friction):
            message = f"expected the {len(particles.friction)} particles of the scene, got {frames.positions.shape[1]}"
            raise InputError(message, where="start", key="positions")
        known = resampled(frames, step)
    velocity0 = (particles.velocities if frames is None else frames.velocity0).astype(np.float32)
    require_memory(scene, settings, units, step)
    rng = np.random.default_rng(0)
    cell = units.length * settings.cell
    thinned = thin(known[0], particles.volume, cell=cell, kept=settings.particles_per_cell, rng=rng)
    kept = thinned.indices
    known, velocity0 = known[:, kept], velocity0[kept]
    history = torch.from_numpy(known[-settings.history - 1 :])
    return InitialState(
        state=State.observed(history, torch.from_numpy(velocity0), step=step, history=settings.history),
        conditions=conditions_of(
            [Surroundings.of_scene(scene, cell)],
            friction=torch.from_numpy(particles.friction[kept]),
            cohesion=torch.from_numpy(particles.cohesion[kept]),
            volume=torch.from_numpy(thinned.volumes),
            spacing=cell,
            units=units,
        ),
        scene=scene,
        step=step,
        steps=max(0, round(scene.duration / step) - len(known) + 1),
        known=known,
        velocity0=velocity0,
        indices=kept,
    )


def require_memory(scene: Scene, settings: ModelSettings, units: Units, step: float) -> None:
    """Raise InputError for a rollout of more steps than fit into memory: how many, what to change."""
    steps = scene.duration / step
    kept = settings.particles_per_cell * released_volume(scene) / (units.length * settings.cell) ** scene.dimension
    instead = f"{kept:.3g} particles over {steps:.3g} steps; a shorter time"
    memory.require(4.0 * steps * kept * scene.dimension, "a rollout", instead, key="duration")


def resampled(frames: Trajectory, step: float) -> Floats:
    """Positions of a run `step` [s] apart from its start on, between its frames linear in time [m], shape [F, N, D]."""
    times = np.arange(int(frames.time[-1] / step + 1.0e-6) + 1) * step
    right = np.clip(np.searchsorted(frames.time, times), 1, max(1, len(frames.time) - 1))
    if len(frames.time) == 1:
        return frames.positions
    left = right - 1
    share = (times - frames.time[left]) / (frames.time[right] - frames.time[left])
    between = share[:, None, None].astype(np.float32)
    return np.asarray((1.0 - between) * frames.positions[left] + between * frames.positions[right])


def check(scene: Scene, settings: ModelSettings) -> None:
    """Raise InputError for a scene that no model of these settings represents: the key, and what was expected."""
    if scene.dimension != settings.dimension:
        raise InputError(f"expected a {settings.dimension}D scene, as the model's, got {scene.dimension}D")
    check_known(scene, "the model")


def conditions_of(
    around: Sequence[Surroundings],
    *,
    friction: Tensor,
    cohesion: Tensor,
    volume: Tensor,
    spacing: float,
    batch: Tensor | None = None,
    units: Units | None = None,
) -> Conditions:
    """The conditions of one flow, or of several side by side.

    around: what is around each of them; spacing: between two elevations of their ground [m]; the others: see
    `Conditions`. A flow with fewer baffles than another gets boxes of no size far outside, one without terrain ground
    far below, and a smaller raster goes on level.
    """
    numbers = ("size", "gravity", "floor_friction", "wall_friction", "damping")
    parts = {name: joined([getattr(each, name) for each in around]) for name in numbers}
    if count := max(len(each.baffles) for each in around):
        for name, value in (("baffles", ABSENT), ("baffle_friction", 0.0), ("baffle_turn", 0.0)):
            if name != "baffle_turn" or any(each.baffle_turn.any() for each in around):
                parts[name] = joined([padded(getattr(each, name), [count], constant_values=value) for each in around])
    grounds = [each.ground for each in around]
    ground = None
    if shapes := [each[0].shape for each in grounds if each is not None]:
        shape = tuple(map(max, zip(*shapes, strict=True)))
        absent = np.full(shape, ABSENT), np.zeros(shape)
        elevation, roughness = (
            joined([padded((absent if each is None else each)[field], shape, mode="edge") for each in grounds])
            for field in (0, 1)
        )
        ground = Ground(elevation=elevation, friction=roughness, spacing=spacing)
    return Conditions(
        friction=friction, cohesion=cohesion, volume=volume, batch=batch, ground=ground, units=units or Units(), **parts
    )


def joined(values: Sequence[Floats | float]) -> Tensor:
    """Values of the samples, each of one shape, as a tensor whose first axis is that of the samples."""
    return torch.from_numpy(np.stack([np.asarray(each, np.float32) for each in values]))


def padded(values: NDArray[np.floating], shape: Sequence[int], **how: Any) -> NDArray[np.floating]:
    """Values with more behind them along their first axes, up to `shape`; how: see `numpy.pad`."""
    behind = [(0, count - own) for count, own in zip(shape, values.shape, strict=False)]
    return np.pad(values, behind + [(0, 0)] * (values.ndim - len(shape)), **how)
