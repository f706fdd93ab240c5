"""The initial state of a rollout: a scene at time 0, or the end of the MPM's first frames."""

import dataclasses
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets.errors import InputError
from datasets.geometry.plain import check_plain
from datasets.particles import initial_particles, mass_counts, particle_volumes
from datasets.scene import Scene
from datasets.training.samples import corners, frames_per_step, point_cohesion
from datasets.training.thinning import thin
from datasets.trajectory import Floats, Trajectory
from gns.model.settings import ModelSettings
from gns.model.state import Conditions, State, Tensors

MPM_SECONDS = 0.05
"""Time [s] that the MPM computes where a rollout starts from its frames: a twentieth of a run of one second."""


class Start(StrEnum):
    """Where a rollout of the surrogate begins."""

    FROM_REST = "rest"
    """At time 0: the scene's particles and their initial velocities."""
    FROM_MPM_FRAMES = "frames"
    """At the end of the MPM's first `MPM_SECONDS`, which fill the model's history."""


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
    def start(self) -> Start:
        """Whether MPM frames are known."""
        return Start.FROM_REST if len(self.known) == 1 else Start.FROM_MPM_FRAMES

    @property
    def times(self) -> NDArray[np.float64]:
        """Times of the known positions and of those to come [s], shape [F + steps]."""
        return self.step * np.arange(len(self.known) + self.steps, dtype=np.float64)

    def of_mass(self, mass: int | None) -> Tensor:
        """Whether each particle belongs to `mass`, for None to any mass of the scene's shared material; bool, [n].

        Raises InputError where the particles are not those of the scene's masses.
        """
        counts = mass_counts(self.scene)
        if self.indices.max() >= sum(counts):
            raise InputError(f"expected the {sum(counts)} particles of the scene's masses, there are more")
        index = np.repeat(np.arange(len(counts)), counts)[self.indices]
        shared = np.array([each.material is None for each in self.scene.masses])
        return torch.from_numpy(shared[index] if mass is None else index == mass)

    def with_conditions(self, **changes: Any) -> "InitialState":
        """The same state under other conditions: `friction`, `cohesion`, `volume` or `baffles`, as tensors."""
        return dataclasses.replace(self, conditions=dataclasses.replace(self.conditions, **changes))

    def with_displacements(self, displacements: Tensor) -> "InitialState":
        """The same state with other past displacements [m per step], shape [H, n, D]."""
        return dataclasses.replace(self, state=dataclasses.replace(self.state, displacements=displacements))


def initial_state(
    scene: Scene,
    settings: ModelSettings,
    frames: Trajectory | None = None,
    *,
    seed: int = 0,
) -> InitialState:
    """The initial state of `scene` for a model of these settings.

    frames: a run of the scene by the MPM, whose last frame is where the rollout begins (`first_frames` of a longer
    one); without it the rollout begins at rest, that is at time 0. seed: of the choice of the particles that stay.
    Raises InputError for a scene outside of what the model represents (`check`), and for frames that do not fit.
    """
    check(scene, settings)
    if frames is None:
        particles = initial_particles(scene)
        known = particles.positions[None].astype(np.float32)
        velocity0, friction = particles.velocities.astype(np.float32), particles.friction
    else:
        stride = frames_per_step(frames.scene.frame_dt, settings.step, "start")
        known, velocity0, friction = frames.positions[::stride], frames.velocity0, frames.friction
    volumes = particle_volumes(scene, len(friction))
    rng = np.random.default_rng(seed)
    thinned = thin(known[0], volumes, cell=settings.cell, kept=settings.particles_per_cell, rng=rng)
    kept = thinned.indices
    known, velocity0 = known[:, kept], velocity0[kept]
    history = torch.from_numpy(known[-settings.history - 1 :])
    return InitialState(
        state=State.observed(history, torch.from_numpy(velocity0), step=settings.step, history=settings.history),
        conditions=Conditions(
            friction=torch.from_numpy(friction[kept]),
            cohesion=torch.from_numpy(point_cohesion(scene, len(friction), "")[kept]),
            volume=torch.from_numpy(thinned.volumes),
            size=scene.domain.size,
            gravity=scene.gravity,
            baffles=torch.from_numpy(corners(scene)).unsqueeze(0) if scene.baffles else None,
        ),
        scene=scene,
        step=settings.step,
        steps=max(0, round(scene.duration / settings.step) - len(known) + 1),
        known=known,
        velocity0=velocity0,
        indices=kept,
    )


def first_frames(trajectory: Trajectory, seconds: float = MPM_SECONDS) -> Trajectory:
    """The frames of `trajectory` up to `seconds`, copied, and without the recorded fields."""
    count = round(seconds / trajectory.scene.frame_dt) + 1
    return Trajectory(
        positions=trajectory.positions[:count].copy(),
        time=trajectory.time[:count].copy(),
        velocity0=trajectory.velocity0,
        friction=trajectory.friction,
        scene=trajectory.scene,
    )


def check(scene: Scene, settings: ModelSettings) -> None:
    """Raise InputError for a scene that no model of these settings represents: the key, and what was expected."""
    if scene.dimension != settings.dimension:
        raise InputError(f"expected a {settings.dimension}D scene, as the model's, got {scene.dimension}D")
    check_plain(scene, "the model")
    if scene.baffles and not settings.baffles:
        raise InputError("expected a scene without baffles, the model has none", key="baffles")
    if scene.slope_deg != 0.0:
        raise InputError("expected a level floor, the model has no other", key="slope_deg")
    if any(mass.release is not None for mass in scene.masses):
        raise InputError("expected masses that are free from the start, the model has no barriers", key="masses")
    densities = {scene.material_of(mass).density for mass in scene.masses}
    if len(densities) > 1:
        got = " and ".join(f"{density:g}" for density in sorted(densities))
        raise InputError(f"expected masses of one density, the model has no others, got {got} kg/m^3", key="masses")
