"""A made-up trajectory of sand that rests as it should, for checks to find what is wrong once it is spoilt."""

import dataclasses
from typing import Any

import numpy as np

from datasets.material import Material
from datasets.particles import initial_particles
from datasets.scene import Baffle, Domain, Mass, Scene
from datasets.trajectory import Trajectory

FRAMES = 5
SAND = Material(friction_deg=30.0)
BOX = Domain(size=(0.8, 0.4), cell=0.02)
BED = Mass(lower=(0.0, 0.0), size=(0.4, 0.2))
BAFFLE = Baffle(lower=(0.5, 0.0), size=(0.1, 0.2))


def scene_of(*masses: Mass, **changes: Any) -> Scene:
    """Masses in a box, watched for five frames of 0.1 s."""
    settings = {"domain": BOX, "material": SAND, "duration": 0.4, "frame_dt": 0.1, "jitter": 0.0} | changes
    return Scene(masses=masses or (BED,), **settings)


def at_rest(scene: Scene | None = None, **changes: Any) -> Trajectory:
    """Nothing moves: the floor takes the weight, energies stay; `changes` spoil it."""
    scene = scene or scene_of()
    points = initial_particles(scene)
    count, dimension = points.positions.shape
    mass = points.density * points.volume
    time = np.arange(scene.frames) * scene.frame_dt
    weight = mass.sum() * np.array(scene.gravity_vector)
    potential = -float(mass @ (points.positions @ np.array(scene.gravity_vector)))
    summary = {
        "precision": "f64",
        "steps": 1000,
        "energy": {
            "kinetic": [1.0] + [0.0] * (scene.frames - 1),
            "potential": [potential] * scene.frames,
            "elastic": [0.0] * scene.frames,
        },
        "wall_impulse": (time[:, None] * weight).tolist(),
    }
    fields = {
        "positions": np.repeat(points.positions[None].astype(np.float32), scene.frames, axis=0),
        "velocities": np.zeros((scene.frames, count, dimension), np.float32),
        "pressure": np.ones((scene.frames, count), np.float32),
        "plastic_strain": np.zeros((scene.frames, count), np.float32),
        "solid_impulse": np.zeros((scene.frames, len(scene.baffles), dimension)) if scene.baffles else None,
    }
    flow = Trajectory(
        time=time,
        velocity0=np.zeros((count, dimension), np.float32),
        friction=points.friction,
        scene=scene,
        summary=summary,
        **fields,  # type: ignore[arg-type]
    )
    return dataclasses.replace(flow, **changes)


def shaped(height: Any, scene: Scene | None = None) -> Trajectory:
    """The bed's particles as a pile of `height(x)` [m] at the end; as dense as before where it has the bed's area."""
    flow = at_rest(scene)
    positions = flow.positions.copy()
    spacing = flow.scene.particle_spacing
    x = np.arange(0.5 * spacing, flow.scene.domain.size[0], spacing)
    columns = [np.arange(0.5 * spacing, height(at), spacing) for at in x]
    pile = np.concatenate([np.stack([np.full(len(y), at), y], axis=1) for at, y in zip(x, columns, strict=True)])
    positions[-1] = pile[np.linspace(0, len(pile) - 1, positions.shape[1]).round().astype(int)]
    return dataclasses.replace(flow, positions=positions)
