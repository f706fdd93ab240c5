"""Families of kinds of flows, from which the shipped surrogates learn: distributions in TOML, made into scenes here.

A file of a family, such as `flow2d.toml`, has the tables `[shared]`, for all kinds, and one for each of `[kinds]`, in
which any value may be a distribution (docs/formats.md). Lengths are in metres, shares and places between 0 and 1:

    scene             keys of the scene as they are; tension cutoffs are `CUTOFF_SHARE` of each cohesion
    volume, cell      released; the grid's, of which the box is a whole number
    length, width     of the box along x and, in 3D, z, at least as wide as the bodies; and its least `height`
    bodies            boxes one after the other: `aspect`, height over length; in 3D `breadth`, width over length, else
                      as wide as the box; `share` of the volume; `gap` before it; `bottom` over the floor; `velocity`
    layers            that the body consists of: relative `thickness`, `speed`; `friction_deg`, `cohesion` if `own_sand`
    motion            of the layers: at "rest"; "even", from the first one's speed to the last one's; each its "own"
    ground            falls by `fall`, or over a `run`, at `angle_deg` from a `plateau` to its foot, may rise by `rise`
                      beyond; least elevation `base`; slope of a `valley` and its place across, `middle`; `bumps` of
                      Gauss's shape `at` places in the box, of a `radius` of two standard deviations, `height` over that
                      In 3D besides elevations `every` so many metres; a `channel`, `deep` and `wide` (two standard
                      deviations), a ridge where its depth is negative, whose line bends by `bend` over a `wave`; a
                      `fan`, a cone at the foot, so `high` and of a slope of `fan_deg`; Voellmy's `turbulence`, 0: none;
                      `reach` over the box's length, at most, of a body that falls down and slides by Coulomb's friction
    sheet             all material as a layer on the ground: its length is a `share` of the "plateau", of the "foot"'s x
                      or of 1 m; its width `across`, its `thickest`, its `velocity`; or so many `cells` thick, and its
                      `breadth`, width over length
    left, place       of the material: least distance from the side of the box, place in the room beyond; `aside` in z
    baffles           how many (`count`); of each the distance `ahead` of the material, `size` above the ground, place
                      `aside`, and `turned_deg` in scenes whose baffles are `turned`
    rows              of like baffles: `lines` and `members` of the first, `ahead`, distance `between`, relative `pitch`
    gap, least_side   between baffles, half of it before the material; of a body along x and y

A family has its kinds in rounds, as its `order` says. Every second round has variants of the scenes of the one before,
which differ in a parameter alone: that is what an inversion asks for. A scene and its variant share a random stream and
a split. Of ten scenes of a kind eight are for training, one for validation, one for the test.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from datasets.definitions.definition import Definition, Split, Storage, Stream
from datasets.definitions.distributions import OPTIONS, drawn
from datasets.definitions.held_out import boxes, is_held_out
from datasets.errors import InputError, require
from datasets.files import read_toml
from datasets.geometry.ground import Solids, elevation, plan_axes
from datasets.scene import Baffle, Domain, Mass, Scene, Solid
from datasets.scene.material import Material

TRIES = 200  # draws of a scene that is valid and not held out, and of a baffle that stands apart, before it is an error
CUTOFF_SHARE = 0.5  # tension cutoff over cohesion, as in the paper
AIR = 0.16  # least distance of the top of the box from the material [m]
GRID = 0.1  # distance between the elevations of a terrain [m]
WIDEST = 1.2  # extent of a body across the flow, at most [m]
SANDS = ("friction_deg", "cohesion")  # keys in which layers may differ
Numbers = Mapping[str, Any]
Masses = tuple[Mass, ...]
ABSENT: Numbers = {
    **dict.fromkeys(("left", "place", "aside", "width", "least_side"), 0.0),
    **dict.fromkeys(("bodies", "layers"), ()),
    **dict.fromkeys(("ground", "sheet", "rows", "turned", "own_sand")),
    "motion": "rest",
}
"""Of a kind that does not say."""


def family(path: Path) -> Definition:
    """The definition that a file of a family describes."""
    data = read_toml(path)
    if "like" in data:
        data = over(read_toml(path.with_name(f"{data.pop('like')}.toml")), data)
    kinds = {name: over(data["shared"], kind) for name, kind in data["kinds"].items()}
    order = tuple(data["order"])
    count = len(order)

    def draw(stream: Stream, index: int) -> Scene:
        name = order[index % count]
        scene = valid(lambda: composed(stream, kinds[name]), name)
        return scene if index // count % 2 == 0 else valid(lambda: variant(stream, scene), f"variant of {name}")

    return Definition(
        name=path.stem,
        size=data["size"],
        split=lambda index: {1: Split.VALID, 2: Split.TEST}.get(index // (2 * count) % 10, Split.TRAIN),
        draw=draw,
        stream=lambda index: index // (2 * count) * count + index % count,
        storage=Storage(cell=data["stored_cell"], kept=1),
        kinds=order,
    )


def over(base: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of two tables, those of `own` where both have them; tables in them the same, but for distributions."""
    merged = {**base, **own}
    for name in base.keys() & own.keys():
        if all(isinstance(table[name], dict) and not OPTIONS.keys() & table[name].keys() for table in (base, own)):
            merged[name] = over(base[name], own[name])
    return merged


def valid(attempt: Callable[[], Scene], name: str) -> Scene:
    """The first scene that is valid and not held out. Raises RuntimeError where there is none in `TRIES`."""
    for _ in range(TRIES):
        try:
            scene = attempt()
        except InputError:
            continue
        if not is_held_out(scene):
            return scene
    raise RuntimeError(f"no scene of {name} in {TRIES} draws")


def composed(stream: Stream, kind: Numbers) -> Scene:
    """A scene of a kind. Raises InputError for a draw that cannot be."""
    sketch = {**ABSENT, **drawn({name: kind[name] for name in kind if name != "baffles"}, stream, {}, ())}
    keys, ground = dict(sketch["scene"]), sketch["ground"]
    keys["material"] = sand = Material(**with_cutoff(keys["material"]))
    masses, width = bodies_of(sketch, sand)
    plan = (sketch["length"], width) if width else (sketch["length"],)
    solids, top = Solids(), 0.0
    if ground is not None:
        ground["foot"] = ground["plateau"] + (ground.get("run") or ground["fall"] / slope_of(ground))
        fall = slope_of(ground) * (ground["foot"] - ground["plateau"])
        if fall > ground.get("reach", math.inf) * plan[0] * keys["floor_friction"]:
            raise InputError("expected a flow that ends before the box does")
        solids, top = terrain_of(ground, plan, keys["floor_friction"])
        if sketch["sheet"]:
            masses, thickness = sheet_of(sketch, sketch["sheet"], plan)
            top += thickness
        masses = tuple(on_ground(mass, solids[0]) if mass.size else mass for mass in masses)
    top = max([top, *(mass.lower[1] + mass.size[1] for mass in masses if mass.size)])
    extent, cell = (plan[0], max(sketch["height"], top + AIR), *plan[1:]), sketch["cell"]
    domain = Domain(size=tuple(cell * math.ceil(length / cell - 1e-6) for length in extent), cell=cell)
    baffles = baffles_of(stream, {**sketch, "baffles": kind.get("baffles")}, masses, domain, solids)
    keys["baffle_friction"] = keys.get("baffle_friction", 0.0) if baffles else 0.0
    return Scene(seed=int(stream.integers(2**31)), domain=domain, masses=masses, solids=solids, baffles=baffles, **keys)


def with_cutoff(sand: Numbers) -> dict[str, Any]:
    """Keys of a sand, with its tension cutoff."""
    return {**sand, "tension_cutoff": CUTOFF_SHARE * sand["cohesion"]}


def bodies_of(sketch: Numbers, sand: Material) -> tuple[Masses, float]:
    """The masses of the bodies, layer by layer, and the width of the box [m], 0 in 2D."""
    bodies, width = sketch["bodies"], sketch["width"]
    shares, sizes = sum(body.get("share", 1.0) for body in bodies), list[tuple[float, ...]]()
    for body in bodies:
        volume = sketch["volume"] * body.get("share", 1.0) / shares
        aspect, breadth = body["aspect"], body.get("breadth")
        length = (volume / (aspect * breadth)) ** (1 / 3) if breadth else math.sqrt(volume / (width or 1.0) / aspect)
        sizes.append((length, aspect * length, breadth * length if breadth else width))
        fits = min(sizes[-1][:2]) >= sketch["least_side"] and sizes[-1][2] <= WIDEST
        require(fits, "", "a body that is not thinner, nor wider across the flow")
    width = max([width, *(0.1 * math.ceil(10.0 * size[2] - 1.0e-6) for size in sizes)])
    room = sketch["length"] - sketch["left"] - sum(size[0] for size in sizes) - sum(b.get("gap", 0.0) for b in bodies)
    x, masses = sketch["left"] + sketch["place"] * room, list[Mass]()
    for body, size in zip(bodies, sizes, strict=True):
        x += body.get("gap", 0.0)
        lower = (x, body.get("bottom", 0.0), sketch["aside"] * (width - size[2]))
        axes = 3 if width else 2
        masses.append(Mass(lower=lower[:axes], size=size[:axes], velocity=tuple(body.get("velocity", ())) or None))
        x += size[0]
    return (layered(sketch, masses[0], sand) if sketch["layers"] else tuple(masses)), width


def layered(sketch: Numbers, whole: Mass, sand: Material) -> Masses:
    """The layers of a body in 2D."""
    layers = sketch["layers"]
    edges = np.cumsum([0.0, *(layer.get("thickness", 1.0) for layer in layers)])
    edges = (edges * whole.size[1] / edges[-1]).tolist()
    speeds, masses = [layer["speed"] for layer in layers], list[Mass]()
    speeds = np.linspace(speeds[0], speeds[-1], len(speeds)).tolist() if sketch["motion"] == "even" else speeds
    for layer, low, high, speed in zip(layers, edges[:-1], edges[1:], speeds, strict=True):
        material = None
        if sketch["own_sand"]:
            material = dataclasses.replace(sand, **with_cutoff({key: layer[key] for key in SANDS}))
        velocity = None if sketch["motion"] == "rest" else (speed, 0.0)
        part = dataclasses.replace(whole, lower=(whole.lower[0], low), size=(whole.size[0], high - low))
        masses.append(dataclasses.replace(part, velocity=velocity, material=material))
    return tuple(masses)


def slope_of(ground: Numbers) -> float:
    """Of the ground below its plateau [-]."""
    return math.tan(math.radians(ground["angle_deg"]))


def terrain_of(ground: Numbers, plan: tuple[float, ...], friction: float) -> tuple[Solids, float]:
    """The terrain of a box of a size in plan [m], and its highest elevation [m]."""
    plateau, foot, grid = ground["plateau"], ground["foot"], ground.get("every", GRID)
    x, *across = (grid * np.arange(-1, round(length / grid) + 3) for length in plan)
    x = x if across else np.unique([0.0, *x[2:], plateau, foot])
    places = np.stack(np.meshgrid(x, *across, indexing="ij"), axis=-1)
    knots = [plateau, foot, max(plan[0], foot + GRID)]
    heights = np.interp(places[..., 0], knots, [(foot - plateau) * slope_of(ground), 0.0, ground.get("rise", 0.0)])
    off = places[..., -1] - ground.get("middle", 0.0) * plan[-1]
    heights += ground.get("valley", 0.0) * np.abs(off)
    if channel := ground.get("channel"):
        off = off - channel["bend"] * np.sin(2.0 * math.pi * places[..., 0] / channel["wave"])
        heights -= channel["deep"] * np.exp(-2.0 * (off / channel["wide"]) ** 2)
    if fan := ground.get("fan"):
        apart = np.hypot(places[..., 0] - foot, off)
        heights = np.maximum(heights, fan["high"] - math.tan(math.radians(fan["fan_deg"])) * apart)
    for bump in ground["bumps"]:
        off = ((places - np.multiply(bump["at"], plan)) ** 2).sum(axis=-1)
        heights += bump["height"] * bump["radius"] * np.exp(-2.0 * off / bump["radius"] ** 2)
    heights += ground["base"] - heights.min()
    if not across:
        solid = Solid(kind="terrain", friction=friction, points=tuple(zip(x.tolist(), heights.tolist(), strict=True)))
    else:
        corner, rows = (float(x[0]), float(across[0][0])), tuple(map(tuple, heights.tolist()))
        solid = Solid(kind="terrain", friction=friction, origin=corner, spacing=(grid, grid), heights=rows)
        solid = dataclasses.replace(solid, turbulence=ground.get("turbulence") or None)
    return (solid,), float(heights.max())


def on_ground(mass: Mass, terrain: Solid) -> Mass:
    """A box in 3D moved up, so that it lies on the highest post of a terrain beneath it, or as far above that."""
    heights = np.array(terrain.heights)
    for axis, first, step in zip((0, 2), terrain.origin or (), terrain.spacing or (), strict=True):
        begin, end = ((edge - first) / step for edge in (mass.lower[axis], mass.lower[axis] + mass.size[axis]))
        heights = heights[math.floor(begin) : math.ceil(end) + 1].T
    x, y, z = mass.lower
    return dataclasses.replace(mass, lower=(x, y + float(heights.max()), z))


def sheet_of(sketch: Numbers, sheet: Numbers, plan: tuple[float, ...]) -> tuple[Masses, float]:
    """The layer on the ground, and its thickness [m]."""
    left = sketch["left"]
    across = 1.0
    if "cells" in sheet:
        length = math.sqrt(sketch["volume"] / (sheet["cells"] * sketch["cell"] * sheet["breadth"]))
        sheet = {**sheet, "across": sheet["breadth"] * length}
        room = sheet["across"] <= plan[1] - 0.1 and left + length <= 0.6 * plan[0]
        require(room, "", "a layer that leaves room around it and ahead")
    else:
        length = sheet["share"] * {**sketch["ground"], "": 1.0}[sheet.get("of", "")]
    outline: tuple[tuple[float, ...], ...] = ((left,), (left + length,))
    if len(plan) == 2:
        across = min(sheet["across"], plan[1] - 0.04)
        near = sketch["aside"] * (plan[1] - across)
        outline = ((left, near), (left + length, near), (left + length, near + across), (left, near + across))
    thickness = sketch["volume"] / (length * across)
    require(thickness <= sheet.get("thickest", 1.0), "", "a layer that is not thicker")
    velocity = tuple(sheet.get("velocity", ())) or None
    return (Mass(kind="layer", thickness=thickness, outline=outline, velocity=velocity),), thickness


def baffles_of(stream: Stream, sketch: Numbers, masses: Masses, domain: Domain, solids: Solids) -> tuple[Baffle, ...]:
    """Baffles, each drawn until it stands apart from the others, or rows of them. Raises InputError."""
    front, given, baffles = max(map(furthest, masses)), sketch["baffles"] or {"count": 0}, list[Baffle]()
    if sketch["rows"]:
        baffles = rows_of(sketch["rows"], masses[0], sketch["turned"])
        require(apart(baffles, front, sketch["gap"]), "", "baffles that stand apart")
        return tuple(baffles)
    count = drawn(given["count"], stream, {}, ())
    for _ in range(TRIES):
        if len(baffles) == count:
            return tuple(baffles)
        one = drawn(given, stream, {}, ())
        size, across = np.array(one["size"]), domain.size[2:]
        lower = np.array([front + one["ahead"], 0.0, *(one["aside"] * (width - size[2]) for width in across)])
        if solids:
            size[1] += elevation(solids, domain, (lower + 0.5 * size)[None, plan_axes(len(size))])[0]
        turned_deg = one["turned_deg"] if sketch["turned"] else 0.0
        baffle = Baffle(lower=tuple(lower.tolist()), size=tuple(size.tolist()), turned_deg=turned_deg)
        if lower[0] + size[0] <= domain.size[0] - 0.02 and apart([*baffles, baffle], front, sketch["gap"]):
            baffles.append(baffle)
    raise InputError("expected room for the baffles")


def rows_of(rows: Numbers, mass: Mass, turned: bool) -> list[Baffle]:
    """Rows of baffles across a mass in 3D, the second behind the gaps of the first."""
    size, baffles = tuple(rows["size"]), list[Baffle]()
    pitch = rows["pitch"] * mass.size[2] / (rows["members"] - 0.3)
    for line in range(rows["lines"]):
        members = rows["members"] - line
        x = furthest(mass) + rows["ahead"] + line * (size[0] + rows["between"])
        for number in range(members):
            z = mass.lower[2] + 0.5 * (mass.size[2] - size[2]) + pitch * (number - 0.5 * (members - 1))
            baffles.append(Baffle(lower=(x, 0.0, z), size=size, turned_deg=rows["turned_deg"] if turned else 0.0))
    return baffles


def furthest(mass: Mass) -> float:
    """The largest x of a mass [m]."""
    return max(x for x, *_ in mass.outline) if mass.outline else mass.lower[0] + mass.size[0]


def apart(baffles: list[Baffle], front: float, gap: float) -> bool:
    """Whether baffles keep a `gap` [m] from each other in plan, and stand before the `front` of the material [m]."""
    around = boxes(tuple(baffles), len(baffles[0].size))
    level = plan_axes(around.shape[-1])
    ahead = bool((around[:, 0, 0] >= front + 0.5 * gap).all())
    distances = (np.maximum(a[0] - b[1], b[0] - a[1])[level].max() for a, b in combinations(around, 2))
    return ahead and all(distance >= gap - 1.0e-9 for distance in distances)


def variant(stream: Stream, scene: Scene) -> Scene:
    """The scene, particles included, with another friction angle, velocity, cohesion or place of a baffle."""
    change = stream.random()
    if scene.baffles and change < 0.5:
        baffles, number = list(scene.baffles), int(stream.integers(len(scene.baffles)))
        lower = np.array(baffles[number].lower)
        level = plan_axes(scene.dimension)
        lower[level] += stream.uniform(0.01, 0.05, len(level)) * stream.choice([-1.0, 1.0], len(level))
        baffles[number] = dataclasses.replace(baffles[number], lower=tuple(lower.tolist()))
        require(apart(baffles, max(map(furthest, scene.masses)), 0.02), "", "baffles that stand apart")
        return dataclasses.replace(scene, baffles=tuple(baffles))
    if change < 0.5 and any(mass.velocity for mass in scene.masses):
        faster = [(v[0] + float(stream.normal(0.0, 0.3)), *v[1:]) for mass in scene.masses if (v := mass.velocity)]
        pairs = zip(scene.masses, faster, strict=True)
        return dataclasses.replace(scene, masses=tuple(dataclasses.replace(m, velocity=v) for m, v in pairs))
    if change > 0.85 and scene.material.cohesion > 0.0:
        return stronger(scene, 0.0, float(np.exp(stream.choice([-1.0, 1.0]) * stream.uniform(0.3, 1.0))))
    return stronger(scene, float(stream.uniform(2.0, 5.0)) * (1.0 if scene.material.friction_deg < 30.0 else -1.0), 1.0)


def stronger(scene: Scene, turn: float, factor: float) -> Scene:
    """The scene with every sand of it turned by an angle of friction [deg] and its cohesion times a factor."""

    def changed(sand: Material) -> Material:
        new = with_cutoff({"friction_deg": sand.friction_deg + turn, "cohesion": factor * sand.cohesion})
        return dataclasses.replace(sand, **new)

    masses = (dataclasses.replace(mass, material=mass.material and changed(mass.material)) for mass in scene.masses)
    return dataclasses.replace(scene, masses=tuple(masses), material=changed(scene.material))
