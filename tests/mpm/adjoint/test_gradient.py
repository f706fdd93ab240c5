"""Gradients of whole runs against central differences in double precision, term by term of the solver."""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from datasets import Baffle, Channel, Mass, Material, Scene, Solid
from datasets.scene.grid_field import Field
from mpm.adjoint.gradient import Gradient, started
from tests.mpm.adjoint.flows import SOIL, Weighted, boxes, central, exact_gradient, moved, plane, room, shaken, value_of
from tests.refusals import refused

pytestmark = pytest.mark.double

SAND = Material(friction_deg=30.0)
WEAK = Material(friction_deg=30.0, cohesion=200.0, tension_cutoff=20.0)
DILATING = dataclasses.replace(SOIL, dilation_deg=10.0, tension_cutoff=5.0)
PEAK = {"friction_deg": 35.0, "dilation_deg": 8.0, "cohesion": 300.0, "tension_cutoff": 100.0}
RESIDUAL = {"residual_friction_deg": 25.0, "residual_cohesion": 100.0, "residual_tension_cutoff": 20.0}
SOFTENING = Material(**PEAK, **RESIDUAL, softening_length=4.0e-3)
CLAY = Material(law="von-mises", friction_deg=0.0, constants={"strength": 500.0, "hardening": 300.0}, young=2.0e5)
FAST_SHEAR = {"friction_limit_deg": 45.0, "grain_diameter": 5.0e-3, "inertial_number": 0.2}
FAST_SAND = dataclasses.replace(SAND, angle="slope", **FAST_SHEAR | {"friction_limit_deg": 38.0})
LEAVING = boxes(((0.785, 0.0), (0.2, 0.2), (2.0, 0.0)), ((0.01, 0.0), (0.1, 0.2), (-2.0, -0.3)))
FALLING = (
    Mass(lower=(0.013, 0.05), size=(0.2, 0.1), velocity=(0.5, -1.5), angular_velocity=8.0),
    Mass(lower=(0.3, 0.013), size=(0.1, 0.1), velocity=(-1.0, 0.3)),
)
NEAR = boxes(((0.0, 0.0), (0.2, 0.2), (1.0, 0.0)), ((0.2, 0.0), (0.1, 0.2), (1.5, -0.3)))
ABOVE = boxes(((0.1, 0.033), (0.2, 0.12), (1.0, -0.3)), ((0.3, 0.04), (0.1, 0.1), (0.5, -0.5)))
# Two rows of particles.
THIN = boxes(((0.1, 0.032), (0.1, 0.014), (2.0, -0.5)), ((0.2, 0.034), (0.06, 0.015), (1.7, -0.3)))
HELD = (
    Mass(lower=(0.1, 0.0), size=(0.2, 0.2), release=0.0125),
    Mass(lower=(0.5, 0.0), size=(0.1, 0.2), velocity=(-0.5, 0.0)),
)
# So fast that particles reach the ground, which puts them back onto it.
THROWN = boxes(((0.35, 0.036), (0.2, 0.1), (1.0, -6.0)))
THROWN_3D = boxes(((0.013, 0.05, 0.12), (0.2, 0.16, 0.16), (1.0, -1.5, 0.2)))
CUBE = boxes(((0.0, 0.0, 0.12), (0.2, 0.2, 0.16), (2.0, 0.0, 0.2)))
# Off the knots of the splines of a bed, where their second derivatives jump.
RAISED = boxes(((0.203, 0.08, 0.206), (0.24, 0.16, 0.16), (1.0, -1.0, 0.3)))
HURLED = boxes(((0.203, 0.08, 0.206), (0.24, 0.16, 0.16), (1.0, -6.0, 0.3)))
# They lean: turned out of the upright on the floor, a wedge would open below.
LEANING = Baffle(lower=(0.313, 0.0), size=(0.05, 0.127), turned_deg=5.0)
BEHIND = Baffle(lower=(0.413, 0.0), size=(0.05, 0.127), turned_deg=5.0)
PILLAR = Baffle(lower=(0.225, 0.0, 0.1), size=(0.1, 0.127, 0.1), turned_deg=20.0)
GROUND = Solid(kind="terrain", points=((0.0, 0.02), (0.25, 0.03), (1.0, 0.013)), friction=(0.1, 0.7, 0.3))
SLOPE = Solid(kind="terrain", points=((0.0, 0.02), (1.0, 0.03)), friction=0.4)
HEIGHTS = ((0.05, 0.07, 0.05), (0.06, 0.05, 0.05), (0.05, 0.05, 0.06))
MU = ((0.1, 0.6, 0.2), (0.5, 0.1, 0.4), (0.1, 0.5, 0.3))
HILL = Solid(kind="terrain", origin=(0.0, 0.0), spacing=(0.4, 0.4), heights=HEIGHTS, friction=MU)
XI = ((40.0, 20.0, 50.0), (15.0, 60.0, 30.0), (50.0, 20.0, 40.0))


def braked(solid: Any, turbulence: Any = 40.0) -> tuple[Any, ...]:
    """A solid with turbulence."""
    return (dataclasses.replace(solid, turbulence=turbulence),)


BAFFLED: dict[str, Any] = {"masses": NEAR, "baffles": (LEANING,), "baffle_friction": 0.3}
FRICTIONS = Field(quantity="friction_deg", values=(25.0, 35.0), origin=(0.0, 0.1), spacing=(0.3, 1.0), nodes=(2, 1))
SCENES = {
    # With its gaps remembered, a corner of this flow's path lies within the difference's step of friction_deg.
    "2D": plane(slope_deg=-20.0, volume_correction=False, duration=0.01),
    "damped": plane(damping=0.05, slope_deg=-20.0),
    "APIC, dilating": plane(DILATING, relaxation_time=0.0),
    "open sides": plane(open_sides=("x-", "x+"), masses=LEAVING, slope_deg=20.0),
    "softening": plane(SOFTENING, duration=0.01),
    "barriers": plane(masses=HELD, duration=0.03),
    "3D": room(),
    "3D softening": room(SOFTENING),
    "von Mises": plane(CLAY, duration=0.04),
    "sand": plane(SAND, masses=FALLING, duration=0.04),
    "dilating sand": plane(dataclasses.replace(SAND, dilation_deg=10.0), masses=FALLING, duration=0.04),
    "weak soil": plane(WEAK, masses=FALLING, duration=0.03),
    "sand before a baffle": plane(SAND, masses=FALLING, baffles=(BEHIND,), baffle_friction=0.3, duration=0.04),
    "friction of the rate": plane(dataclasses.replace(WEAK, dilation_deg=5.0, **FAST_SHEAR), slope_deg=20.0),
    "friction of the rate, softening": plane(dataclasses.replace(SOFTENING, **FAST_SHEAR), duration=0.01),
    "3D sand, friction of the rate": room(FAST_SAND, masses=THROWN_3D),
    "3D sand": room(SAND, masses=THROWN_3D, duration=0.03),
    "3D weak soil": room(WEAK, masses=THROWN_3D, duration=0.03),
    "baffle": plane(**BAFFLED, duration=0.04),
    "baffle, APIC, damped": plane(**BAFFLED, relaxation_time=0.0, damping=0.05),
    "3D baffle": room(masses=CUBE, baffles=(PILLAR,), baffle_friction=0.3, duration=0.015),
    "ground": plane(masses=ABOVE, solids=(GROUND,), volume_correction=False, duration=0.03),
    "thrown": plane(masses=THROWN, solids=(SLOPE,), volume_correction=False, duration=0.03),
    "channel with a baffle": plane(**BAFFLED, channel=Channel(width=0.1, friction_deg=20.0), slope_deg=20.0),
    "turbulent ground": plane(masses=ABOVE, solids=braked(SLOPE), volume_correction=False, duration=0.03),
    "turbulent baffle": plane(masses=NEAR, baffles=braked(LEANING, 20.0), baffle_friction=0.3, duration=0.04),
    "thin layer on turbulent ground": plane(masses=THIN, solids=braked(SLOPE)),
    "3D turbulent ground": room(masses=RAISED, solids=braked(HILL), volume_correction=False, duration=0.015),
    "3D ground whose turbulence varies": room(masses=RAISED, solids=braked(HILL, XI), duration=0.015),
    "3D ground": room(masses=RAISED, solids=(HILL,), volume_correction=False, duration=0.015),
    "3D thrown": room(masses=HURLED, solids=(HILL,), volume_correction=False, duration=0.015),
}
FAST = ("2D",)  # the others have kernels of their own, which take long to compile

MATERIAL = {
    **{"friction_deg": 1e-2, "young": 1e3, "poisson": 1e-4, "density": 1.0, "cohesion": 0.1, "tension_cutoff": 1e-1},
    **{"dilation_deg": 1e-2, "residual_friction_deg": 1e-2, "residual_cohesion": 1.0, "softening_length": 1e-6},
    **{"friction_limit_deg": 1e-2, "inertial_number": 1e-4, "grain_diameter": 1e-6, "grain_density": 1.0},
}
SETTINGS = {"floor_friction": 1e-3, "wall_friction": 1e-3, "gravity": 1e-2, "slope_deg": 1e-2, "damping": 1e-4}
Way = tuple[str | int, ...]  # keys and indices from a scene to a number
STEPS: dict[Way, float] = {
    **{("material", name): step for name, step in MATERIAL.items()},
    **{("material", "constants", name): 1.0 for name in ("strength", "hardening")},
    **{(name,): step for name, step in SETTINGS.items()},
    ("channel", "width"): 1e-4,
    ("baffles", 0, "lower", 0): 1e-5,
    ("baffles", 0, "size", 1): 1e-5,
    ("baffles", 0, "turned_deg"): 1e-2,
    ("baffles", 0, "turbulence"): 1.0,
    ("baffle_friction",): 1e-3,
    ("solids", 0, "points", 1, 0): 1e-6,
    ("solids", 0, "points", 1, 1): 1e-6,
    ("solids", 0, "friction"): 1e-3,
    ("solids", 0, "turbulence"): 1.0,
}
"""Of a number, the largest of its differences."""


def value_at(record: Any, way: Way) -> Any:
    """What stands at the end of a way of keys and indices; None where there is nothing."""
    for key in way:
        if isinstance(key, int):
            record = record[key] if record and len(record) > key else None
        else:
            record = record.get(key) if isinstance(record, dict) else getattr(record, key, None)
    return record


def raised(record: Any, way: Way, h: float) -> Any:
    """A record with the number at the end of a way raised by h, or all numbers of a table there."""
    if not way:
        return tuple(raised(part, way, h) for part in record) if isinstance(record, tuple) else record + h
    key, rest = way[0], way[1:]
    if isinstance(key, int):
        return (*record[:key], raised(record[key], rest, h), *record[key + 1 :])
    if isinstance(record, dict):
        return {**record, key: raised(record[key], rest, h)}
    return dataclasses.replace(record, **{key: raised(getattr(record, key), rest, h)})


def paths_of(scene: Scene) -> Iterator[tuple[Way, float]]:
    """Ways to the numbers that a scene has, and a step of each."""
    absent = {"young"} if any(mass.release for mass in scene.masses) else set()
    absent |= set() if scene.material.friction_limit_deg else {"inertial_number", "grain_density"}
    for way, step in STEPS.items():
        given = value_at(scene, way) and way[-1] not in absent and value_at(scene, way) != XI
        if given and ("points" not in way or scene.solids == (GROUND,)):
            yield way, step


def derivatives(
    scene: Scene, slope: Gradient, value: Callable[..., float]
) -> Iterator[tuple[str, float, Callable[[float], float], float]]:
    """Name, derivative by the adjoint, the objective along a path and a step, of all that a scene begins with."""
    for name, step in (("velocities", 1e-5), ("positions", 1e-7), ("velocity_gradients", 1e-4)):
        ours = getattr(slope, name)
        direction = np.random.default_rng(1).normal(size=ours.shape)
        change = moved(name, direction)
        yield name, float((ours * direction).sum()), lambda h, change=change: value(scene, change(h)), step
    for way, step in paths_of(scene):

        def path(h: float, way: Way = way) -> Scene:
            return raised(scene, way, h)

        match way:
            case ("material", *_, str(name)):
                by_adjoint = float(slope.material(name).sum())
            case (str(name),) if name in SETTINGS:
                by_adjoint = slope.setting(name)
            case _:
                by_adjoint = slope.along(path, 0.0, 1e-7)
        yield str(way), by_adjoint, lambda h, path=path: value(path(h)), step


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] if n not in FAST else []) for n in SCENES])
def test_the_gradient_is_that_of_central_differences(name: str) -> None:
    """Of positions and velocities at the end, and of the momentum that solids have taken."""
    scene = SCENES[name]
    objective = Weighted(scene)
    # Side walls, too, have a corner where there is no stress.
    loose = not scene.material.cohesive or scene.material is WEAK or scene.channel is not None
    base = shaken if loose else lambda particles: particles

    def value(scene: Scene, change: Callable[[Any], Any] = lambda particles: particles) -> float:
        return value_of(scene, objective, lambda particles: change(base(particles)))

    slope = exact_gradient(scene, objective, base)
    # Weak soil yields and opens everywhere: only small steps stay on one piece of its flow.
    finer = 0.01 if name == "weak soil" else 1.0
    for what, ours, along, step in derivatives(scene, slope, value):
        # A random direction may lie nearly across the gradient; of what has no effect differences are rounding.
        share = 1e-4 if what == "velocity_gradients" else 1e-6
        nearly = share * float(np.linalg.norm(getattr(slope, what))) if what in vars(slope) else 1e-10 / step
        assert ours == pytest.approx(central(along, finer * step), rel=2e-5, abs=nearly), what
    if scene.baffles:
        more = Solid(kind="box", lower=(0.6,) * scene.dimension, size=(0.1,) * scene.dimension)
        refused(slope.along, lambda h: dataclasses.replace(scene, solids=(more,)), 0.0, said="as many faces")


def test_turbulence_by_posts_has_no_derivative() -> None:
    scene = SCENES["3D ground whose turbulence varies"]
    mirrored = dataclasses.replace(scene, solids=braked(HILL, XI[::-1]))
    refused(started, mirrored, started(scene), said="expected the same turbulence at all posts of a terrain")


def test_in_3d_it_is_that_of_central_differences_along_one_direction() -> None:
    """Of the velocities of all particles; of everything else, and with gaps, among the slow ones above."""
    scene = room(volume_correction=False)
    objective = Weighted(scene)
    slope = exact_gradient(scene, objective)
    direction = np.random.default_rng(1).normal(size=slope.velocities.shape)
    change = moved("velocities", direction)
    derivative = central(lambda h: value_of(scene, objective, change(h)), 1e-5)
    assert (slope.velocities * direction).sum() == pytest.approx(derivative, rel=2e-5)


def test_the_remainder_falls_with_the_square_of_the_step() -> None:
    """Taylor: |J(u + h d) - J(u) - h J' d| falls with h^2 over four decades where the flow has no corners.

    A body that flies and swings, too strong to yield; u are the velocities of all particles."""
    strong = dataclasses.replace(SOIL, cohesion=1.0e6, tension_cutoff=1.0e6)
    body = Mass(lower=(0.41, 0.43), size=(0.2, 0.1), velocity=(1.0, 0.5), angular_velocity=5.0)
    scene = plane(strong, masses=(body,), volume_correction=False, duration=0.0125)
    objective = Weighted(scene)
    value, slope = value_of(scene, objective), exact_gradient(scene, objective)
    direction = np.random.default_rng(2).normal(size=slope.velocities.shape)
    change = moved("velocities", direction)
    steps = 10.0 ** np.arange(0.0, -4.5, -0.5)
    along = (slope.velocities * direction).sum()
    remainders = [abs(value_of(scene, objective, change(h)) - value - h * along) for h in steps]
    orders = np.diff(np.log(remainders)) / np.diff(np.log(steps))
    assert np.all(orders > 1.8), orders
    assert np.median(orders) == pytest.approx(2.0, abs=0.1)


@pytest.mark.filterwarnings("ignore:no initial stress")
@pytest.mark.parametrize(
    "change",
    [
        {"damping": 0.1, "floor_friction": 0.5},
        {"material": dataclasses.replace(SOIL, friction_deg=31.0, density=1900.0)},
        {"masses": (NEAR[0], dataclasses.replace(NEAR[1], material=dataclasses.replace(SOIL, cohesion=450.0)))},
        {"masses": (dataclasses.replace(NEAR[0], velocity=(2.0, 0.1)), NEAR[1])},
        {"masses": (NEAR[0], dataclasses.replace(NEAR[1], lower=(0.2, 0.01), k0=0.5))},
        {"baffles": (dataclasses.replace(LEANING, lower=(0.314, 0.0)),), "gravity": 9.0},
        {"fields": (FRICTIONS,)},
    ],
)
def test_what_a_run_begins_with_is_made_anew_where_a_path_changes_it(change: dict[str, Any]) -> None:
    """From each scene to the other, whatever they have in common."""
    scenes = plane(**BAFFLED), plane(**BAFFLED | change)
    for base, scene in (scenes, scenes[::-1]):
        renewed, whole = started(scene, started(base)), started(scene)
        for name in ("stress", "properties", "settings", "faces", "terrain"):
            np.testing.assert_array_equal(getattr(renewed, name), getattr(whole, name), err_msg=name)
        for name in ("positions", "velocities", "velocity_gradients", "friction", "volume"):
            np.testing.assert_array_equal(*(getattr(run.particles, name) for run in (renewed, whole)), err_msg=name)
        holds = [zip(run.held, run.holds, strict=True) for run in (renewed, whole)]
        ours, theirs = ({(*node, face): share for node, (face, _, share) in pairs if share > 0.0} for pairs in holds)
        assert ours.items() <= theirs.items()
        assert len(ours) > 0.8 * len(theirs) > 0.0


def test_a_path_that_moves_a_body_and_speeds_it_up() -> None:
    """Half a cell aside, where masses do not lie on the grid."""
    first, second = plane().masses

    def scene_at(t: float) -> Scene:
        pushed = dataclasses.replace(first, lower=(0.01 + 0.1 * t, 0.01), velocity=(1.0 + t, 0.2 * t))
        return plane(masses=(pushed, dataclasses.replace(second, lower=(0.25, 0.01))), volume_correction=False)

    scene = scene_at(0.0)
    objective = Weighted(scene)
    slope = exact_gradient(scene, objective)
    derivative = central(lambda h: value_of(scene_at(h), objective), 1e-5)
    assert slope.along(scene_at, 0.0) == pytest.approx(derivative, rel=5e-6)
    refused(slope.along, lambda h: dataclasses.replace(scene, masses=scene.masses[:1]), 0.0, said="as many particles")
