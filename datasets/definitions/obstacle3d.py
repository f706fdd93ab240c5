"""Obstacle3D: the paper's 3D training set, masses of sand thrown at one to three baffles.

The paper gives sizes and numbers, no places and no speeds. Here every flow goes along +x and meets its baffles: they
stand close before the mass, and no mass begins above them. The ranges of the velocity are those of its authors' public
input generator. The test scenes `baffles-2` and `baffles-5` are of other boxes, masses and baffles, so that nothing has
to be held out for them.
"""

from collections.abc import Iterable, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from datasets.definitions.definition import Definition, Split
from datasets.definitions.flow2d import jitter_seed
from datasets.material import Material
from datasets.scene import Baffle, Domain, Mass, Scene

SIZE = 1000
CELLS = 32
"""Cells along each side of the domain of 1 m."""
SIDE_CELLS = (8, 25)
"""Smallest and largest side of a mass in cells: the paper's 0.25 to 0.80 m."""
MOST_PARTICLES = 17_000
PARTICLES_PER_AXIS = 2
HIGHEST_START = 8
"""Largest height of a lifted mass above the floor in cells: below the top of the baffles, so that it meets them."""
SPEED = 3.0
"""Largest initial velocity downstream [m/s]."""
SIDE_SPEED = 0.5
"""Largest component of the initial velocity across the flow, up, down or sideways [m/s]."""
BAFFLE_COUNTS = (1, 2, 3)
"""Repeated along the dataset."""
BAFFLE_WIDTH = (0.10, 0.13)
"""Extent of a baffle in x and in z [m]."""
BAFFLE_HEIGHT = 0.30
GAP = 3 / CELLS
"""Least distance of a baffle from the mass and from other baffles [m]: narrower gaps do not flow as a continuum."""
BAFFLE_RANGE = 0.25
"""How much farther than that a baffle may stand before the mass [m]: what falls over from rest gets there too."""
ROOM_CELLS = 8
"""Cells behind the mass at least: a gap and a baffle."""
TRIES = 20
"""Sets of baffles tried before a mass; then comes another mass."""
SPLIT_PERIOD = 20
"""Of so many scenes, one is for validation and one for the test."""


def draw(stream: np.random.Generator, index: int) -> Scene:
    """A cuboid of random sides, standing or in the air, with a random velocity, and the baffles before it.

    Sides and places of the mass are whole numbers of cells, those of the baffles are continuous. The number of baffles
    follows from `index`.
    """
    count = BAFFLE_COUNTS[index % len(BAFFLE_COUNTS)]
    mass = draw_mass(stream)
    while (baffles := draw_baffles(stream, mass, count)) is None:
        mass = draw_mass(stream)
    return thrown_at(mass, baffles, jitter_seed(stream), length=1.0, duration=0.875)


def thrown_at(mass: Mass, baffles: tuple[Baffle, ...], seed: int, *, length: float, duration: float) -> Scene:
    """The paper's sand and time step in a box `length` [m] long, 1 m high and wide, for `duration` [s]."""
    return Scene(
        domain=Domain(size=(length, 1.0, 1.0), cell=1 / CELLS),
        material=Material(friction_deg=35.0, density=1800.0, young=2.0e6, poisson=0.3),
        masses=(mass,),
        baffles=baffles,
        duration=duration,
        frame_dt=0.0025,
        # Not stated in the paper; `scenes/baffles-2.toml` says why.
        floor_friction=0.43,
        wall_friction=0.43,
        baffle_friction=0.43,
        step_fraction=0.9,
        particles_per_axis=PARTICLES_PER_AXIS,
        seed=seed,
    )


def draw_mass(stream: np.random.Generator) -> Mass:
    """A cuboid with room for a baffle behind it."""
    extents = draw_extents(stream)
    spare = CELLS - extents
    position = stream.integers(0, [spare[0] - ROOM_CELLS, min(spare[1], HIGHEST_START), spare[2]], endpoint=True)
    # Half of the masses stand on the floor.
    position[1] *= stream.integers(2)
    velocity = stream.uniform([0.0, -SIDE_SPEED, -SIDE_SPEED], [SPEED, SIDE_SPEED, SIDE_SPEED])
    return Mass(lower=vector(position / CELLS), size=vector(extents / CELLS), velocity=vector(velocity))


def draw_extents(stream: np.random.Generator) -> NDArray[np.int64]:
    """Sides of a mass in cells, shape [3]: not too many particles, and not too long for a baffle behind it."""
    while True:
        extents = stream.integers(*SIDE_CELLS, 3, endpoint=True)
        if PARTICLES_PER_AXIS**3 * extents.prod() <= MOST_PARTICLES and extents[0] <= CELLS - ROOM_CELLS:
            return extents


def draw_baffles(stream: np.random.Generator, mass: Mass, count: int) -> tuple[Baffle, ...] | None:
    """Baffles downstream of `mass`, the middle of each within its width; None where no room was found for them."""
    nearest = mass.lower[0] + mass.size[0] + GAP
    for _ in range(TRIES):
        baffles = []
        for length, width in stream.uniform(*BAFFLE_WIDTH, (count, 2)):
            x = stream.uniform(nearest, min(nearest + BAFFLE_RANGE, 1.0 - length))
            z = stream.uniform(mass.lower[2], mass.lower[2] + mass.size[2]) - 0.5 * width
            z = min(max(z, 0.0), 1.0 - width)
            baffles.append(Baffle(lower=vector((x, 0.0, z)), size=vector((length, BAFFLE_HEIGHT, width))))
        if apart(baffles):
            return tuple(baffles)
    return None


def apart(baffles: Sequence[Baffle]) -> bool:
    """Whether baffles keep their distance from each other, along x or along z."""
    return all(max(distance(a, b, axis) for axis in (0, 2)) >= GAP for a, b in combinations(baffles, 2))


def distance(a: Baffle, b: Baffle, axis: int) -> float:
    """Distance of two boxes along one axis [m], negative where they overlap."""
    return max(a.lower[axis] - b.lower[axis] - b.size[axis], b.lower[axis] - a.lower[axis] - a.size[axis])


def vector(values: Iterable[float]) -> tuple[float, float, float]:
    """Three numbers of NumPy as plain floats."""
    x, y, z = (float(value) for value in values)
    return x, y, z


def split(index: int) -> Split:
    """900 scenes for training, 50 for validation, 50 for the test."""
    return {1: Split.VALID, 2: Split.TEST}.get(index % SPLIT_PERIOD, Split.TRAIN)


OBSTACLE3D = Definition(name="obstacle3d", size=SIZE, connectivity_radius=0.030, split=split, draw=draw)
