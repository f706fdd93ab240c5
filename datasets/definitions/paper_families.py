"""columns2d and baffles3d: what the paper inverts, columns, layers with velocities and masses thrown at baffles.

`columns2d` has the sand, floor, walls and damping of the paper's 2D problems, `baffles3d` those of its 3D ones
(datasets/scenes/column-short-21.toml and baffles-2.toml say which of them it does not state), at other shapes, sizes,
friction angles and velocities than its own; scenes next to those that ship are held out (`held_out`).
"""

import dataclasses
from functools import wraps
from typing import Any

import numpy as np

from datasets.definitions import flow2d, obstacle3d
from datasets.definitions.definition import Kind, Storage, Stream, family, flow, log_uniform
from datasets.scene import Domain, Mass, Scene
from datasets.scene.material import Material

AREAS = (0.05, 0.14)
"""Released in a scene of columns2d [m^2]: the paper's columns have 0.08, its layers 0.1."""
ASPECTS = (0.4, 2.5)
FRICTION_DEG = (12.0, 52.0)
SAND = Material(friction_deg=30.0, density=1800.0, young=2.0e6, poisson=0.3, cohesion=100.0, tension_cutoff=50.0)
SURFACES = {"floor_friction": 0.385, "wall_friction": 0.385, "damping": 0.12}
SPEED = 2.0
"""Largest velocity of a layer [m/s]."""
LAYERS = (2, 10)
CELL = 0.005

FRICTION_DEG_3D = (25.0, 42.0)
CELLS_3D = (1 / 48, 1 / 60)
"""Edges of the grid's cells of baffles3d [m], each as likely."""


def column(stream: Stream) -> Scene:
    """A column that is let go at the left wall."""
    return scene(stream, (Mass(lower=(0.0, 0.0), size=size(stream)),))


def layers(stream: Stream) -> Scene:
    """A column of layers, each with a velocity of its own: rising or falling evenly, or drawn one by one."""
    length, height = size(stream)
    count = int(stream.integers(*LAYERS, endpoint=True))
    edges = height * np.linspace(0.0, 1.0, count + 1)
    first, last = stream.uniform(0.0, SPEED, 2).tolist()
    even = np.linspace(first, last, count)
    velocities = even if stream.random() < 0.5 else stream.uniform(0.0, SPEED, count)
    return scene(stream, flow2d.stacked(0.0, length, edges, velocities.tolist()))


def block(stream: Stream) -> Scene:
    """A block that is thrown from somewhere in the left half of the box, as in the paper's training set."""
    extent = size(stream)
    lower = (float(stream.uniform(0.0, 0.4)), float(stream.uniform(0.0, 0.3)) * float(stream.random() < 0.5))
    velocity = (float(stream.uniform(-1.0, SPEED)), float(stream.uniform(-1.0, 1.0)))
    return scene(stream, (Mass(lower=lower, size=extent, velocity=velocity),))


def size(stream: Stream) -> tuple[float, float]:
    """Length and height [m] of a mass."""
    return flow2d.pile(stream, ASPECTS, log_uniform(stream, *AREAS))


def scene(stream: Stream, masses: tuple[Mass, ...]) -> Scene:
    """Masses of the paper's sand in the box of its 2D problems, longer where they are fast or large, for 1.2 s."""
    domain = Domain(size=(float(stream.choice([1.0, 1.4])), 1.0), cell=CELL)
    sand = dataclasses.replace(SAND, friction_deg=float(stream.uniform(*FRICTION_DEG)))
    return flow(stream, domain=domain, material=sand, masses=masses, duration=1.2, **SURFACES)


def as_paper(kind: Kind) -> Kind:
    """Scenes of a kind with the paper's dry sand and friction of floor, walls and baffles, undamped; on other cells."""

    @wraps(kind)
    def draw(stream: Stream) -> Scene:
        drawn, cell = kind(stream), float(stream.choice(CELLS_3D))
        friction_deg = float(stream.uniform(*FRICTION_DEG_3D))
        extent = tuple(cell * float(np.ceil(each / cell - 1e-6)) for each in drawn.domain.size)
        dry = dataclasses.replace(drawn.material, friction_deg=friction_deg, cohesion=0.0, tension_cutoff=0.0)
        changes: dict[str, Any] = {"domain": Domain(size=extent, cell=cell), "material": dry, "damping": 0.0}
        changes |= {"floor_friction": 0.43, "wall_friction": 0.43, "baffle_friction": 0.43 if drawn.baffles else 0.0}
        return dataclasses.replace(drawn, **changes)

    return draw


COLUMNS: tuple[Kind, ...] = (column, layers, column, layers, block)
BAFFLES: tuple[Kind, ...] = tuple(map(as_paper, (obstacle3d.slab, obstacle3d.tower, obstacle3d.slab, obstacle3d.row)))
"""Repeated along columns2d and baffles3d."""
COLUMNS2D = family("columns2d", kinds=COLUMNS, variant=flow2d.variant, size=600, storage=Storage(cell=CELL, kept=1))
BAFFLES3D = family("baffles3d", kinds=BAFFLES, variant=obstacle3d.variant, size=600, storage=obstacle3d.STORAGE)
