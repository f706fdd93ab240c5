"""Releases2D: piles let go from rest, our own addition to the paper's Flow2D.

Flow2D's squares arrive with a velocity. To a learned simulator, which sees positions and velocities but no stress, a
column that has just been released and a pile that has settled look alike; trained on moving squares alone it answers
with perfect support and the column stands. These scenes show how sand of many shapes starts to move.
"""

from enum import Enum, auto

import numpy as np

from datasets.definitions.definition import Definition, Split
from datasets.definitions.flow2d import CELLS, box_scene, jitter_seed, metres
from datasets.scene import Mass, Scene

SIZE = 1200
LENGTH_CELLS = (10, 45)
"""Shortest and longest pile in cells."""
HEIGHT_CELLS = (8, 50)
"""Lowest and highest column of a pile in cells."""
AREA = (0.02, 0.12)
"""Smallest and largest area of a pile [m^2]."""
MOST_COLUMNS = 3
THINNEST = 3
"""Least length of one column in cells: thinner layers do not flow as a continuum on the grid."""
MINIMUM_STEP = 3
"""Least difference in height between neighbouring columns in cells: a staircase must not pass for a box."""
CLEARANCE = 5
"""Least distance of a free-standing pile from the walls in cells."""
FRICTION_DEG = (15.0, 45.0)

PAPER_COLUMNS = ((0.4, 0.2), (0.2, 0.4))
"""Length and height [m] of the columns that the inversion is tested on."""
PAPER_MARGIN = 0.03
"""How far [m] a box must stay from them in length or in height."""
HELD_OUT_ASPECTS = (0.5, 0.8, 1.0, 2.0, 3.0)
"""Height over length of columns kept for tests of generalisation."""
ASPECT_MARGIN = 0.04
"""How far, relatively, a box must stay from them."""
HELD_OUT_AREA = (0.06, 0.10)
"""Areas [m^2] that these tests use."""


class Position(Enum):
    """Where a pile stands."""

    LEFT_WALL = auto()
    RIGHT_WALL = auto()
    FREE = auto()


POSITIONS = (
    Position.LEFT_WALL,
    Position.LEFT_WALL,
    Position.FREE,
    Position.LEFT_WALL,
    Position.RIGHT_WALL,
    Position.FREE,
)
"""Repeated along the dataset: half of the piles lean on the left wall, and the held-out scenes meet both kinds."""
SPLIT_PERIOD = 20
"""Of so many scenes, one is for validation and one for the test."""


def draw(stream: np.random.Generator, index: int) -> Scene:
    """One to three touching columns of different heights, at rest on the floor; lengths are whole numbers of cells."""
    position = POSITIONS[index % len(POSITIONS)]
    lengths, heights = draw_staircase(stream)
    while not acceptable(lengths, heights, position):
        lengths, heights = draw_staircase(stream)
    space = CELLS - sum(lengths)
    match position:
        case Position.LEFT_WALL:
            start = 0
        case Position.RIGHT_WALL:
            start = space
        case Position.FREE:
            start = int(stream.integers(CLEARANCE, space - CLEARANCE + 1))
    edges = np.cumsum([start, *lengths])
    masses = tuple(
        Mass(lower=(metres(int(edge)), 0.0), size=(metres(length), metres(height)))
        for edge, length, height in zip(edges[:-1], lengths, heights, strict=True)
    )
    return box_scene(friction_deg=float(stream.uniform(*FRICTION_DEG)), masses=masses, seed=jitter_seed(stream))


def draw_staircase(stream: np.random.Generator) -> tuple[list[int], list[int]]:
    """Lengths and heights in cells of one to three columns."""
    columns = int(stream.integers(1, MOST_COLUMNS + 1))
    total = int(stream.integers(LENGTH_CELLS[0], LENGTH_CELLS[1] + 1))
    # What is left after every column has its least length is cut at random.
    spare = total - columns * THINNEST
    cuts = np.sort(stream.integers(0, spare + 1, columns - 1))
    lengths = THINNEST + np.diff([0, *cuts, spare])
    heights = stream.integers(HEIGHT_CELLS[0], HEIGHT_CELLS[1] + 1, columns)
    return [int(length) for length in lengths], [int(height) for height in heights]


def acceptable(lengths: list[int], heights: list[int], position: Position) -> bool:
    """Whether a pile has a permitted area, steps that are steps, and is no test scenario."""
    area = sum(metres(length) * metres(height) for length, height in zip(lengths, heights, strict=True))
    steps = np.abs(np.diff(heights))
    single = len(lengths) == 1
    return (
        AREA[0] <= area <= AREA[1]
        and bool(np.all(steps >= MINIMUM_STEP))
        and not (single and position is not Position.FREE and held_out(metres(lengths[0]), metres(heights[0])))
    )


def held_out(length: float, height: float) -> bool:
    """Whether a box [m] at a wall is kept for tests: near a column of the paper, or of a held-out aspect and area."""
    # Lengths are whole cells: a tenth of a cell of slack decides the edge of the margin, not the last bit of a float.
    slack = 0.1 * metres(1)
    near_paper = any(
        max(abs(length - other_length), abs(height - other_height)) <= PAPER_MARGIN + slack
        for other_length, other_height in PAPER_COLUMNS
    )
    aspect = height / length
    near_aspect = any(abs(aspect / other - 1.0) <= ASPECT_MARGIN for other in HELD_OUT_ASPECTS)
    return near_paper or (near_aspect and HELD_OUT_AREA[0] <= length * height <= HELD_OUT_AREA[1])


def split(index: int) -> Split:
    """1,080 scenes for training, 60 for validation, 60 for the test."""
    return {1: Split.VALID, 2: Split.TEST}.get(index % SPLIT_PERIOD, Split.TRAIN)


RELEASES2D = Definition(name="releases2d", size=SIZE, connectivity_radius=0.020, split=split, draw=draw)
