"""The cost of each feature of a scene, of the active box, and of shortcuts in time."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from datasets.library import read_scene
from datasets.scene import Baffle, Domain, Mass, Scene
from mpm import ALL, WITH_FIELDS
from validation.bench.speed.rates import column
from validation.bench.speed.timing import TimedRun, Timing, ratio, spread
from validation.report.page import Row

PLAIN = "nothing"
ACTIVE, WHOLE = "active box", "whole grid"
BOXES = (1.0, 2.0)
"""Edges of the domain [m] in which the active box is measured."""
DURATION = {2: 0.3, 3: 0.15}
"""Simulated time [s] by dimension."""
CELLS = {2: 100, 3: 32}
"""Per metre, by dimension."""
TINY = 1.0e-9
"""Switches a term on and leaves the flow as it is."""
FULL, REST, SHORT = "full time", "until rest", "step 0.4"
SCENES = ("column-short-21", "column-short-42", "column-tall-21", "column-tall-42", "baffles-2")
Features = Mapping[tuple[int, str], Sequence[Timing]]
"""By dimension and name."""
Shortcuts = Mapping[tuple[str, str], Sequence[Timing]]
"""By scene and shortcut."""


def plain(dimension: int) -> Scene:
    """A column with friction alone: no damping, no cohesion, one material, no baffles."""
    scene = column(dimension, CELLS[dimension], 1)
    material = replace(scene.material, cohesion=0.0, tension_cutoff=0.0)
    return replace(scene, damping=0.0, material=material, duration=DURATION[dimension])


def two_materials(scene: Scene) -> Scene:
    """The scene with the upper half of its mass of a second material of nearly the same friction."""
    (mass,) = scene.masses
    size = (mass.size[0], 0.5 * mass.size[1], *mass.size[2:])
    above = (mass.lower[0], mass.lower[1] + size[1], *mass.lower[2:])
    other = replace(scene.material, friction_deg=scene.material.friction_deg + TINY)
    return replace(scene, masses=(replace(mass, size=size), Mass(lower=above, size=size, material=other)))


def with_corner_baffle(scene: Scene) -> Scene:
    """The scene with one baffle in its far upper corner, where nothing flows."""
    size = (0.1,) * scene.dimension
    lower = tuple(length - 0.1 for length in scene.domain.size)
    return replace(scene, baffles=(Baffle(lower=lower, size=size),))


def with_corner_cell(scene: Scene) -> Scene:
    """The scene with one cell of material in its far upper corner, so that the active box is the whole grid."""
    cell = scene.domain.cell
    lower = tuple(length - cell for length in scene.domain.size)
    return replace(scene, masses=(*scene.masses, Mass(lower=lower, size=(cell,) * scene.dimension)))


def switches(dimension: int) -> dict[str, TimedRun]:
    """A plain column, and the same with one feature each."""
    scene = plain(dimension)
    material = scene.material
    scenes = {
        PLAIN: scene,
        "damping": replace(scene, damping=TINY),
        "cohesion and tension cutoff": replace(scene, material=replace(material, cohesion=TINY, tension_cutoff=TINY)),
        "dilation": replace(scene, material=replace(material, dilation_deg=TINY)),
        "two materials": two_materials(scene),
        "a baffle outside the flow": with_corner_baffle(scene),
    }
    recorded = {"velocity, pressure and plastic strain recorded": TimedRun(scenes=(scene,), record=WITH_FIELDS)}
    return {name: TimedRun(scenes=(each,)) for name, each in scenes.items()} | recorded


def boxes(dimension: int) -> dict[str, TimedRun]:
    """The plain column in small and large domains, with the active box around it and over the whole grid."""
    found = {}
    for edge in BOXES:
        domain = Domain(size=(edge,) * dimension, cell=1.0 / CELLS[dimension])
        scene = replace(plain(dimension), domain=domain)
        found[f"{ACTIVE}, {edge:g} m"] = TimedRun(scenes=(scene,))
        found[f"{WHOLE}, {edge:g} m"] = TimedRun(scenes=(with_corner_cell(scene),))
    return found


def feature_runs(dimensions: Sequence[int] = (2, 3)) -> dict[tuple[int, str], TimedRun]:
    """All runs behind `feature_rows`."""
    return {
        (dimension, name): run
        for dimension in dimensions
        for name, run in (switches(dimension) | boxes(dimension)).items()
    }


def shortcut_runs(names: Sequence[str]) -> dict[tuple[str, str], TimedRun]:
    """All runs behind `shortcut_rows`."""
    found = {}
    for name in names:
        scene = read_scene(name)
        found[name, FULL] = TimedRun(scenes=(scene,))
        found[name, REST] = TimedRun(scenes=(scene,), record=replace(ALL, until_rest=True))
        found[name, SHORT] = TimedRun(scenes=(replace(scene, step_fraction=0.4),))
    return found


def comparisons(dimension: int) -> dict[str, tuple[str, str]]:
    """Names of two runs whose seconds are divided, by what the ratio tells."""
    features = {name: (name, PLAIN) for name in switches(dimension) if name != PLAIN}
    grids = {
        f"whole grid cleared and updated, box of {edge:g} m": (f"{WHOLE}, {edge:g} m", f"{ACTIVE}, {edge:g} m")
        for edge in BOXES
    }
    small, large = (f"{ACTIVE}, {edge:g} m" for edge in BOXES)
    return features | grids | {f"a domain of {BOXES[1]:g} m in place of {BOXES[0]:g} m, active box": (large, small)}


def feature_rows(found: Features) -> list[Row]:
    """Seconds with a feature over those of the plain column; then those of the active box."""
    dimensions = sorted({dimension for dimension, _ in found})
    return [
        {"switched on": name}
        | {f"{each}D": f"x {ratio(found[each, one], found[each, other]).written(2)}" for each in dimensions}
        for name, (one, other) in comparisons(dimensions[0]).items()
    ]


def shortcut_rows(found: Shortcuts) -> list[Row]:
    """Per scene seconds and front of ending at rest, and of the shorter step."""
    rows: list[Row] = []
    for name in dict.fromkeys(name for name, _ in found):
        full, rest, short = (found[name, kind] for kind in (FULL, REST, SHORT))
        rows.append(
            {
                "scene": f"`{name}`",
                "seconds": spread(each.seconds for each in full).written(2),
                "at rest after [s]": "not" if rest[0].rest_time is None else f"{rest[0].rest_time:.2f}",
                "until rest": f"x {ratio(rest, full).written(2)}",
                "front moves by": moved(rest[0].front, full[0].front),
                "step 0.4 for 0.9": f"x {ratio(short, full).written(2)}",
                "front moves by ": moved(short[0].front, full[0].front),
            }
        )
    return rows


def moved(front: float, other: float) -> str:
    """Distance of a front from another."""
    return f"{1000.0 * (front - other):+.1f} mm ({100.0 * (front / other - 1.0):+.1f} %)"
