"""Layers2D: piles of horizontal layers that move apart, our own addition to the paper's Flow2D.

The inverse problems ask for the velocity, the friction or the cohesion of single layers. Flow2D's squares move as one
and are of one sand but for its angle; here the layers of a pile differ.
"""

from enum import Enum, auto

import numpy as np
from numpy.typing import NDArray

from datasets.definitions.definition import Definition, Split
from datasets.definitions.flow2d import CELLS, box_scene, jitter_seed, metres
from datasets.definitions.releases2d import AREA, CLEARANCE, FRICTION_DEG, LENGTH_CELLS, Position, held_out
from datasets.material import Material
from datasets.scene import Mass, Scene

SIZE = 480
MOST_LAYERS = 10
THINNEST = 2
"""Least thickness of a layer in cells."""
HEIGHT_CELLS = (8, 45)
"""Lowest and highest pile in cells."""
SPEED = 2.0
"""Largest horizontal velocity of a layer [m/s]."""
COHESION = (30.0, 3000.0)
"""Range of the cohesion [Pa] where it is not the paper's 100 Pa."""
CUTOFF_SHARE = 0.5
"""Tension cutoff over cohesion, as in the paper."""
PAPER_LAYERS = (0.35, 0.28)
"""Length and height [m] of the pile of ten layers that the inversion is tested on."""
PAPER_MARGIN = 0.03
"""How far [m] a pile must stay from it in length or in height."""
SPLIT_PERIOD = 20
"""Of so many scenes, one is for validation and one for the test."""


class Motion(Enum):
    """How the layers move at the start."""

    REST = auto()
    SHEAR = auto()
    """From one velocity at the bottom to another at the top."""
    RANDOM = auto()


MOTIONS = (Motion.REST, Motion.SHEAR, Motion.RANDOM)
"""Repeated along the dataset."""


def draw(stream: np.random.Generator, index: int) -> Scene:
    """A pile on the floor, at a wall or free, whose layers have velocities and angles of friction of their own.

    Half of the piles have one angle in all layers; half have the paper's cohesion, half another one.
    """
    length, thicknesses, position = draw_pile(stream)
    while kept_for_tests(length, thicknesses, position):
        length, thicknesses, position = draw_pile(stream)
    space = CELLS - length
    match position:
        case Position.LEFT_WALL:
            start = 0
        case Position.RIGHT_WALL:
            start = space
        case Position.FREE:
            start = int(stream.integers(CLEARANCE, space - CLEARANCE + 1))
    count = len(thicknesses)
    velocities = draw_velocities(stream, MOTIONS[index % len(MOTIONS)], count)
    angles = stream.uniform(*FRICTION_DEG, count if stream.random() < 0.5 else 1)
    cohesion = float(np.exp(stream.uniform(*np.log(COHESION)))) if stream.random() < 0.5 else 100.0
    edges = np.cumsum([0, *thicknesses])
    masses = tuple(
        Mass(
            lower=(metres(start), metres(int(edge))),
            size=(metres(length), metres(thickness)),
            velocity=(float(velocity), 0.0),
            material=sand(float(angle), cohesion),
        )
        for edge, thickness, velocity, angle in zip(
            edges[:-1], thicknesses, velocities, np.broadcast_to(angles, count), strict=True
        )
    )
    return box_scene(friction_deg=float(angles.mean()), masses=masses, seed=jitter_seed(stream))


def sand(friction_deg: float, cohesion: float) -> Material:
    """The paper's sand but for its strength."""
    return Material(
        friction_deg=friction_deg,
        density=1800.0,
        young=2.0e6,
        poisson=0.3,
        cohesion=cohesion,
        tension_cutoff=CUTOFF_SHARE * cohesion,
    )


def draw_pile(stream: np.random.Generator) -> tuple[int, list[int], Position]:
    """Length of a pile, thicknesses of its layers from the floor up [cells], and where it stands."""
    while True:
        length = int(stream.integers(*LENGTH_CELLS, endpoint=True))
        height = int(stream.integers(*HEIGHT_CELLS, endpoint=True))
        if AREA[0] <= metres(length) * metres(height) <= AREA[1]:
            break
    count = int(stream.integers(1, min(MOST_LAYERS, height // THINNEST), endpoint=True))
    # What is left after every layer has its least thickness is cut at random.
    cuts = np.sort(stream.integers(0, height - count * THINNEST + 1, count - 1))
    thicknesses = THINNEST + np.diff([0, *cuts, height - count * THINNEST])
    position = tuple(Position)[int(stream.integers(len(Position)))]
    return length, [int(thickness) for thickness in thicknesses], position


def draw_velocities(stream: np.random.Generator, motion: Motion, count: int) -> NDArray[np.float64]:
    """Horizontal velocities of the layers from the floor up [m/s], shape [count]."""
    match motion:
        case Motion.REST:
            return np.zeros(count)
        case Motion.SHEAR:
            bottom, top = stream.uniform(-SPEED, SPEED, 2)
            return np.linspace(bottom, top, count)
        case Motion.RANDOM:
            return stream.uniform(-SPEED, SPEED, count)


def kept_for_tests(length: int, thicknesses: list[int], position: Position) -> bool:
    """Whether a pile is near the paper's ten layers or near a column that Releases2D keeps for tests."""
    size = np.array([metres(length), metres(sum(thicknesses))])
    near_layers = np.abs(size - PAPER_LAYERS).max() <= PAPER_MARGIN
    return bool(near_layers) or (position is not Position.FREE and held_out(float(size[0]), float(size[1])))


def split(index: int) -> Split:
    """432 scenes for training, 24 for validation, 24 for the test."""
    return {1: Split.VALID, 2: Split.TEST}.get(index % SPLIT_PERIOD, Split.TRAIN)


LAYERS2D = Definition(name="layers2d", size=SIZE, connectivity_radius=0.020, split=split, draw=draw)
