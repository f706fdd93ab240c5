"""flow2d: the training set of the shipped 2D surrogate, ten kinds of flows of fine truth.

Every scene releases about `AREA` of material, over terrain down to six tenths of it: a surrogate scales a scene to that
size, so that one serves a flume and a hillside. The MPM computes it on cells of `CELL`, 57 across the
length of the body, where its own error is about a per cent; what is stored is one particle of each cell, with the
volume of all in it. Sand is rigid at this size (E = 200 rho g l; twice as much moves fronts by 0.3 %). Layers of other
sand than the scene's turn with it in variants, so that single ones leave `FRICTION_DEG`.
"""

import dataclasses
from collections.abc import Iterable
from itertools import repeat
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.definitions.definition import Kind, Storage, Stream, family, flow, log_uniform, usually
from datasets.errors import InputError
from datasets.scene import Baffle, Domain, Mass, Scene, Solid
from datasets.scene.material import Material

AREA = 0.08
"""Released in every scene [m^2]."""
CELL = 0.005
"""Of the MPM's grid [m]."""
SAND = Material(friction_deg=30.0, density=1800.0, young=1.0e6, poisson=0.3)
FRICTION_DEG = (12.0, 48.0)
COHESION = (30.0, 3000.0)
"""Range of the cohesion [Pa] where there is any: 0.006 to 0.6 of the body's weight per length."""
CUTOFF_SHARE = 0.5
"""Tension cutoff over cohesion, as in the paper."""
ASPECT = (0.3, 8.0)
SPEED = 2.5
"""Largest initial velocity of a thrown mass along x [m/s]: 1.5 times that of free fall through the body's length."""
LAYERS = (2, 10)


def variant(stream: Stream, scene: Scene) -> Scene:
    """The scene, particles included, with another friction angle, velocity, cohesion or place of a baffle."""
    change = stream.random()
    if scene.baffles and change < 0.5:
        first = scene.baffles[0]
        nearest = max(mass.lower[0] + mass.size[0] for mass in scene.masses) + 0.01
        x = max(first.lower[0] - float(stream.uniform(0.01, 0.04)), nearest)
        moved = dataclasses.replace(first, lower=(x, *first.lower[1:]))
        return dataclasses.replace(scene, baffles=(moved, *scene.baffles[1:]))
    if change < 0.5 and any(mass.velocity for mass in scene.masses):
        masses = tuple(
            dataclasses.replace(mass, velocity=(v[0] + float(stream.normal(0.0, 0.3)), *v[1:]))
            for mass in scene.masses
            if (v := mass.velocity)
        )
        return dataclasses.replace(scene, masses=masses)
    if change > 0.85 and scene.material.cohesion > 0.0:
        factor = float(np.exp(stream.choice([-1.0, 1.0]) * stream.uniform(0.3, 1.0)))
        return stronger(scene, factor=factor)
    turn = float(stream.uniform(2.0, 5.0)) * (1.0 if scene.material.friction_deg < 30.0 else -1.0)
    return stronger(scene, turn=turn)


def stronger(scene: Scene, *, turn: float = 0.0, factor: float = 1.0) -> Scene:
    """The scene with every material of it turned by an angle of friction [deg] and its cohesion times a factor."""

    def changed(sand: Material) -> Material:
        cohesion, angle = factor * sand.cohesion, sand.friction_deg + turn
        cutoff = CUTOFF_SHARE * cohesion
        return dataclasses.replace(sand, friction_deg=angle, cohesion=cohesion, tension_cutoff=cutoff)

    masses = tuple(
        dataclasses.replace(mass, material=changed(mass.material)) if mass.material else mass for mass in scene.masses
    )
    return dataclasses.replace(scene, masses=masses, material=changed(scene.material))


def column(stream: Stream) -> Scene:
    """A column that is let go, at a wall of the box or away from both."""
    return released(stream, [pile(stream)])


def staircase(stream: Stream) -> Scene:
    """Two or three columns of different heights side by side, let go; InputError where one is too thin."""
    count = int(stream.integers(2, 4))
    lengths, heights = stream.dirichlet(np.full(count, 4.0)), np.exp(stream.normal(0.0, 0.6, count))
    piles = [(float(a), float(b)) for a, b in zip(lengths, heights, strict=True)]
    factor = float(np.sqrt(AREA / sum(length * height for length, height in piles)))
    sizes = [(factor * length, factor * height) for length, height in piles]
    if min(map(min, sizes)) < 0.05 or max(height for _, height in sizes) > 0.85:
        raise InputError("expected columns of at least 0.05 m")
    return released(stream, sizes)


def layers(stream: Stream) -> Scene:
    """A column of layers that differ in friction, cohesion and, in two of three scenes, in velocity."""
    length, height = pile(stream, (0.4, 2.5))
    count = int(stream.integers(*LAYERS, endpoint=True))
    edges = height * np.concatenate(([0.0], np.cumsum(stream.dirichlet(np.full(count, 3.0)))))
    motion = stream.integers(3)
    first, last = stream.uniform(-2.0, 2.0, 2).tolist()
    velocities = ([None] * count, np.linspace(first, last, count), stream.uniform(-2.0, 2.0, count))[motion]
    differ = stream.random() < 0.6
    shared = sand(stream)
    width = box_length(stream)
    left = start(stream, length, width)
    masses = stacked(left, length, edges, velocities, [sand(stream) if differ else None for _ in range(count)])
    return scene(stream, masses=masses, material=shared, width=width)


def thrown(stream: Stream) -> Scene:
    """One or two blocks that are thrown or dropped."""
    shares = AREA * stream.dirichlet(np.full(int(stream.integers(1, 3)), 6.0))
    width, masses = box_length(stream), []
    left = float(stream.uniform(0.0, 0.3))
    for share in shares:
        size = pile(stream, (0.4, 2.5), share)
        bottom = float(stream.uniform(0.0, 0.3)) * float(stream.random() < 0.6)
        velocity = (float(stream.uniform(-0.4, 1.0)) * SPEED, float(stream.uniform(-1.0, 0.7)))
        masses.append(Mass(lower=(left, bottom), size=size, velocity=velocity))
        left += size[0] + float(stream.uniform(0.02, 0.3))
    return scene(stream, masses=tuple(masses), width=width)


def slope(stream: Stream) -> Scene:
    """A column or a block that is let go, or thrown, on a slope."""
    length, height = pile(stream, (0.3, 3.0))
    width = box_length(stream, longer=True)
    left = float(stream.uniform(0.0, 0.25)) * float(stream.random() < 0.7)
    velocity = (float(stream.uniform(0.0, 1.5)), 0.0) if stream.random() < 0.3 else None
    mass = Mass(lower=(left, 0.0), size=(length, height), velocity=velocity)
    degrees = float(stream.uniform(3.0, 32.0)) * float(stream.choice([1.0, 1.0, 1.0, -1.0]))
    return scene(stream, masses=(mass,), width=width, slope_deg=degrees)


def terrain(stream: Stream) -> Scene:
    """A column on a plateau, or a layer on the upper slope, above a broken line of ground."""
    width = box_length(stream, longer=True)
    plateau = float(stream.uniform(0.1, 0.4))
    angle = np.radians(stream.uniform(10.0, 45.0))
    fall = float(stream.uniform(0.08, 0.4))
    foot = plateau + fall / float(np.tan(angle))
    rough = float(stream.uniform(0.0, 0.04))
    base = float(stream.uniform(0.03, 0.08))
    inner = np.sort(stream.uniform(plateau, foot, int(stream.integers(0, 3))))
    rise = float(stream.uniform(-0.02, 0.15))
    points = [(0.0, base + fall), (plateau, base + fall)]
    for x in inner.tolist():
        points += [(x, base + fall * (foot - x) / (foot - plateau) + float(stream.uniform(-rough, rough)))]
    points += [(foot, base), (max(width, foot + 0.1), base + rise * float(stream.random() < 0.4))]
    friction = floor(stream)
    ground = Solid(kind="terrain", points=tuple(points), friction=friction)
    if stream.random() < 0.6:
        length = float(stream.uniform(0.5, 1.0)) * plateau
        mass = Mass(lower=(0.0, base + fall), size=(length, min(AREA / length, 0.7)))
    else:
        length = float(stream.uniform(0.3, 0.8)) * foot
        mass = Mass(kind="layer", thickness=min(AREA / length, 0.3), outline=((0.0,), (length,)))
    return scene(stream, masses=(mass,), width=width, solids=(ground,), floor_friction=friction)


def baffles(stream: Stream) -> Scene:
    """A column that is let go, or a block that is thrown, against one to three baffles."""
    length, height = pile(stream, (0.4, 3.0))
    width = box_length(stream)
    left = float(stream.uniform(0.0, 0.2)) * float(stream.random() < 0.3)
    x, obstacles = left + length, []
    for _ in range(int(stream.integers(1, 4))):
        x += float(stream.uniform(0.04, 0.35))
        size = (float(stream.uniform(0.02, 0.12)), log_uniform(stream, 0.03, 0.3))
        if x + size[0] > width - 0.02:
            break
        obstacles.append(Baffle(lower=(x, 0.0), size=size))
        x += size[0]
    velocity = (float(stream.uniform(0.0, 2.0)), 0.0) if stream.random() < 0.4 else None
    mass = Mass(lower=(left, 0.0), size=(length, height), velocity=velocity)
    return scene(stream, masses=(mass,), width=width, baffles=tuple(obstacles))


KINDS: tuple[Kind, ...] = (column, layers, column, thrown, slope, staircase, column, baffles, layers, terrain)
"""Repeated along the dataset."""


def released(stream: Stream, piles: list[tuple[float, float]]) -> Scene:
    """Columns of these lengths and heights [m] side by side, at rest."""
    width = box_length(stream)
    left = start(stream, sum(length for length, _ in piles), width)
    masses = []
    for length, height in piles:
        masses.append(Mass(lower=(left, 0.0), size=(length, height)))
        left += length
    return scene(stream, masses=tuple(masses), width=width)


def stacked(
    left: float,
    length: float,
    edges: NDArray[np.float64],
    velocities: Iterable[float | None],
    sands: Iterable[Material | None] = repeat(None),
) -> tuple[Mass, ...]:
    """Layers between heights [m], each with a velocity along x [m/s], at rest without one, and perhaps its own sand."""
    masses = []
    for low, high, speed, material in zip(edges[:-1], edges[1:], velocities, sands, strict=False):
        size, velocity = (length, float(high - low)), None if speed is None else (float(speed), 0.0)
        masses.append(Mass(lower=(left, float(low)), size=size, velocity=velocity, material=material))
    return tuple(masses)


def pile(stream: Stream, aspects: tuple[float, float] = ASPECT, area: float = AREA) -> tuple[float, float]:
    """Length and height [m] of a column of an area [m^2], of a random aspect."""
    aspect = log_uniform(stream, *aspects)
    return float(np.sqrt(area / aspect)), float(np.sqrt(area * aspect))


def start(stream: Stream, length: float, width: float) -> float:
    """Where a pile begins [m]: half of them lean on the left side, one in six on the right, the others are free."""
    return usually(stream, {0.5: 0.0, 0.667: width - length}, 0.05, width - length - 0.05)


def box_length(stream: Stream, *, longer: bool = False) -> float:
    """Extent of the box along x [m]."""
    return float(stream.choice([1.6, 2.0, 2.6] if longer else [1.0, 1.0, 1.4, 2.0]))


def sand(stream: Stream) -> Material:
    """Two of five dry, one of five with the paper's cohesion, the others with another one."""
    chance = stream.random()
    cohesion = 0.0 if chance < 0.4 else 100.0 if chance < 0.6 else log_uniform(stream, *COHESION)
    friction_deg, cutoff = float(stream.uniform(*FRICTION_DEG)), CUTOFF_SHARE * cohesion
    return dataclasses.replace(SAND, friction_deg=friction_deg, cohesion=cohesion, tension_cutoff=cutoff)


def floor(stream: Stream, usual: float = 0.385) -> float:
    """Coulomb coefficient of the ground [-]; in three of ten that of the paper's scenes."""
    return usually(stream, {0.3: usual}, 0.1, 1.0)


def scene(stream: Stream, *, masses: tuple[Mass, ...], width: float, **keys: Any) -> Scene:
    """The scene of these masses and keys, with random friction of its box and, in half of the scenes, damping."""
    if "material" not in keys:
        keys["material"] = sand(stream)
    damping = usually(stream, {0.5: 0.0, 0.7: 0.12}, 0.02, 0.25)
    wall_friction = usually(stream, {0.3: 0.0, 0.6: 0.385}, 0.0, 0.8)
    tallest = max(mass.lower[1] + mass.size[1] if mass.size else 0.8 for mass in masses)
    if "floor_friction" not in keys:
        keys["floor_friction"] = floor(stream)
    on_baffles = float(stream.uniform(0.0, 0.8)) if keys.get("baffles") else 0.0
    keys["duration"] = 1.2 if damping > 0.0 and "slope_deg" not in keys else 1.5
    keys |= {"wall_friction": wall_friction, "baffle_friction": on_baffles, "damping": damping}
    domain = Domain(size=(width, 1.0 if tallest < 0.9 else 1.4), cell=CELL)
    return flow(stream, domain=domain, masses=masses, **keys)


FLOW2D = family("flow2d", kinds=KINDS, variant=variant, size=800, storage=Storage(cell=CELL, kept=1))
