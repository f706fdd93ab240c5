"""Channel3D: Obstacle3D's flows in a box twice as long, our own addition to the paper's training set.

In a box of 1 m every flow soon is at the far wall. Here it runs out: the layer that gets past the baffles thins until
it stops. Baffles are fewer, none at all, or more, and differ more in size. The masses of the first half are
Obstacle3D's; those of the second are low, slabs rather than towers, so that thin fast layers are no exception.
"""

import numpy as np

from datasets.definitions.definition import Definition, Split
from datasets.definitions.flow2d import jitter_seed
from datasets.definitions.obstacle3d import (
    CELLS,
    GAP,
    HIGHEST_START,
    SIDE_SPEED,
    SPEED,
    TRIES,
    apart,
    draw_mass,
    thrown_at,
    vector,
)
from datasets.scene import Baffle, Mass, Scene

SIZE = 480
TOWERS = 240
"""Scenes whose mass is drawn as Obstacle3D's; those after them are slabs."""
SLAB_LENGTH_CELLS = (5, 20)
"""Least and largest extent of a slab along the channel in cells; likewise its height and its width."""
SLAB_HEIGHT_CELLS = (3, 8)
SLAB_WIDTH_CELLS = (8, 32)
LENGTH = 2.0
"""Of the box [m]; it is 1 m high and wide."""
BAFFLE_COUNTS = (0, 1, 2, 3, 4, 5)
"""Repeated along the dataset."""
BAFFLE_WIDTH = (0.10, 0.17)
"""Extent of a baffle in x and in z [m]."""
BAFFLE_HEIGHT = (0.15, 0.35)
BAFFLE_RANGE = 0.6
"""How much farther than the least gap a baffle may stand before the mass [m]."""
SPLIT_PERIOD = 20
"""Of so many scenes, one is for validation and one for the test."""


def draw(stream: np.random.Generator, index: int) -> Scene:
    """A cuboid of random sides with a random velocity downstream, and the baffles before it."""
    count = BAFFLE_COUNTS[index % len(BAFFLE_COUNTS)]
    draw_next = draw_mass if index < TOWERS else draw_slab
    mass = draw_next(stream)
    while (baffles := draw_baffles(stream, mass, count)) is None:
        mass = draw_next(stream)
    return thrown_at(mass, baffles, jitter_seed(stream), length=LENGTH, duration=1.0)


def draw_slab(stream: np.random.Generator) -> Mass:
    """A low cuboid in the first half of the channel, standing or in the air, with a random velocity downstream."""
    smallest, largest = zip(SLAB_LENGTH_CELLS, SLAB_HEIGHT_CELLS, SLAB_WIDTH_CELLS, strict=True)
    extents = stream.integers(smallest, largest, endpoint=True)
    position = stream.integers(0, [CELLS - extents[0], HIGHEST_START, CELLS - extents[2]], endpoint=True)
    # Half of the masses stand on the floor.
    position[1] *= stream.integers(2)
    velocity = stream.uniform([0.0, -SIDE_SPEED, -SIDE_SPEED], [SPEED, SIDE_SPEED, SIDE_SPEED])
    return Mass(lower=vector(position / CELLS), size=vector(extents / CELLS), velocity=vector(velocity))


def draw_baffles(stream: np.random.Generator, mass: Mass, count: int) -> tuple[Baffle, ...] | None:
    """Baffles downstream of `mass`, anywhere across the channel; None where no room was found for them."""
    nearest = mass.lower[0] + mass.size[0] + GAP
    for _ in range(TRIES):
        baffles = []
        for _ in range(count):
            length, width = stream.uniform(*BAFFLE_WIDTH, 2)
            x = stream.uniform(nearest, min(nearest + BAFFLE_RANGE, LENGTH - length))
            z = stream.uniform(0.0, 1.0 - width)
            height = stream.uniform(*BAFFLE_HEIGHT)
            baffles.append(Baffle(lower=vector((x, 0.0, z)), size=vector((length, height, width))))
        if apart(baffles):
            return tuple(baffles)
    return None


def split(index: int) -> Split:
    """432 scenes for training, 24 for validation, 24 for the test."""
    return {1: Split.VALID, 2: Split.TEST}.get(index % SPLIT_PERIOD, Split.TRAIN)


CHANNEL3D = Definition(name="channel3d", size=SIZE, connectivity_radius=0.030, split=split, draw=draw)
