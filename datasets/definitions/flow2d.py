"""Flow2D: the paper's 2D training set, squares of sand thrown into a box."""

import numpy as np

from datasets.definitions.definition import Definition, Split
from datasets.material import Material
from datasets.scene import Domain, Mass, Scene

CELLS = 100
"""Cells along each side of the domain of 1 m."""
FRICTION_DEG = (15.0, 22.5, 30.0, 37.5, 45.0)
PER_FRICTION = 77
SIDE_CELLS = (20, 40)
"""Smallest and largest side of a square in cells."""
SPEED = 2.0
"""Largest component of the initial velocity [m/s]; our choice, the paper gives no range."""
SPLIT_PERIOD = 19
"""Of so many scenes of one angle, one is for validation and one for the test: 4 + 4 of 77."""


def metres(cells: int) -> float:
    """A length in cells as [m]; the quotient is the nearest float to the decimal, a product by 0.01 is not."""
    return cells / CELLS


def box_scene(*, friction_deg: float, masses: tuple[Mass, ...], seed: int) -> Scene:
    """Masses of the paper's sand in the box of its 2D problems, watched for 1 s.

    Friction 0.385 and damping 0.12 stand for settings that the paper does not state: the former is what its authors'
    public input generator writes, the latter does in APIC what their local damping of 0.05 does in a FLIP scheme.
    """
    return Scene(
        domain=Domain(size=(1.0, 1.0), cell=metres(1)),
        material=Material(
            friction_deg=friction_deg, density=1800.0, young=2.0e6, poisson=0.3, cohesion=100.0, tension_cutoff=50.0
        ),
        masses=masses,
        duration=1.0,
        frame_dt=0.0025,
        floor_friction=0.385,
        wall_friction=0.385,
        damping=0.12,
        step_fraction=0.9,
        particles_per_axis=2,
        seed=seed,
    )


def jitter_seed(stream: np.random.Generator) -> int:
    """A seed for the initial jitter of one scene."""
    return int(stream.integers(2**31))


def draw(stream: np.random.Generator, index: int) -> Scene:
    """A square of random side, at a random place and height in the box, with a random velocity.

    Sides and places are whole numbers of cells. The angle of friction follows from `index`, so that the first scenes
    of the dataset are spread over all angles.
    """
    side = int(stream.integers(SIDE_CELLS[0], SIDE_CELLS[1] + 1))
    column, row = (int(cells) for cells in stream.integers(0, CELLS - side + 1, 2))
    horizontal, vertical = (float(speed) for speed in stream.uniform(-SPEED, SPEED, 2))
    square = Mass(
        lower=(metres(column), metres(row)),
        size=(metres(side), metres(side)),
        velocity=(horizontal, vertical),
    )
    return box_scene(friction_deg=FRICTION_DEG[index % len(FRICTION_DEG)], masses=(square,), seed=jitter_seed(stream))


def split(index: int) -> Split:
    """345 scenes for training, 20 for validation, 20 for the test, the same shares at every angle.

    The second and third scene of an angle are already held out, so that a small dataset has all three parts.
    """
    turn = index // len(FRICTION_DEG) % SPLIT_PERIOD
    return {1: Split.VALID, 2: Split.TEST}.get(turn, Split.TRAIN)


FLOW2D = Definition(
    name="flow2d",
    size=len(FRICTION_DEG) * PER_FRICTION,
    connectivity_radius=0.020,
    split=split,
    draw=draw,
)
