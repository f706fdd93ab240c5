"""The start of a rollout, from a scene at time 0 or the end of the MPM's first frames, and the flow's surroundings."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets import memory
from datasets.definitions.training import thin
from datasets.errors import InputError, require
from datasets.flow.trajectory import Floats, Trajectory, brackets
from datasets.geometry.ground import ground_raster, turbulence_raster
from datasets.scene import INFLOW, Scene, coefficient, keyed
from datasets.scene.material import MOHR_COULOMB
from datasets.scene.particles import initial_particles, mass_counts, released_volume
from gns.settings import ModelSettings
from gns.surroundings.state import Conditions, Ground, State, Tensors
from gns.surroundings.units import Units


@dataclass(frozen=True, kw_only=True)
class InitialState(Tensors):
    """The complete start of a rollout. An unknown of an inversion replaces a part of it, differentiably."""

    state: State  # positions and past displacements of the particles
    conditions: Conditions  # material, volumes, box, gravity, baffles
    scene: Scene  # the scene that is rolled out
    step: float  # time that one step of the model spans [s]
    steps: int  # steps to the end of the scene
    known: Floats  # positions one step apart from time 0 to the start of the rollout [m], shape [F, n, D]
    velocity0: Floats  # velocities at time 0 [m/s], shape [n, D]
    indices: NDArray[np.int64]  # indices of the particles among all of the scene's, shape [n]

    @property
    def times(self) -> NDArray[np.float64]:
        """Times of the known and the predicted positions [s], shape [F + steps]."""
        return self.step * np.arange(len(self.known) + self.steps, dtype=np.float64)

    @property
    def mass(self) -> NDArray[np.int32]:
        """Index of the scene's mass that each particle belongs to, shape [n]."""
        counts = mass_counts(self.scene)
        return np.repeat(np.arange(len(counts), dtype=np.int32), counts)[self.indices]

    def of_mass(self, mass: int | None) -> Tensor:
        """Whether each particle belongs to `mass` or, for None, to any mass of the scene's shared material; [n]."""
        shared = np.array([body.material is None for body in self.scene.masses])
        return torch.from_numpy(shared[self.mass] if mass is None else self.mass == mass)

    def with_conditions(self, **changes: Any) -> "InitialState":
        """The same state with changed `Conditions`, given by name."""
        return replace(self, conditions=replace(self.conditions, **changes))


def initial_state(scene: Scene, settings: ModelSettings, frames: Trajectory | None = None) -> InitialState:
    """The initial state of `scene` for a model of these settings; the choice of particles is always the same. frames:
    an MPM run of the scene; the rollout begins at its last whole step of the model, by default at time 0. Raises
    InputError for a scene that no such model represents (`check`), and for frames that do not fit."""
    check(scene, settings)
    units = Units.of_model(scene, settings)
    step = units.time * settings.step
    particles = initial_particles(scene)
    observed, velocity0 = (array.astype(np.float32) for array in (particles.positions[None], particles.velocities))
    if frames is not None:
        if frames.positions.shape[1] != observed.shape[1]:
            message = f"expected the {observed.shape[1]} particles of the scene, got {frames.positions.shape[1]}"
            raise InputError(message, where="start", key="positions")
        span, least = float(np.ptp(frames.time)), f"frames over at least one step of the model, {step:.4g} s"
        require(span >= (1.0 - 1.0e-6) * step, "time", least, f"{span:.4g} s", where="start")
        observed, velocity0 = resampled(frames, step), frames.velocity0
    cell, some = units.length * settings.cell, settings.particles_per_cell
    steps, count = scene.duration / step, some * released_volume(scene) / cell**scene.dimension
    instead = f"{count:.3g} particles over {steps:.3g} steps; a shorter time"
    memory.require(4.0 * steps * count * scene.dimension, "a rollout", instead, key="duration")
    kept, volumes = thin(observed[0], particles.volume, cell=cell, kept=some, rng=np.random.default_rng(0))
    observed, velocity0 = observed[:, kept], velocity0[kept]
    history = torch.from_numpy(observed[-settings.history - 1 :])
    return InitialState(
        state=State.observed(history, torch.from_numpy(velocity0), step=step, history=settings.history),
        conditions=conditions_of(scene, cell, particles.friction[kept], particles.cohesion[kept], volumes, units),
        scene=scene,
        step=step,
        steps=max(0, round(scene.duration / step) - len(observed) + 1),
        known=observed,
        velocity0=velocity0,
        indices=kept,
    )


def resampled(frames: Trajectory, step: float) -> Floats:
    """Positions of a run every `step` [s] from its start on, linear in time between its frames [m], shape [F, N, D]."""
    if len(frames.time) == 1:
        return frames.positions
    count = int(frames.time[-1] / step + 1.0e-6) + 1
    before, share = brackets(frames.time, step * np.arange(count, dtype=np.float64))
    between = share[:, None, None].astype(np.float32)
    return np.asarray((1.0 - between) * frames.positions[before] + between * frames.positions[before + 1])


def check(scene: Scene, settings: ModelSettings) -> None:
    """Raise InputError for a scene that no model of these settings represents, with key and expectation."""
    dimension = settings.dimension
    require(scene.dimension == dimension, "", f"a {dimension}D scene, as the model's", f"{scene.dimension}D")
    materials = [scene.material_of(mass) for mass in scene.masses]
    refused = [
        (bool(scene.open_sides), "open_sides", "a closed box"),
        (bool(scene.stages), "stages", "a material that does not change"),
        (any(mass.kind == INFLOW for mass in scene.masses), "masses", "masses present from the start"),
        (any(mass.release is not None for mass in scene.masses), "masses", "masses free from the start"),
        (any(material.saturated for material in materials), "material.saturated", "dry material"),
        (len({material.density for material in materials}) > 1, "masses", "masses of one density"),
        *((material.law != MOHR_COULOMB, "material.law", repr(MOHR_COULOMB)) for material in materials),
    ]
    for place, baffle in keyed(scene, "baffles").items():
        refused.append((baffle.turbulence is not None, f"{place}.turbulence", "only Coulomb friction"))
    for place, solid in keyed(scene, "solids").items():
        refused.append((solid.kind != "terrain", f"{place}.kind", "only baffles and terrain"))
        refused.append((solid.contact != "coulomb", f"{place}.contact", "only Coulomb friction"))
    for bad, key, expected in refused:
        if bad:
            raise InputError(f"expected {expected}, the model supports no other", key=key)


def conditions_of(scene: Scene, spacing: float, friction: Any, cohesion: Any, volume: Any, units: Units) -> Conditions:
    """The conditions of a flow of `scene`; spacing: between two elevations of the ground [m]; others: `Conditions`."""

    def one(values: Any) -> Tensor:
        return torch.from_numpy(np.asarray(values, np.float32)[None])

    ground = None
    if scene.solids:
        elevation, roughness, _ = ground_raster(scene, spacing)
        drag = turbulence_raster(scene, spacing)
        drags = None if drag is None else one(drag)
        ground = Ground(elevation=one(elevation), friction=one(roughness), spacing=spacing, drag=drags)
    # Above a surface rougher than itself, sand shears.
    frictions = scene.floor_friction, scene.wall_friction, *map(scene.friction_of, scene.baffles)
    floor, wall, *rough = (coefficient(surface, 1.0) for surface in frictions)
    lower, extent = (np.array([getattr(box, key) for box in scene.baffles], np.float32) for key in ("lower", "size"))
    turn = np.radians([baffle.turned_deg for baffle in scene.baffles])
    return Conditions(
        friction=torch.as_tensor(friction),
        cohesion=torch.as_tensor(cohesion),
        volume=torch.as_tensor(volume),
        size=one(scene.domain.size),
        gravity=one(scene.gravity_vector),
        floor_friction=one(floor),
        wall_friction=one(wall),
        damping=one(scene.damping),
        baffles=one(np.stack((lower, lower + extent), axis=1)) if scene.baffles else None,
        baffle_turn=one(turn) if turn.any() else None,
        baffle_friction=one(rough) if scene.baffles else None,
        ground=ground,
        units=units,
    )
