"""What it saves that a scene is charged only for what it needs, and what shortcuts save and change."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from datasets.library import read_scene
from datasets.scene import Baffle, Domain, Mass, Scene
from inverse.report.markdown import table
from mpm import WITH_FIELDS, Recording
from validation.bench.speed.rates import column
from validation.report.timing import Run, Spread, Took, ratio

PLAIN = "nothing"
ALONE, SPANNED = "box around the material", "whole grid"
BOXES = (1.0, 2.0)
"""Sides of the domain [m] in which the active box is measured."""
DURATION = {2: 0.3, 3: 0.15}
"""Simulated time [s] by dimension."""
CELLS = {2: 100, 3: 32}
"""Per metre, by dimension."""
TINY = 1.0e-9
"""Switches a term on and leaves the flow as it is."""
FULL, REST, SHORT = "full time", "until rest", "step 0.4"
SCENES = ("column-short-21", "column-short-42", "column-tall-21", "column-tall-42", "baffles-2")

Measured = Mapping[tuple[int, str], Sequence[Took]]


def plain(dimension: int) -> Scene:
    """A column that needs nothing beyond friction: no damping, no cohesion, one material, no baffles."""
    scene = column(dimension, CELLS[dimension], 1)
    material = replace(scene.material, cohesion=0.0, tension_cutoff=0.0)
    return replace(scene, damping=0.0, material=material, duration=DURATION[dimension])


def halves(scene: Scene) -> Scene:
    """The scene with the upper half of its mass of a second material, which differs in name alone."""
    (mass,) = scene.masses
    size = (mass.size[0], 0.5 * mass.size[1], *mass.size[2:])
    above = (mass.lower[0], mass.lower[1] + size[1], *mass.lower[2:])
    other = replace(scene.material, friction_deg=scene.material.friction_deg + TINY)
    return replace(scene, masses=(replace(mass, size=size), Mass(lower=above, size=size, material=other)))


def cornered(scene: Scene) -> Scene:
    """The scene with one baffle in its far upper corner, where nothing flows."""
    size = (0.1,) * scene.dimension
    lower = tuple(length - 0.1 for length in scene.domain.size)
    return replace(scene, baffles=(Baffle(lower=lower, size=size),))


def spanned(scene: Scene) -> Scene:
    """The scene with one cell of material in its far upper corner, so that the active box is the whole grid."""
    cell = scene.domain.cell
    lower = tuple(length - cell for length in scene.domain.size)
    return replace(scene, masses=(*scene.masses, Mass(lower=lower, size=(cell,) * scene.dimension)))


def switches(dimension: int) -> dict[str, Run]:
    """A plain column, and the same with one thing more each."""
    scene = plain(dimension)
    material = scene.material
    more = {
        PLAIN: scene,
        "damping": replace(scene, damping=TINY),
        "cohesion and tension cutoff": replace(scene, material=replace(material, cohesion=TINY, tension_cutoff=TINY)),
        "dilation": replace(scene, material=replace(material, dilation_deg=TINY)),
        "two materials": halves(scene),
        "a baffle, far from the flow": cornered(scene),
    }
    return {name: Run(scenes=(each,)) for name, each in more.items()} | {
        "velocity, pressure and plastic strain recorded": Run(scenes=(scene,), record=WITH_FIELDS)
    }


def boxes(dimension: int) -> dict[str, Run]:
    """The plain column in small and large domains, with the active box around it and spanned over the whole grid."""
    runs = {}
    for side in BOXES:
        domain = Domain(size=(side,) * dimension, cell=1.0 / CELLS[dimension])
        scene = replace(plain(dimension), domain=domain)
        runs[f"{ALONE}, {side:g} m"] = Run(scenes=(scene,))
        runs[f"{SPANNED}, {side:g} m"] = Run(scenes=(spanned(scene),))
    return runs


def need_runs(dimensions: Sequence[int] = (2, 3)) -> dict[tuple[int, str], Run]:
    """All runs behind `needs_table`."""
    return {
        (dimension, name): run
        for dimension in dimensions
        for name, run in (switches(dimension) | boxes(dimension)).items()
    }


def shortcut_runs(names: Sequence[str] | None = None) -> dict[tuple[str, str], Run]:
    """All runs behind `shortcuts_table`."""
    runs = {}
    for name in SCENES if names is None else names:
        scene = read_scene(name)
        runs[name, FULL] = Run(scenes=(scene,))
        runs[name, REST] = Run(scenes=(scene,), record=Recording(until_rest=True))
        runs[name, SHORT] = Run(scenes=(replace(scene, step_fraction=0.4),))
    return runs


def needs_table(took: Measured) -> list[str]:
    """Seconds of what a scene may need, over those of the plain column; then what the active box saves."""
    dimensions = sorted({dimension for dimension, _ in took})
    head = ["switched on", *(f"{dimension}D" for dimension in dimensions)]
    rows = [
        [name, *(times(ratio(took[dimension, name], took[dimension, PLAIN])) for dimension in dimensions)]
        for name in switches(dimensions[0])
        if name != PLAIN
    ]
    for side in BOXES:
        saved = [
            times(ratio(took[dimension, f"{SPANNED}, {side:g} m"], took[dimension, f"{ALONE}, {side:g} m"]))
            for dimension in dimensions
        ]
        rows.append([f"whole grid cleared and updated, box of {side:g} m", *saved])
    names = [f"{ALONE}, {side:g} m" for side in BOXES]
    larger = [times(ratio(took[dimension, names[1]], took[dimension, names[0]])) for dimension in dimensions]
    rows.append([f"a domain of {BOXES[1]:g} m in place of {BOXES[0]:g} m, active box only", *larger])
    return table(head, rows)


def times(spread: Spread) -> str:
    """A ratio of seconds."""
    return f"x {spread.written(2)}"


def shortcuts_table(took: Mapping[tuple[str, str], Sequence[Took]]) -> list[str]:
    """Per scene what ending at rest saves and changes, and what the long step does."""
    head = [
        "scene",
        "seconds",
        "at rest after [s]",
        "until rest",
        "front moves by",
        "step 0.4 for 0.9",
        "front moves by",
    ]
    rows = []
    for name in dict.fromkeys(name for name, _ in took):
        full, rest, short = (took[name, kind] for kind in (FULL, REST, SHORT))
        rows.append(
            [
                f"`{name}`",
                Spread.of(each.seconds for each in full).written(2),
                "not" if rest[0].rest_time is None else f"{rest[0].rest_time:.2f}",
                times(ratio(rest, full)),
                moved(rest[0].front, full[0].front),
                times(ratio(short, full)),
                moved(short[0].front, full[0].front),
            ]
        )
    return table(head, rows)


def moved(front: float, other: float) -> str:
    """How far a front lies from another."""
    return f"{1000.0 * (front - other):+.1f} mm ({100.0 * (front / other - 1.0):+.1f} %)"
