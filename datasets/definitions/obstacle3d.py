"""obstacle3d: the training set of the shipped 3D surrogate, ten kinds of flows of fine truth.

Every scene releases `VOLUME` of material, as in `flow2d`: a surrogate scales a scene to that size. The
MPM computes it on cells of `CELL`, 19 across the body; what is stored (`STORAGE`) is one particle of each larger cell,
of which a surrogate takes one of about four.
"""

import dataclasses
import math
from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from datasets.definitions import flow2d
from datasets.definitions.definition import Kind, Storage, Stream, family, flow, log_uniform, usually
from datasets.definitions.held_out import boxes
from datasets.errors import InputError
from datasets.scene import Baffle, Domain, Mass, Scene, Solid
from datasets.scene.material import Material

VOLUME = 0.032
"""Released in every scene [m^3]: a body of length 0.32 m."""
CELL = 1 / 60
"""Of the MPM's grid [m]; all boxes are whole numbers of it."""
YOUNG = 0.9e6
"""160 rho g l [Pa]."""
DURATION = 1.2
"""Of a scene that does not rest before [s]: 6.7 times sqrt(l / g)."""
FRICTION_DEG = (15.0, 45.0)
SPEED = 2.4
"""Largest initial velocity of a thrown mass along x [m/s]: that of free fall through 0.9 of the body's length."""
SIDE_SPEED = 0.4
"""Largest component of it across the flow, up, down or sideways [m/s]."""
LENGTHS = (1.2, 1.6, 2.0)
WIDTHS = (0.4, 0.6, 0.8, 1.1)
"""Of the box [m]."""
MOST_BAFFLES = 6
BAFFLE_LENGTH, BAFFLE_WIDTH, BAFFLE_HEIGHT = (0.04, 0.16), (0.04, 0.32), (0.05, 0.35)
"""Extent of a baffle in x, z and y [m], uniform in its logarithm."""
GAP = 3 * CELL
"""Least distance of a baffle from the mass and from other baffles [m]: narrower gaps do not flow as a continuum."""
TURNED, TURN_DEG = 1 / 3, (-45.0, 45.0)
"""Share of the scenes with baffles whose baffles are turned, and by how much [deg]."""
GRID = 0.1
"""Distance between the elevations of a terrain [m]."""
TRIES = 200
"""Draws of a baffle that stands apart from the others."""

Extent = tuple[float, float, float]


def variant(stream: Stream, scene: Scene) -> Scene:
    """The scene with a baffle elsewhere, in half of those that have any, or another friction, velocity or cohesion."""
    if scene.baffles and stream.random() < 0.5:
        number = int(stream.integers(len(scene.baffles)))
        first = scene.baffles[number]
        shift = stream.uniform(0.015, 0.05, 2) * stream.choice([-1.0, 1.0], 2)
        lower = (first.lower[0] + float(shift[0]), first.lower[1], first.lower[2] + float(shift[1]))
        moved = list(scene.baffles)
        moved[number] = dataclasses.replace(first, lower=lower)
        if not apart(scene.masses, moved):
            raise InputError("expected baffles before the mass and apart from each other")
        return dataclasses.replace(scene, baffles=tuple(moved))
    changed = flow2d.variant(stream, dataclasses.replace(scene, baffles=()))
    return dataclasses.replace(changed, baffles=scene.baffles)


def sheet(stream: Stream) -> Scene:
    """A column over the whole width of a narrow channel, let go: nearly plane."""
    width = float(stream.choice(WIDTHS[:3]))
    aspect = log_uniform(stream, 0.3, 4.0)
    length, height = math.sqrt(VOLUME / width / aspect), math.sqrt(VOLUME / width * aspect)
    left = usually(stream, {0.6: 0.0}, 0.05, 0.3)
    return scene(stream, Mass(lower=(left, 0.0, 0.0), size=(length, height, width)), width=width)


def pile(stream: Stream) -> Scene:
    """A box that is let go: in the middle of the floor, at a wall, or in a corner."""
    mass, width = standing(stream, cuboid(stream, (0.3, 4.0), (0.6, 1.7)), 0.5, 0.6)
    return scene(stream, mass, width=width)


def tower(stream: Stream) -> Scene:
    """A block as high as long, standing or in the air, thrown at one to three baffles."""
    return thrown(stream, cuboid(stream, (0.5, 2.0), (0.6, 1.8)), int(stream.integers(1, 4)))


def slab(stream: Stream) -> Scene:
    """A low and wide block thrown down a channel, nearly always at one to `MOST_BAFFLES` baffles."""
    size = cuboid(stream, (0.3, 0.9), (1.3, 4.5))
    return thrown(stream, size, int(stream.integers(1, MOST_BAFFLES + 1)) * int(stream.random() < 0.85))


def row(stream: Stream) -> Scene:
    """A wide slab thrown at one or two rows of like baffles, the second behind the gaps of the first."""
    size = cuboid(stream, (0.4, 0.9), (1.3, 3.5))
    height = log_uniform(stream, 0.08, 0.3)
    edge = (log_uniform(stream, 0.05, 0.14), log_uniform(stream, 0.05, 0.14))
    count = int(stream.integers(2, 4))
    width = roomy(stream, size[2])
    left, z = float(stream.uniform(0.0, 0.2)), aside(stream, size[2], width)
    pitch = float(stream.uniform(0.85, 1.15)) * size[2] / (count - 0.3)
    first = left + size[0] + float(stream.uniform(GAP, 0.3))
    between = edge[0] + float(stream.uniform(0.08, 0.3))
    turned_deg = float(stream.uniform(*TURN_DEG)) if stream.random() < TURNED else 0.0
    baffles = []
    for line, members in enumerate((count, count - 1)[: int(stream.integers(1, 3))]):
        for number in range(members):
            side = z + 0.5 * (size[2] - edge[1]) + pitch * (number - 0.5 * (members - 1))
            lower, extent = (first + line * between, 0.0, side), (edge[0], height, edge[1])
            baffles.append(Baffle(lower=lower, size=extent, turned_deg=turned_deg))
    mass = Mass(lower=(left, 0.0, z), size=size, velocity=throw(stream))
    if not apart((mass,), baffles):
        raise InputError("expected baffles before the mass and apart from each other")
    return scene(stream, mass, width=width, baffles=tuple(baffles))


def dam(stream: Stream) -> Scene:
    """A column at rest that falls onto one to four baffles."""
    mass, width = standing(stream, cuboid(stream, (0.5, 2.5), (0.6, 2.5)), 0.2, 0.4)
    before = obstacles(stream, mass, width, int(stream.integers(1, 5)), distance=0.25)
    return scene(stream, mass, width=width, baffles=before)


def slope(stream: Stream) -> Scene:
    """A box that is let go or thrown on a slope, in half of the scenes above baffles."""
    mass, width = standing(stream, cuboid(stream, (0.3, 2.0), (0.6, 2.5)), 0.25, 0.7)
    if stream.random() < 0.4:
        mass = dataclasses.replace(mass, velocity=throw(stream, 0.6))
    count = int(stream.integers(1, 5)) * int(stream.random() < 0.5)
    degrees = float(stream.uniform(3.0, 30.0))
    below = obstacles(stream, mass, width, count)
    return scene(stream, mass, width=width, length=LENGTHS[-1], slope_deg=degrees, baffles=below)


def terrain(stream: Stream) -> Scene:
    """A layer or a box at the head of a valley, of a ramp with a run-out, or of a slope with bumps, or of all of it."""
    length, width = float(stream.choice(LENGTHS[1:])), float(stream.choice(WIDTHS[1:]))
    x = GRID * np.arange(-1, round(length / GRID) + 3)[:, None]
    z = GRID * np.arange(-1, round(width / GRID) + 3)[None, :]
    plateau = float(stream.uniform(0.2, 0.5)) * float(stream.random() < 0.4)
    foot = plateau + float(stream.uniform(0.4, 1.2))
    fall = float(stream.uniform(0.15, 0.55)) * (foot - plateau)
    ground = fall * np.clip((foot - x) / (foot - plateau), 0.0, 1.0) + 0.0 * z
    if stream.random() < 0.5:
        ground = ground + float(stream.uniform(0.15, 0.6)) * np.abs(z - width * float(stream.uniform(0.4, 0.6)))
    for _ in range(int(stream.integers(0, 4))):
        at, radius = stream.uniform((0.2, 0.0), (length, width)), float(stream.uniform(0.12, 0.3))
        bump = float(stream.uniform(-0.2, 0.3)) * radius
        ground = ground + bump * np.exp(-((x - at[0]) ** 2 + (z - at[1]) ** 2) / (2.0 * (0.5 * radius) ** 2))
    ground = ground - ground.min() + 0.05
    friction = flow2d.floor(stream, 0.43)
    heights = tuple(map(tuple, ground.tolist()))
    solid = Solid(kind="terrain", origin=(-GRID, -GRID), spacing=(GRID, GRID), heights=heights, friction=friction)
    along, across = float(stream.uniform(0.3, 0.6)), min(float(stream.uniform(0.35, 0.8)), width - 0.04)
    left, side = float(stream.uniform(0.02, 0.15)), aside(stream, across, width)
    ends = ((left, side), (left + along, side), (left + along, side + across), (left, side + across))
    velocity = throw(stream, 0.5) if stream.random() < 0.3 else None
    thickness = VOLUME / (along * across)
    mass = Mass(kind="layer", thickness=thickness, outline=ends, velocity=velocity)
    count = int(stream.integers(1, 4)) * int(stream.random() < 0.35)
    box = Mass(lower=(left, 0.0, side), size=(along, 0.1, across))
    level = float(ground[round(min(foot, length - 0.1) / GRID)].min())
    baffles = tuple(
        dataclasses.replace(each, size=(each.size[0], each.size[1] + level, each.size[2]))
        for each in obstacles(stream, box, width, count, length=length)
    )
    extent = {"width": width, "length": length, "height": float(ground.max()) + thickness + 0.15}
    return scene(stream, mass, **extent, baffles=baffles, solids=(solid,), floor_friction=friction)


KINDS: tuple[Kind, ...] = (slab, pile, tower, terrain, dam, slope, row, sheet, slab, tower)
"""Repeated along the dataset."""


def standing(stream: Stream, size: Extent, furthest: float, share: float) -> tuple[Mass, float]:
    """A box of that size [m] on the floor, and the width of its channel [m].

    A share of them stands away from the wall behind, up to `furthest` [m].
    """
    width = roomy(stream, size[2])
    left = float(stream.uniform(0.0, furthest)) * float(stream.random() < share)
    return Mass(lower=(left, 0.0, aside(stream, size[2], width)), size=size), width


def thrown(stream: Stream, size: Extent, count: int) -> Scene:
    """A block of that size [m] thrown at `count` baffles, half of them from the floor."""
    width = roomy(stream, size[2])
    bottom = float(stream.uniform(0.02, 0.2)) * float(stream.random() < 0.5)
    lower = (float(stream.uniform(0.0, 0.2)), bottom, aside(stream, size[2], width))
    mass = Mass(lower=lower, size=size, velocity=throw(stream))
    return scene(stream, mass, width=width, baffles=obstacles(stream, mass, width, count))


def cuboid(stream: Stream, heights: tuple[float, float], widths: tuple[float, float]) -> Extent:
    """Extent [m] of a box of the volume, its height and its width over its length in these ranges."""
    height, width = log_uniform(stream, *heights), log_uniform(stream, *widths)
    length = (VOLUME / (height * width)) ** (1.0 / 3.0)
    if min(length, height * length) < 0.08 or width * length > 1.2:
        raise InputError("expected a box of at least 0.08 m and at most 1.2 m across")
    return length, height * length, width * length


def roomy(stream: Stream, extent: float) -> float:
    """Extent of the box across the flow [m], at least that of a mass."""
    return max(float(stream.choice(WIDTHS[1:])), 0.1 * math.ceil(10.0 * extent))


def aside(stream: Stream, extent: float, width: float) -> float:
    """Where a mass begins across a channel [m]: in the middle, at a wall or anywhere."""
    spare = width - extent
    if spare < 0.0:
        raise InputError("expected a mass within the channel")
    return usually(stream, {0.4: 0.5 * spare, 0.6: 0.0}, 0.0, spare)


def throw(stream: Stream, part: float = 1.0) -> tuple[float, float, float]:
    """An initial velocity [m/s], up to a part of `SPEED`."""
    y, z = stream.uniform(-SIDE_SPEED, SIDE_SPEED, 2)
    return float(stream.uniform(0.0, part * SPEED)), float(y), float(z)


def obstacles(
    stream: Stream, mass: Mass, width: float, count: int, *, distance: float = 0.6, length: float = LENGTHS[0]
) -> tuple[Baffle, ...]:
    """Baffles anywhere across the channel, up to `distance` [m] behind the least gap before the mass."""
    nearest = mass.lower[0] + mass.size[0] + GAP
    is_turned = stream.random() < TURNED
    baffles: list[Baffle] = []
    for _ in range(TRIES):
        if len(baffles) == count:
            return tuple(baffles)
        x_size, y_size, z_size = (log_uniform(stream, *each) for each in (BAFFLE_LENGTH, BAFFLE_HEIGHT, BAFFLE_WIDTH))
        x = float(stream.uniform(nearest, max(min(nearest + distance, length - x_size - 0.02), nearest)))
        z = float(stream.uniform(0.0, max(width - z_size, 0.0)))
        degrees = float(stream.uniform(*TURN_DEG)) if is_turned else 0.0
        another = Baffle(lower=(x, 0.0, z), size=(x_size, y_size, z_size), turned_deg=degrees)
        if apart((mass,), (*baffles, another)):
            baffles.append(another)
    raise InputError("expected room for the baffles")


def apart(masses: tuple[Mass, ...], baffles: Sequence[Baffle]) -> bool:
    """Whether baffles keep `GAP` from each other, along x or z, and stand before the masses."""
    around = boxes(tuple(baffles), 3)
    front = max(mass.lower[0] + mass.size[0] for mass in masses)
    distances = (np.maximum(a[0] - b[1], b[0] - a[1])[[0, 2]].max() for a, b in combinations(around, 2))
    return bool((around[:, 0, 0] >= front + 0.5 * GAP).all()) and all(each >= GAP for each in distances)


def sand(stream: Stream) -> Material:
    """As in `flow2d`: two of five dry, one of five with the paper's cohesion, the others with another one."""
    given = flow2d.sand(stream)
    return dataclasses.replace(given, friction_deg=float(stream.uniform(*FRICTION_DEG)), young=YOUNG)


def scene(stream: Stream, mass: Mass, *, width: float, length: float = 0.0, height: float = 0.0, **keys: Any) -> Scene:
    """The scene of a mass and keys, with random friction of its box and, in two of five scenes, damping.

    Without a `length` the box has a random one beyond mass and baffles, without a `height` room above the mass.
    """
    baffles = keys.get("baffles", ())
    damping = usually(stream, {0.6: 0.0, 0.75: 0.12}, 0.02, 0.25)
    wall_friction = usually(stream, {0.3: 0.0, 0.6: 0.43}, 0.0, 0.8)
    on_baffles = usually(stream, {0.3: 0.43}, 0.0, 0.8)
    front = max([mass.lower[0] + mass.size[0] if mass.size else 0.0, *(boxes(baffles, 3)[:, 1, 0] + 0.1)])
    length = length or float(stream.choice([each for each in LENGTHS if each > front] or LENGTHS[-1:]))
    top = height or max(mass.lower[1] + mass.size[1] + 0.16, 0.48)
    material = sand(stream)
    if "floor_friction" not in keys:
        keys["floor_friction"] = flow2d.floor(stream, 0.43)
    keys |= {"wall_friction": wall_friction, "baffle_friction": on_baffles if baffles else 0.0, "damping": damping}
    domain = Domain(size=tuple(CELL * math.ceil(each / CELL - 1e-6) for each in (length, top, width)), cell=CELL)
    return flow(stream, domain=domain, material=material, masses=(mass,), duration=DURATION, **keys)


STORAGE = Storage(cell=0.02, kept=1)
OBSTACLE3D = family("obstacle3d", kinds=KINDS, variant=variant, size=400, storage=STORAGE)
