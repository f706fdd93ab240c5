"""Scenes of contact: layers at rest, blocks and sand on inclines, throws at plates, a baffle that is moved."""

import dataclasses
import math

from datasets.geometry.solid import Solid
from datasets.library import read_scene
from datasets.material import Material
from datasets.scene import Baffle, Domain, Mass, Scene

CELL = 0.02
SAND = Material(friction_deg=30.0, density=1500.0, young=1.0e6, poisson=0.3)
GRAVITY = 9.81
DEPTH = 0.2
"""Of a layer [m]."""
WIDTH = {2: 0.4, 3: 0.12}
"""Of a layer in x and, in 3D, z [m], by its dimension."""
BASE_FRICTION = 0.5
"""Coulomb coefficient under blocks and layers [-]."""
SLOPE_DEG = 20.0
"""Of the incline that sand runs down."""
SLOPE_FRICTION = 0.45


def layer(offset: float, *, kind: str, dimension: int, duration: float) -> Scene:
    """A layer between smooth walls on a level surface `offset` cells above a node, unstressed at the start, undamped.

    kind: "baffle", "terrain" or "floor"; the floor is the box's own, at `offset` 0.
    """
    top, width = (0.0 if kind == "floor" else 5.0 + offset) * CELL, WIDTH[dimension]
    deep = (width,) * (dimension - 2)
    origin = (0.0,) * (dimension - 2)
    terrain = Solid(kind="terrain", points=((0.0, top), (0.37 * width, top), (width, top)), friction=BASE_FRICTION)
    return Scene(
        domain=Domain(size=(width, 0.4, *deep), cell=CELL),
        material=SAND,
        masses=(Mass(lower=(0.0, top, *origin), size=(width, DEPTH, *deep)),),
        baffles=(Baffle(lower=(0.0, 0.0, *origin), size=(width, top, *deep)),) if kind == "baffle" else (),
        solids=(terrain,) if kind == "terrain" else (),
        baffle_friction=BASE_FRICTION,
        floor_friction=BASE_FRICTION,
        duration=duration,
        frame_dt=0.01,
        step_fraction=0.9,
    )


def block(slope_deg: float, offset: float) -> Scene:
    """An elastic block slides on a plate in a tilted box from its static state."""
    cell = 0.01
    top = (4.0 + offset) * cell
    return Scene(
        domain=Domain(size=(1.6, 0.2), cell=cell),
        material=Material(young=2.0e6, poisson=0.0, friction_deg=30.0, cohesion=1.0e9, tension_cutoff=1.0e9),
        masses=(Mass(lower=(0.2, top), size=(0.2, 0.1), k0="elastic"),),
        baffles=(Baffle(lower=(0.0, 0.0), size=(1.6, top)),),
        baffle_friction=BASE_FRICTION,
        slope_deg=slope_deg,
        duration=1.0,
        frame_dt=0.01,
    )


def block_acceleration(slope_deg: float) -> float:
    """g (sin theta - mu cos theta) [m/s^2], where that is positive (Coulomb)."""
    theta = math.radians(slope_deg)
    return max(0.0, GRAVITY * (math.sin(theta) - BASE_FRICTION * math.cos(theta)))


def on_incline(cell: float, seed: int) -> tuple[Scene, Scene]:
    """The same sand runs down the floor of a tilted box, and down a polyline in a level one."""
    theta = math.radians(SLOPE_DEG)
    box = ((0.2, 0.0), (0.5, 0.0), (0.5, 0.2), (0.2, 0.2))
    tilted = Scene(
        domain=Domain(size=(2.4, 0.5), cell=cell),
        material=SAND,
        masses=(Mass(lower=box[0], size=(0.3, 0.2)),),
        floor_friction=SLOPE_FRICTION,
        slope_deg=SLOPE_DEG,
        duration=0.8,
        frame_dt=0.01,
        step_fraction=0.9,
        seed=seed,
    )
    # A micrometre above the line, so that rounding leaves no corner below it.
    turned = tuple(level(x, y + 1.0e-6) for x, y in box)
    ends = ((0.0, level(0.0, 0.0)[1] + 0.1 * math.tan(theta)), (2.4, level(0.0, 0.0)[1] - 2.3 * math.tan(theta)))
    slope = dataclasses.replace(
        tilted,
        domain=Domain(size=(2.4, 1.4), cell=cell),
        masses=(Mass(kind="polygon", vertices=turned),),
        solids=(Solid(kind="terrain", points=ends, friction=SLOPE_FRICTION),),
        slope_deg=0.0,
        floor_friction=0.0,
    )
    return tilted, slope


def level(along: float, above: float) -> tuple[float, float]:
    """Coordinates in the level box [m] of a position along and above the incline [m]."""
    theta = math.radians(SLOPE_DEG)
    return (
        0.1 + along * math.cos(theta) + above * math.sin(theta),
        1.0 - along * math.sin(theta) + above * math.cos(theta),
    )


def thrown_at_plate(thickness: float, speed: float) -> Scene:
    """A block of sand thrown at `speed` [m/s] at a plate `thickness` cells thick, a third of a cell off the nodes."""
    return Scene(
        domain=Domain(size=(2.0, 0.6), cell=CELL),
        material=SAND,
        masses=(Mass(lower=(0.2, 0.1), size=(0.2, 0.2), velocity=(speed, 0.0)),),
        baffles=(Baffle(lower=(0.8 + CELL / 3.0, 0.0), size=(thickness * CELL, 0.6)),),
        duration=0.2,
        frame_dt=0.002,
    )


def on_touching_baffles(rise: float) -> Scene:
    """Sand falls on a ground of touching baffles a cell and a half wide, their tops in steps of `rise` cells."""
    edge = 1.5 * CELL
    return Scene(
        domain=Domain(size=(20 * edge, 0.6), cell=CELL),
        material=SAND,
        masses=(Mass(lower=(0.1, 0.24), size=(0.3, 0.2)),),
        baffles=tuple(
            Baffle(lower=(index * edge, 0.0), size=(edge, 0.213 + rise * CELL * (index % 3))) for index in range(20)
        ),
        baffle_friction=0.3,
        duration=1.0,
        frame_dt=0.01,
    )


def retained_bed(offset: float) -> Scene:
    """A bed 0.3 m deep between a smooth wall and a smooth baffle `offset` cells off a node comes to rest."""
    length = 0.4 + offset * CELL
    return Scene(
        domain=Domain(size=(1.0, 0.6), cell=CELL),
        material=Material(friction_deg=30.0),
        masses=(Mass(lower=(0.0, 0.0), size=(length, 0.3)),),
        baffles=(Baffle(lower=(length, 0.0), size=(0.2, 0.5)),),
        damping=0.2,
        step_fraction=0.9,
        frame_dt=0.01,
    )


def against_baffle(offset: float, seed: int) -> Scene:
    """A column runs against a baffle that stands `offset` cells further on."""
    return Scene(
        domain=Domain(size=(1.6, 0.6), cell=CELL),
        material=Material(friction_deg=30.0),
        masses=(Mass(lower=(0.0, 0.0), size=(0.3, 0.4)),),
        baffles=(Baffle(lower=(0.5 + offset * CELL, 0.0), size=(0.1, 0.12)),),
        floor_friction=0.4,
        baffle_friction=0.4,
        step_fraction=0.9,
        frame_dt=0.01,
        seed=seed,
    )


def baffles_shifted(dz: float) -> Scene:
    """`baffles-2` with its first baffle moved along z by `dz` [m]."""
    scene = read_scene("baffles-2")
    first, *others = scene.baffles
    x, y, z = first.lower
    return dataclasses.replace(scene, baffles=(dataclasses.replace(first, lower=(x, y, z + dz)), *others))
