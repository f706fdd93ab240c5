"""Masses that begin under their own weight: in equilibrium on the grid, within the yield surface, and so at rest."""

import dataclasses
import math
import re
import warnings
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from datasets import Baffle, Mass, Material, Scene, Solid
from datasets.geometry.bodies import scene_height
from datasets.scene.checks import warn_if_unlikely
from datasets.scene.particles import initial_particles
from mpm import WITH_FIELDS, simulate
from mpm.arrays.layout import Precision
from mpm.initial.stress import initial_tractions, warn_of_ratio
from mpm.resolution import characteristic_length
from tests.mpm.element import tensor
from tests.refusals import refused
from tests.scenes import SAND, scene_of, with_masses
from validation.bench.stability.exact_solutions import SlidingBlock
from validation.bench.stability.quantities import thrust_ratio

CELL = 0.02
BED_2D = scene_of(Mass(lower=(0.0, 0.0), size=(1.0, 0.4), k0=0.5), size=(1.0, 0.6), cell=CELL, duration=0.25)
BED_3D = scene_of(
    Mass(lower=(0.0, 0.0, 0.0), size=(0.2, 0.1, 0.1), k0=0.5), size=(0.2, 0.2, 0.1), cell=CELL, jitter=0.4, duration=0.5
)


def stress_of(scene: Scene) -> NDArray[np.float64]:
    return initial_tractions(scene, initial_particles(scene))[0]


def fastest(scene: Scene, precision: Precision) -> float:
    """Largest speed of any particle in any frame [m/s]."""
    velocities = simulate(scene, precision=precision, threads=1, record=WITH_FIELDS).velocities
    return float(np.linalg.norm(velocities, axis=2).max())


def row_means(scene: Scene, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means over the rows of cells, from the floor up."""
    row = (initial_particles(scene).positions[:, 1] / CELL).astype(int)
    return np.bincount(row, values) / np.bincount(row)


@pytest.mark.parametrize("scene", [BED_2D, pytest.param(BED_3D, marks=pytest.mark.slow)], ids=["2D", "3D"])
@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_a_geostatic_bed_is_at_rest_from_the_first_frame(scene: Scene, precision: Precision) -> None:
    assert fastest(scene, precision) <= (1.0e-12 if scene is BED_2D and precision == "f64" else 1.0e-6)


@pytest.mark.parametrize("k0", [0.45, 1.0, 2.0])
def test_rows_have_the_geostatic_stress_and_its_ratio(k0: float) -> None:
    # Without jitter row by row, but for the half cell at the floor, whose lowest nodes do not mirror the motion above.
    level = with_masses(BED_2D, dataclasses.replace(BED_2D.masses[0], k0=k0), jitter=0.0)
    depth = row_means(level, 0.4 - initial_particles(level).positions[:, 1])
    weight = SAND.density * level.gravity * depth
    stress = stress_of(level)
    vertical, lateral = row_means(level, -stress[:, 1]) / weight, row_means(level, -stress[:, 0]) / weight
    np.testing.assert_allclose(vertical[2:-1], 1.0, rtol=0.01)
    np.testing.assert_allclose(vertical, 1.0, rtol=0.1)
    np.testing.assert_allclose(lateral[1:], k0, rtol=0.01)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:no initial stress within the yield surface has")
@pytest.mark.parametrize("k0", [0.36, 0.5, 1.0, 2.5])
@pytest.mark.parametrize("scene", [BED_2D, BED_3D], ids=["2D", "3D"])
def test_no_particle_is_beyond_yield(scene: Scene, k0: float) -> None:
    mass = dataclasses.replace(scene.masses[0], k0=k0)
    principal = np.linalg.eigvalsh(tensor(stress_of(with_masses(scene, mass))))
    scale, sine = np.abs(principal).max(), np.sin(np.radians(SAND.friction_deg))
    assert (principal[:, 2] * (1 + sine) - principal[:, 0] * (1 - sine)).max() <= 1e-9 * scale
    assert principal.max() <= 1e-9 * scale


def test_an_elastic_bed_has_the_ratio_of_poisson() -> None:
    mass = dataclasses.replace(BED_2D.masses[0], k0="elastic")
    scene = with_masses(BED_2D, mass, jitter=0.0)
    stress = stress_of(scene)
    rows = row_means(scene, stress[:, 0]) / row_means(scene, stress[:, 1])
    np.testing.assert_allclose(rows[2:-2], 0.3 / 0.7, rtol=0.01)
    below = initial_particles(scene).positions[:, 1] < 0.38  # single particles of the surface yield
    np.testing.assert_allclose(stress[below, 2], 0.3 * (stress[below, 0] + stress[below, 1]), atol=1e-6)


def test_strength_that_grows_with_depth_bears_a_column() -> None:
    """sigma_1 = gamma z <= 2 c(z) at every depth, though the cohesion of the top would not bear the foot."""
    soil = Material(friction_deg=0.0, cohesion=100.0, strength_gradient=5.0e4, tension_cutoff=1.0e5)
    column = Mass(lower=(0.4, 0.0), size=(0.2, 0.3), k0="elastic")
    stress = stress_of(with_masses(BED_2D, column, material=soil))
    assert stress[:, 1].min() < -2.0 * soil.cohesion_at(0.05)


SILT = Material(friction_deg=30.0, cohesion=2.0e4, young=2.0e7)
STONE = Material(friction_deg=30.0, cohesion=1.0e5, young=6.0e7, density=2400.0)
WEDGE = ((0.0, 0.0), (8.0, 0.0), (4.0, 5.0), (0.0, 5.0))
CAP = ((0.5, 5.0), (3.0, 5.0), (2.5, 6.0), (1.0, 6.0))
HILL = Solid(kind="terrain", points=((0.0, 4.0), (3.0, 4.0), (9.0, 1.0), (12.0, 1.0)), friction=0.8)


def on_ground(*masses: Mass, **changes: Any) -> Scene:
    settings = {"size": (12.0, 7.0), "cell": 0.25, "duration": 0.3, "frame_dt": 0.01} | changes
    return scene_of(*masses, material=SILT, floor_friction=1.0, **settings)


TWO_MATERIALS = on_ground(
    Mass(kind="polygon", vertices=WEDGE, k0="elastic"), Mass(kind="polygon", vertices=CAP, k0="elastic", material=STONE)
)
ON_A_SLOPE = on_ground(Mass(kind="layer", thickness=1.5, k0=0.5), solids=(HILL,), volume_correction=False)


@pytest.mark.parametrize(
    ("scene", "precision", "most"),
    # Particles at the surface of the ground cannot all be balanced there.
    [(TWO_MATERIALS, "f64", 1.0e-9), (ON_A_SLOPE, "f32", 0.015)],
    ids=["two materials", "layer on a slope"],
)
def test_bodies_that_are_no_boxes_stand(scene: Scene, precision: Precision, most: float) -> None:
    """Free of stress at the start they reach 0.46 and 0.11 m/s."""
    assert fastest(scene, precision) <= most


@pytest.mark.slow
def test_a_mesh_stands_in_3d() -> None:
    foot = ((0.0, 0.0), (4.0, 0.0), (2.0, 2.5), (0.0, 2.5))
    vertices = tuple((*corner, z) for z in (0.0, 3.0) for corner in foot)
    sides = [(k, (k + 1) % 4, 4 + (k + 1) % 4, 4 + k) for k in range(4)]
    quads = [(0, 3, 2, 1), (4, 5, 6, 7), *sides]
    triangles = tuple(t for a, b, c, d in quads for t in ((a, b, c), (a, c, d)))
    body = Mass(kind="mesh", vertices=vertices, triangles=triangles, k0="elastic")
    assert fastest(on_ground(body, size=(6.0, 3.0, 3.0), duration=0.1), "f32") <= 0.005


def test_sand_that_cannot_stand_is_said_to_be_unbalanced() -> None:
    column = Mass(lower=(0.4, 0.0), size=(0.2, 0.3), k0="elastic")
    with pytest.warns(UserWarning, match=r"no initial stress .* 0\.\d+ of the weight") as caught:
        stress_of(with_masses(BED_2D, column))
    assert len(caught) == 1


CLAY = Material(friction_deg=30.0, cohesion=1.0e5, tension_cutoff=1.0e5)
FALL = math.tan(math.radians(25.0))
CORNERS = ((0, 0), (1, 0), (1, 1), (0, 1))
BLOCK = [(0.3 + 0.2 * along + 0.1 * up * FALL, 0.55 - FALL * (0.3 + 0.2 * along) + 0.1 * up) for along, up in CORNERS]


def on_incline(how: str, friction: float, angle_deg: float = 25.0) -> Scene:
    """A cohesive body on an incline, by gravity or, of 25 degrees, by terrain."""
    if how == "slope_deg":
        block = Mass(lower=(0.3, 0.0), size=(0.2, 0.1), k0="elastic")
        return scene_of(block, size=(1.0, 0.6), material=CLAY, floor_friction=friction, slope_deg=angle_deg)
    mass = Mass(kind="layer", thickness=0.1, outline=((0.3,), (0.6,)), k0="elastic")
    mass = mass if how == "layer" else Mass(kind="polygon", vertices=tuple(BLOCK), k0="elastic")
    ground = Solid(kind="terrain", points=((0.0, 0.55), (1.0, 0.55 - FALL)), friction=friction)
    return scene_of(mass, size=(1.0, 0.8), material=CLAY, solids=(ground,))


@pytest.mark.parametrize(
    ("how", "angle_deg", "friction"),
    [
        *((how, 25.0, friction) for how in ("slope_deg", "block", "layer") for friction in (0.0, 0.2)),
        *(("slope_deg", *pair) for pair in ((10.0, 0.1), (5.0, 0.05), (25.0, 0.5), (10.0, 0.3), (0.0, 0.05))),
    ],
)
def test_what_is_unbalanced_is_what_friction_does_not_bear(how: str, angle_deg: float, friction: float) -> None:
    """Nodes at which an elastic body would be held by more slip: 0.12 for 0.075 before, 0.079 on a level floor."""
    exact = max(0.0, SlidingBlock.on_incline(angle_deg, friction, 1.0).acceleration)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        stress_of(on_incline(how, friction, angle_deg))
    said = [re.search(r"gravity: (\S+) of the weight", str(warning.message)) for warning in caught]
    close = pytest.approx(exact, abs=0.015 if angle_deg == 25.0 else 0.005)
    assert [float(hit[1]) for hit in said if hit] == ([close] if exact > 0.0 else [])


@pytest.mark.parametrize("stands", [False, True])
def test_a_ratio_needs_something_that_carries_the_mass(stands: bool) -> None:
    """In the air, or on a mass without a `k0`, the first guess had stresses of 1e17 Pa."""
    lower = Mass(lower=(0.0, 0.0), size=(1.0, 0.1), k0=0.5 if stands else None)
    scene = with_masses(BED_2D, lower, Mass(lower=(0.0, 0.1), size=(1.0, 0.2), k0=0.5), duration=0.01)
    if stands:
        simulate(scene, threads=1)
    else:
        said = "masses[1].k0: expected ground or a mass with a k0 beneath the mass, or 'elastic', got 0.5"
        refused(simulate, scene, threads=1, said=said)
        flying = with_masses(scene, dataclasses.replace(scene.masses[1], lower=(0.0, 0.2)))
        refused(simulate, flying, said="masses[0].k0")


@pytest.mark.parametrize(("k0", "cohesion"), [(0.32, 0.0), (3.1, 0.0), (0.19, 100.0)])
def test_a_ratio_beyond_yield_is_refused_with_both_limits(k0: float, cohesion: float) -> None:
    """Rankine's 1/3 and 3; with a cohesion Bell's at the foot, where it adds least: -+ 2 c / (rho g H) sqrt(K)."""
    mass, sand = BED_2D.masses[0], dataclasses.replace(SAND, cohesion=cohesion)
    added = 2.0 * cohesion / (SAND.density * 9.81 * 0.4)
    low, high = (f"{1 / 3 - added / 3**0.5:.3g}", f"{3.0 + added * 3**0.5:.3g}")
    said = f"masses[0].k0: expected a ratio within active and passive yield, {low} to {high}"
    refused(with_masses, BED_2D, dataclasses.replace(mass, k0=k0), material=sand, said=said)
    with_masses(BED_2D, dataclasses.replace(mass, k0=0.334), material=sand)


def test_a_thrust_that_no_stress_has_is_said() -> None:
    scene = with_masses(BED_2D, dataclasses.replace(BED_2D.masses[0], k0=0.34))
    particles = initial_particles(scene)
    lacking = np.full((len(particles.positions), 3, 3), -0.04)
    with pytest.warns(UserWarning, match=r"masses\[0\]\.k0 = 0\.34 on this grid: the thrust is 4 % off"):
        warn_of_ratio(scene, particles, lacking)


TENTHS = [round(0.1 * tenth, 1) for tenth in range(10)]


@pytest.mark.filterwarnings("ignore:no initial stress within the yield surface balances gravity")
@pytest.mark.parametrize(
    ("k0", "dimension", "foot", "shift"),
    [
        (2.9, 2, None, 0.0),
        pytest.param(0.36, 3, None, 0.0, marks=pytest.mark.slow),
        (0.5, 2, 0.3, 0.0),
        (0.5, 2, None, 0.6),
        *(pytest.param(0.5, 2, foot, 0.0, marks=pytest.mark.slow) for foot in TENTHS if foot != 0.3),
        *(pytest.param(0.5, 2, None, shift, marks=pytest.mark.slow) for shift in TENTHS if shift != 0.6),
        *(pytest.param(0.5, 3, foot, 0.0, marks=pytest.mark.slow) for foot in TENTHS),
    ],
)
def test_a_bed_at_rest_presses_on_a_baffle_with_its_ratio_wherever_solids_cut_the_cells(
    k0: float, dimension: int, foot: float | None, shift: float
) -> None:
    """Up to the limits of yield, 1/3 and 3, where 0.34 gave 0.40 and 2.9 gave 2.6 before.

    It was 0.95 and 0.98 of k0 where nodes that solids hold in part gave way to the bed. foot: height of a level terrain
    above a row of nodes [cells]; None: the floor of the box. shift: of the face of the baffle [cells]."""
    cell, near, deep = 0.025, (0.0,) * (dimension - 2), (0.1,) * (dimension - 2)
    low, face = 0.0 if foot is None else 0.1 + foot * cell, 0.6 + shift * cell
    across = {"points": ((0.0, low), (0.8, low))}
    plan = {"origin": (0.0, 0.0), "spacing": (0.1, 0.1), "heights": ((low, low),) * 9}
    ground = Solid(kind="terrain", friction=0.4, **(across if dimension == 2 else plan))
    body = Mass(lower=(0.0, low, *near), size=(face, 0.3, *deep), k0=k0)
    baffle = Baffle(lower=(face, low, *near), size=(0.1, 0.4, *deep))
    solids = {"baffles": (baffle,), "solids": () if foot is None else (ground,)}
    settings = {"floor_friction": 0.4 if k0 == 0.5 else 0.0, "duration": 0.2 if dimension == 2 else 0.1}
    flow = simulate(scene_of(body, size=(0.8, 0.6, *deep), cell=cell, **solids, **settings), threads=1)
    assert thrust_ratio(flow) / np.prod(deep) == pytest.approx(k0, rel=0.02)
    assert np.abs(flow.positions - flow.positions[0]).max() < 1.0e-4


def test_a_layer_on_a_slope_is_as_stiff_as_it_is_thick() -> None:
    """10 rho g h of 1.5 m of snow are 29 kPa, whatever the slope under it falls."""
    snow = Material(friction_deg=21.0, density=200.0, young=2.0e6)
    ground = Solid(kind="terrain", points=((0.0, 140.0), (200.0, 5.0)))
    layer = Mass(kind="layer", thickness=1.5, outline=((20.0,), (180.0,)))
    scene = scene_of(layer, size=(200.0, 150.0), cell=0.5, material=snow, solids=(ground,))
    assert scene_height(scene) == 1.5
    assert characteristic_length(scene) == 1.5
    warn_if_unlikely(scene)
    soft = dataclasses.replace(scene, material=dataclasses.replace(snow, young=2.0e4))
    with pytest.warns(UserWarning, match=r"10 rho g h = 2\.94e\+04 Pa"):
        warn_if_unlikely(soft)


def test_under_ground_no_floor_takes_part_in_the_stress_at_the_start() -> None:
    """A smooth floor below rough ground bears nothing, wherever the ground begins above it."""
    clay = Material(friction_deg=30.0, cohesion=1.0e6, tension_cutoff=1.0e6)

    def stresses(raised: float) -> NDArray[np.float64]:
        ground = Solid(kind="terrain", points=((0.0, 0.2 + raised), (0.5, raised), (1.0, raised)), friction=0.8)
        layer = Mass(kind="layer", thickness=0.1, outline=((0.1,), (0.7,)), k0="elastic")
        return stress_of(scene_of(layer, material=clay, solids=(ground,)))

    above, on = stresses(0.04), stresses(0.0)
    assert np.abs(on - above).max() < 0.02 * np.abs(above).max()
