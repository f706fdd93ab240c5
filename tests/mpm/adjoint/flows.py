"""Small flows for the tests of the adjoint, what is observed of them, and central differences."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets import Mass, Material, Scene
from datasets.scene.particles import Particles, initial_particles
from mpm.adjoint.gradient import Gradient, pull_back_all
from mpm.adjoint.tape import FlowAdjoints, Tape
from tests.scenes import scene_of

Floats = NDArray[np.float64]
Change = Callable[[Particles], Particles]

SOIL = Material(friction_deg=30.0, cohesion=500.0, tension_cutoff=300.0)
"""Carries enough tension for a start without stress to be inside the yield surface, where the flow is smooth."""


def boxes(*bodies: tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]) -> tuple[Mass, ...]:
    """Boxes by their lower corner and size [m] and their velocity [m/s]."""
    return tuple(Mass(lower=lower, size=size, velocity=velocity) for lower, size, velocity in bodies)


SLIDING = boxes(((0.0, 0.0), (0.2, 0.2), (1.0, 0.0)), ((0.2, 0.0), (0.1, 0.2), (0.5, -0.3)))
OBLIQUE = boxes(((0.0, 0.0, 0.12), (0.2, 0.2, 0.16), (1.0, 0.0, 0.2)))
ROUGH = {"floor_friction": 0.3, "wall_friction": 0.2}


def plane(material: Material = SOIL, masses: tuple[Mass, ...] = SLIDING, **changes: Any) -> Scene:
    """Two bodies side by side in 2D that slide on a rough floor: 104 steps in 8 frames, unless changed."""
    return scene_of(*masses, material=material, **{"duration": 0.02, **ROUGH, **changes})


def room(material: Material = SOIL, masses: tuple[Mass, ...] = OBLIQUE, **changes: Any) -> Scene:
    """A body in 3D, thrown obliquely along a rough floor: 28 steps in 4 frames, unless changed."""
    size = (0.8, 0.8, 0.8)
    return scene_of(*masses, size=size, cell=0.04, material=material, **{"duration": 0.01, **ROUGH, **changes})


class Weighted:
    """An objective of the end that every position, velocity and impulse of a solid enters with its own weight."""

    def __init__(self, scene: Scene) -> None:
        random = np.random.default_rng(0)
        count = len(initial_particles(scene).positions)
        self.positions = random.normal(size=(1, count, scene.dimension))
        self.velocities = 0.01 * random.normal(size=self.positions.shape)
        solids = len(scene.baffles) + len(scene.solids)
        self.impulses = random.normal(size=(1, solids, scene.dimension)) if solids else None

    def value(self, positions: Floats, velocities: Floats, impulses: Floats | None = None) -> float:
        momentum = 0.0 if impulses is None or self.impulses is None else float((self.impulses * impulses).sum())
        return float((self.positions * positions).sum() + (self.velocities * velocities).sum()) + momentum

    def __call__(self, positions: Floats, velocities: Floats) -> tuple[float, Floats, Floats]:
        return self.value(positions, velocities), self.positions, self.velocities


def tape_of(scene: Scene, change: Change | None = None, *, exact: bool = False) -> Tape:
    """A run in double precision, of particles that `change` moves, observed at its end."""
    particles = initial_particles(scene)
    changed = [particles if change is None else change(particles)]
    return Tape([scene], [scene.frames - 1], threads=1, particles=changed, exact=exact)


def value_of(scene: Scene, objective: Weighted, change: Change | None = None) -> float:
    """The objective of such a run."""
    tape = tape_of(scene, change)
    impulses = None if objective.impulses is None else tape.impulses()
    return objective.value(tape.positions(), tape.velocities(), impulses)


def exact_gradient(scene: Scene, objective: Weighted, change: Change | None = None) -> Gradient:
    """Its gradient, without what keeps that of a long flow bounded."""
    adjoints = FlowAdjoints(objective.positions, objective.velocities, objective.impulses)
    ((slope,),) = pull_back_all(tape_of(scene, change, exact=True), [[adjoints]])
    return slope


def central(function: Callable[[float], float], step: float) -> float:
    """Derivative at 0 by central differences, of the steps from `step` down three in a row that agree best.

    A large step crosses from a piece of the flow to the next (a yield surface, sticking and sliding), a small one
    rounds."""
    steps = step * 10.0 ** -np.arange(0.0, 4.5, 0.5)
    derivatives = np.array([(function(h) - function(-h)) / (2.0 * h) for h in steps])
    threes = np.lib.stride_tricks.sliding_window_view(derivatives, 3)
    return float(np.median(threes[np.argmin(np.ptp(threes, axis=1))]))


def moved(name: str, direction: Floats) -> Callable[[float], Change]:
    """What moves one of the arrays of the particles by h along `direction`."""

    def by(h: float) -> Change:
        return lambda particles: dataclasses.replace(particles, **{name: getattr(particles, name) + h * direction})

    return by


def shaken(particles: Particles) -> Particles:
    """Particles that move at random as well: a rigid flight of sand without stress is at the apex, a corner."""
    random = np.random.default_rng(4).normal(size=particles.velocities.shape)
    return dataclasses.replace(particles, velocities=particles.velocities + 0.1 * random)
