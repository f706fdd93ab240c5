"""Where a rollout begins: at a scene's own start, or where the MPM's first frames end."""

import dataclasses
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.geometry.plain import check_plain
from datasets.particles import initial_particles, particle_volumes
from datasets.scene import Scene
from datasets.training.samples import corners, frames_per_step, point_cohesion
from datasets.training.thinning import thin
from datasets.trajectory import Floats, Trajectory
from gns.model.settings import ModelSettings
from gns.model.state import Conditions, State


@dataclass(frozen=True, kw_only=True)
class InitialValueProblem:
    """All that `gns.unroll.unroll` needs, and what is known before."""

    state: State
    """Where the rollout begins."""
    conditions: Conditions
    """What stays as it is."""
    steps: int
    """Steps to the end of the scene."""
    known: Floats
    """Positions one step apart from time 0 to where the rollout begins, that one included [m], shape [F, n, D]."""
    velocity0: Floats
    """Velocities at time 0 [m/s], shape [n, D]."""
    indices: NDArray[np.int64]
    """The points that were kept of all the scene's, shape [n]."""

    def times(self, step: float) -> NDArray[np.float64]:
        """Times of the known positions and of those to come [s], shape [F + steps]."""
        return step * np.arange(len(self.known) + self.steps, dtype=np.float64)

    def to(self, device: torch.device | str) -> "InitialValueProblem":
        """The same problem, state and conditions on another device."""
        state, conditions = self.state, self.conditions
        return dataclasses.replace(
            self,
            state=State(
                positions=state.positions.to(device),
                displacements=state.displacements.to(device),
            ),
            conditions=dataclasses.replace(
                conditions,
                friction=conditions.friction.to(device),
                cohesion=conditions.cohesion.to(device),
                volume=conditions.volume.to(device),
                baffles=None if conditions.baffles is None else conditions.baffles.to(device),
            ),
        )


def at_rest(scene: Scene, settings: ModelSettings, rng: np.random.Generator) -> InitialValueProblem:
    """Begin with the scene itself: its points and their initial velocities. `rng` chooses the points that stay."""
    points = initial_particles(scene)
    return _problem(
        scene,
        points.positions[None].astype(np.float32),
        points.velocities.astype(np.float32),
        points.friction,
        settings,
        rng,
    )


def after_frames(
    start: Trajectory, scene: Scene, settings: ModelSettings, rng: np.random.Generator
) -> InitialValueProblem:
    """Begin at the last whole step of `start`, a run of `scene` that may have ended early. Raises InputError."""
    stride = frames_per_step(start.scene.frame_dt, settings.step, "start")
    frames = start.positions[::stride]
    return _problem(scene, frames, start.velocity0, start.friction, settings, rng)


def check(scene: Scene, settings: ModelSettings) -> None:
    """Raise InputError for a scene that no model with these settings can know: each key with what was expected."""
    if scene.dimension != settings.dimension:
        raise InputError(f"expected a {settings.dimension}D scene, as the model's, got {scene.dimension}D")
    check_plain(scene, "the model")
    if scene.baffles and not settings.baffles:
        raise InputError("expected a scene without baffles, the model knows none", key="baffles")
    if scene.slope_deg != 0.0:
        raise InputError("expected a level floor, the model knows no other", key="slope_deg")
    if any(mass.release is not None for mass in scene.masses):
        raise InputError("expected masses that are free from the start, the model knows no gates", key="masses")
    densities = {scene.material_of(mass).density for mass in scene.masses}
    if len(densities) > 1:
        got = " and ".join(f"{density:g}" for density in sorted(densities))
        raise InputError(f"expected masses of one density, the model knows no others, got {got} kg/m^3", key="masses")


def _problem(
    scene: Scene,
    frames: Floats,
    velocity0: Floats,
    friction: Floats,
    settings: ModelSettings,
    rng: np.random.Generator,
) -> InitialValueProblem:
    check(scene, settings)
    cohesion = point_cohesion(scene, len(friction), "")
    volumes = particle_volumes(scene, len(friction))
    thinned = thin(frames[0], volumes, cell=settings.cell, kept=settings.points_per_cell, rng=rng)
    known, velocity0 = frames[:, thinned.indices], velocity0[thinned.indices]
    return InitialValueProblem(
        state=State.observed(
            torch.from_numpy(known[-settings.history - 1 :]),
            torch.from_numpy(velocity0),
            step=settings.step,
            history=settings.history,
        ),
        conditions=Conditions(
            friction=torch.from_numpy(friction[thinned.indices]),
            cohesion=torch.from_numpy(cohesion[thinned.indices]),
            volume=torch.from_numpy(thinned.volumes),
            size=scene.domain.size,
            gravity=scene.gravity,
            baffles=torch.from_numpy(corners(scene)).unsqueeze(0) if scene.baffles else None,
        ),
        steps=max(0, round(scene.duration / settings.step) - len(known) + 1),
        known=known,
        velocity0=velocity0,
        indices=thinned.indices,
    )
