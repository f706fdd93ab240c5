"""Columns of dry sand on a rough floor, as experiments let them go: half a column in 2D, a quarter cylinder in 3D.

The planes of symmetry are smooth walls; no column comes near the far ones. Columns differ in their aspect ratio
a = H / L alone: the stiffness goes with the height, E = STIFFNESS rho g H, so lengths and times scale with L and
sqrt(H / g).
"""

import math
from dataclasses import dataclass

import numpy as np

from datasets.material import Material
from datasets.measures import FRONT_QUANTILE, Positions
from datasets.scene import Domain, Mass, Scene

LENGTH = 0.1
"""L, the length of a half column or the radius of a cylinder [m]."""
GRAVITY = 9.81
DENSITY = 1800.0
FRICTION_DEG = 30.0
"""Of the grains and of the floor; sand and glass beads of the experiments have 25 to 32 degrees."""
STIFFNESS = 150.0
"""E / (rho g H): the foot of a column gives by half a per cent."""
STEP = 0.9
FRAME, FRAMES = 0.05, 300
"""A frame in sqrt(H / g); frames of a run that does not come to rest."""
HEADROOM = 1.1
"""Height of the box over that of the column."""
EXTENT = {2: (3.0, 0.8), 3: (3.0, 0.55)}
"""Prefactor and exponent, by dimension, of a runout (d - L) / L that no column comes near: the length of the box."""
SUMMIT = 0.25
"""The deposit's height is measured this near to the axis, in L."""
SUMMIT_QUANTILE = 0.99


def half_column(aspect: float, cells: int, *, friction_deg: float = FRICTION_DEG, seed: int = 0) -> Scene:
    """A column of length L and height `aspect` L against a smooth wall, `cells` across the smaller of both; 2D."""
    mass = Mass(lower=(0.0, 0.0), size=(LENGTH, aspect * LENGTH))
    return column(aspect, across_length(aspect, cells), (mass,), friction_deg, seed)


def quarter_cylinder(aspect: float, cells: int, *, friction_deg: float = FRICTION_DEG, seed: int = 0) -> Scene:
    """A quarter of a cylinder of radius L and height `aspect` L in the corner of two smooth walls, in 3D.

    `cells` as above. Slabs half a cell thick, one layer of particles each, as long as the circle is at their middle, to
    the nearest half cell.
    """
    across = across_length(aspect, cells)
    half = 0.5 * LENGTH / across
    masses = []
    for number in range(2 * across):
        chord = math.sqrt(LENGTH**2 - ((number + 0.5) * half) ** 2)
        size = (max(1, round(chord / half)) * half, aspect * LENGTH, half)
        masses.append(Mass(lower=(0.0, 0.0, number * half), size=size))
    return column(aspect, across, tuple(masses), friction_deg, seed)


def across_length(aspect: float, cells: int) -> int:
    """Cells across L where there are `cells` across the smaller of L and H."""
    return round(cells / min(1.0, aspect))


def column(aspect: float, cells: int, masses: tuple[Mass, ...], friction_deg: float, seed: int) -> Scene:
    """The scene around `masses`, `cells` across L."""
    dimension = len(masses[0].size)
    cell, height = LENGTH / cells, aspect * LENGTH
    factor, exponent = EXTENT[dimension]
    long = math.ceil(cells * (1.5 + factor * aspect**exponent)) * cell
    high = math.ceil(cells * aspect * HEADROOM) * cell
    frame_dt = FRAME * math.sqrt(height / GRAVITY)
    friction = math.tan(math.radians(friction_deg))
    return Scene(
        domain=Domain(size=(long, high) if dimension == 2 else (long, high, long), cell=cell),
        material=Material(
            friction_deg=friction_deg, density=DENSITY, young=STIFFNESS * DENSITY * GRAVITY * height, poisson=0.3
        ),
        masses=masses,
        duration=FRAMES * frame_dt,
        frame_dt=frame_dt,
        gravity=GRAVITY,
        floor_friction=friction,
        wall_friction=0.0,
        step_fraction=STEP,
        seed=seed,
    )


def volume_error(scene: Scene) -> float:
    """Volume of a staircase of slabs over that of the quarter cylinder it stands for, less one [-]."""
    volume = sum(math.prod(mass.size) for mass in scene.masses)
    return volume / (0.25 * math.pi * LENGTH**2 * scene.masses[0].size[1]) - 1.0


@dataclass(frozen=True, kw_only=True)
class Deposit:
    """Front, runout and height in units of L."""

    aspect: float
    front: float
    """(d - L) / L with d the radius that 99.5 % of the particles are within."""
    runout: float
    """The same with the largest radius."""
    height: float
    """h / L at the axis."""
    skew: float
    """In 3D, how much further the front is along the walls than along the diagonal, over its radius [-]; 0 in 2D."""
    rest_time: float | None
    """Over sqrt(H / g); None where the column still moved at the end."""


def measured(aspect: float, positions: Positions, rest_time: float | None) -> Deposit:
    """The deposit in its final `positions` [m], shape [N, D]; `rest_time` [s]."""
    x = positions.astype(np.float64)
    radius = x[:, 0] if x.shape[1] == 2 else np.hypot(x[:, 0], x[:, 2])
    front = float(np.quantile(radius, FRONT_QUANTILE))
    skew = 0.0
    if x.shape[1] == 3:
        # Twelve sectors of the quarter, the outer two on either side against the middle four.
        sector = np.arctan2(x[:, 2], x[:, 0]) / (math.pi / 24.0)
        along = float(np.quantile(radius[(sector < 2.0) | (sector > 10.0)], FRONT_QUANTILE))
        across = float(np.quantile(radius[(sector > 4.0) & (sector < 8.0)], FRONT_QUANTILE))
        skew = (along - across) / front
    return Deposit(
        aspect=aspect,
        front=front / LENGTH - 1.0,
        runout=float(radius.max()) / LENGTH - 1.0,
        height=float(np.quantile(x[radius < SUMMIT * LENGTH, 1], SUMMIT_QUANTILE)) / LENGTH,
        skew=skew,
        rest_time=None if rest_time is None else rest_time / math.sqrt(aspect * LENGTH / GRAVITY),
    )
