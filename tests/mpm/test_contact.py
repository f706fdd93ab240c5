"""Contact with solids: exact statics at any offset, closed forms of sliding, no leaks, momentum; whole flows."""

import dataclasses
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from datasets.geometry.contact_surface import contact_surface_of
from datasets.geometry.nearest import nearest
from datasets.scene import NO_SLIP, Baffle, Domain, Mass, Scene, Solid
from datasets.scene.material import Material
from mpm import LAST, WITH_FIELDS, runtime, simulate, simulate_many
from mpm.arrays.batch import Batch
from mpm.arrays.layout import PADDING, Contact, node_shape
from mpm.arrays.properties import DRY_GRIP, roughest
from mpm.kernel import compute
from mpm.solids.bed import bed_of
from mpm.solids.obstacles import covered_at
from tests.datasets.geometry.solids import surface
from tests.mpm.test_terrain import hill
from tests.refusals import refused
from tests.scenes import scene_of
from validation.bench.stability.exact_solutions import (
    FreeFlight,
    SlidingBlock,
    centre_displacement,
    settlement,
    total_energy,
)
from validation.bench.stability.invariants import momentum

SAND = Material(friction_deg=30.0, density=1500.0, young=1.0e6, poisson=0.3)
CELL, GRAVITY = 0.02, 9.81
DEPTH = 0.2
sand = partial(scene_of, material=SAND, frame_dt=0.01)


def layer(offset: float, *, dimension: int = 2, terrain: bool = False, **changes: Any) -> Scene:
    """A layer on a level surface `offset` cells above a node, between smooth walls, unstressed at the start."""
    top, width = 5 * CELL + offset * CELL, 0.4 if dimension == 2 else 0.12
    near, deep = (0.0,) * (dimension - 2), (width,) * (dimension - 2)
    baffle = Baffle(lower=(0.0, 0.0, *near), size=(width, top, *deep))
    ground: dict[str, Any] = {"baffles": (baffle,), "baffle_friction": 0.5}
    if terrain:
        line = ((0.0, top), (0.3 * width, top), (width, top))
        ground = {"solids": (Solid(kind="terrain", points=line, friction=0.5),)}
    settings = {"size": (width, 0.4, *deep), "duration": 1.0, "step_fraction": 0.9} | ground | changes
    return sand(Mass(lower=(0.0, top, *near), size=(width, DEPTH, *deep)), **settings)


def slide(height: float, kind: str) -> Scene:
    """A block that slides on rough ground at `height` [cells], in a box whose floor and walls are smooth."""
    top, near, deep = height * CELL, (), ()
    if kind == "box":
        ground = Solid(lower=(0.0, 0.0), size=(1.0, top), friction=0.4)
    else:
        near, deep, rows = (0.0,), (0.12,), ((top, top),) * 2
        ground = Solid(kind="terrain", heights=rows, origin=(0.0, 0.0), spacing=(1.0, 0.12), friction=0.4)
    body = Mass(lower=(0.1, top, *near), size=(0.2, 0.1, *deep), velocity=(1.0, 0.0, *near))
    return sand(body, size=(1.0, 0.3, *deep), solids=(ground,), duration=0.3)


@pytest.mark.parametrize("kind", ["box", pytest.param("raster", marks=pytest.mark.slow)])
def test_under_ground_there_is_no_floor(kind: str) -> None:
    """Ground on the floor brakes a slide like the same ground cells higher, though the floor itself is smooth."""
    heights = (1.0, 3.0) if kind == "box" else (0.0, 1.0, 3.0)
    flows = simulate_many([slide(height, kind) for height in heights], record=LAST)
    moved = [float((flow.positions[-1] - flow.positions[0])[:, 0].mean(dtype=np.float64)) for flow in flows]
    assert moved == pytest.approx([moved[-1]] * len(moved), rel=0.01)


def test_only_a_covered_wall_takes_no_part() -> None:
    """Beside a box the floor remains, on and around its rim; behind a lining of a side there is no wall."""
    box = Solid(lower=(0.2, 0.0), size=(0.2, 0.02))
    lining = Solid(lower=(0.98, 0.0), size=(0.02, 0.3))
    scene = sand(Mass(lower=(0.5, 0.0), size=(0.1, 0.1)), size=(1.0, 0.3), solids=(box, lining))
    nodes = np.moveaxis(np.indices(node_shape(scene.domain)), 0, -1)[PADDING:-PADDING, PADDING:-PADDING]
    sides = covered_at(scene, nodes.reshape(-1, 2)).reshape(nodes.shape[:2])
    floor = np.flatnonzero(sides[:, 0] & 4)
    assert floor.tolist() == [*range(12, 19)]
    assert (sides[-1] & 2 == 2).all()
    assert not (sides[:-1] & 2).any()
    assert not (sides & (1 | 8)).any()


@pytest.mark.parametrize(
    ("offset", "changes"),
    [
        *((offset, {}) for offset in (0.0, 0.25, 0.5, 0.83)),
        (0.37, {"terrain": True}),
        pytest.param(0.6, {"dimension": 3, "duration": 0.6}, marks=pytest.mark.slow),
    ],
)
def test_a_layer_rests_wherever_its_ground_cuts_the_cells(offset: float, changes: dict[str, Any]) -> None:
    """It neither sinks nor rises beyond its elastic settlement, gains no energy, and weighs what it weighs."""
    scene = layer(offset, **changes)
    flow, top, since = simulate(scene), 5 * CELL + offset * CELL, 40 if scene.dimension == 2 else 20
    weight = SAND.density * GRAVITY * DEPTH * np.prod([s for k, s in enumerate(scene.domain.size) if k != 1])
    height = flow.positions[:, :, 1].mean(axis=1)
    # The mean sinks by two thirds of the surface.
    assert height[since:].mean() - height[0] == pytest.approx(-2.0 / 3.0 * settlement(scene), abs=0.05 * CELL)
    energy = total_energy(flow)
    assert energy.max() - energy[0] <= 1.0e-3 * weight * 0.5 * DEPTH
    given = flow.solid_impulse[-1, 0] - flow.solid_impulse[since, 0]
    force = given / (flow.time[-1] - flow.time[since])
    assert force[1] == pytest.approx(-weight, rel=0.01)
    assert flow.positions[:, :, 1].min() >= top - 1.0e-5 * CELL


@pytest.mark.slow
def test_a_kinked_terrain_and_a_funnel_do_not_leak() -> None:
    """No particle is inside of them, in any tenth frame."""
    for points in (
        ((0.0, 0.45), (0.35, 0.2), (0.4, 0.27), (0.8, 0.05)),
        ((0.0, 0.5), (0.28, 0.1), (0.3, 0.1), (0.58, 0.5), (0.8, 0.5)),
    ):
        ground = Solid(kind="terrain", points=points, friction=0.4)
        scene = sand(Mass(lower=(0.05, 0.52), size=(0.5, 0.2)), size=(0.8, 0.8), solids=(ground,), duration=0.8)
        for positions in simulate(scene).positions[::10]:
            assert nearest(surface(scene), positions.astype(float)).distance.min() > -1.0e-5 * CELL


@pytest.mark.double
@pytest.mark.filterwarnings("ignore:masses:UserWarning")
def test_momentum_goes_into_walls_and_solids_alone() -> None:
    """P(t) - P(0) = M g t less what every side of the box and every solid took, a slope and a turned box among them.

    A layer of a seventh of a cell is there too, whose particles are smaller."""
    masses = Mass(lower=(0.0, 0.36), size=(0.2, 0.2)), Mass(lower=(0.2, 0.4), size=(0.2, 0.003))
    ground = Solid(kind="terrain", points=((0.0, 0.35), (0.5, 0.1), (1.0, 0.06)), friction=0.2)
    turned = Solid(lower=(0.6, 0.1), size=(0.1, 0.1), turned_deg=30.0, friction=0.4)
    scene = sand(*masses, size=(1.0, 0.6), solids=(ground, turned), duration=0.6)
    flow = simulate(scene, record=WITH_FIELDS, precision="f64")
    balance = momentum(flow)
    assert balance.value < 1.0e-5
    assert flow.solid_impulse[-1, 1, 0] > 0.0


SLAB = Solid(lower=(0.0, 0.0), size=(0.6, 0.047), friction=0.3)


@pytest.mark.filterwarnings("ignore:no initial stress:UserWarning")
@pytest.mark.parametrize(
    ("top", "stuck", "smooth"),
    [
        (0.0, {"floor_friction": "rough"}, {"floor_friction": 0.3}),
        (0.047, {"solids": (dataclasses.replace(SLAB, contact="no-slip"),)}, {"solids": (SLAB,)}),
        (0.047, {"solids": (dataclasses.replace(SLAB, friction=1.5),)}, {"solids": (SLAB,)}),
    ],
    ids=["rough floor", "no slip", "friction"],
)
def test_a_block_stands_where_it_is_held_and_slides_by_the_closed_form(
    top: float, stuck: dict[str, Any], smooth: dict[str, Any]
) -> None:
    """At 40 degrees, on the floor and on a solid that ends between two rows of nodes."""
    strong = Material(friction_deg=45.0, cohesion=1.0e9, tension_cutoff=1.0e9, young=1.0e7)
    settings = {"size": (0.6, 0.4), "slope_deg": 40.0, "duration": 0.2, "volume_correction": False}
    scene = sand(Mass(lower=(0.1, top), size=(0.2, 0.02), k0="elastic"), material=strong, **settings)
    flows = [simulate(dataclasses.replace(scene, **changes)) for changes in (stuck, smooth)]
    held, slid = (float((flow.positions[-1] - flow.positions[0])[:, 0].mean()) for flow in flows)
    assert abs(held) < 0.01 * slid
    assert slid == pytest.approx(SlidingBlock.on_incline(40.0, 0.3).displacement(0.2), rel=0.005)


@pytest.mark.slow
def test_open_sides_let_sand_out_and_count_it() -> None:
    body = Mass(lower=(0.2, 0.0), size=(0.2, 0.3))
    scene = sand(body, size=(0.6, 0.4), open_sides=("x+",), floor_friction=0.2, duration=1.0)
    flow = simulate(scene)
    wide = dataclasses.replace(scene, domain=Domain(size=(2.0, 0.4), cell=CELL), open_sides=())
    beyond = float((simulate(wide).positions[-1, :, 0] > 0.6).mean())
    total = SAND.density * 0.2 * 0.3
    share = flow.summary["outflow"]["x+"] / total
    assert share == pytest.approx((flow.positions[-1, :, 0] > 0.6).mean(), abs=1.0e-9)
    assert share == pytest.approx(beyond, rel=0.15)
    assert beyond > 0.05


@pytest.mark.parametrize("raised", [0.0, 0.3 * CELL])
def test_sand_that_strikes_ground_at_the_foot_of_an_open_box_stays_in_it(raised: float) -> None:
    """Before contact puts it back, a step carries it below y = 0."""
    body = Mass(lower=(0.5, 0.1 + raised), size=(0.2, 0.1), velocity=(0.0, -8.0))
    ground = Solid(kind="terrain", points=((-1.0, raised), (3.0, raised)), friction=0.4)
    scene = sand(body, size=(1.2, 0.4), open_sides=("x-", "x+"), solids=(ground,), duration=0.05)
    flow = simulate(scene)
    assert flow.summary["outflow"] == {"x-": 0.0, "x+": 0.0}
    assert flow.positions[-1, :, 1].min() >= raised - 1.0e-6
    # Lost sand would lie where it was lost.
    assert flow.positions[-1, :, 1].mean() > raised + 0.03


def through_a_slot(dimension: int) -> Scene:
    """Sand thrown through a slot between two baffles, over a step in it."""
    deep = (0.0,) * (dimension - 2)
    size = (0.4, 0.24, *(0.08 for _ in deep))
    boxes = (((0.16, 0.0), (0.2, 0.05)), ((0.16, 0.09), (0.2, 0.06)), ((0.24, 0.05), (0.03, 0.013)))
    body = Mass(lower=(0.02, 0.02, *deep), size=(0.12, 0.12, *size[2:]), velocity=(3.0, 0.0, *deep))
    baffles = tuple(Baffle(lower=(*low, *deep), size=(*span, *size[2:])) for low, span in boxes)
    # Without gaps, by the kernels of the next tests.
    settings = {"volume_correction": False, "duration": 0.06, "step_fraction": 0.9}
    return sand(body, size=size, baffles=baffles, **settings)


def distance_from(scene: Scene, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of points [m], shape [N, D], from the nearest face of its solids or the bed of its terrain [m], shape [N]."""
    solid = contact_surface_of(scene)
    distance = nearest(solid.faces, points).distance
    if solid.field is not None:
        bed = bed_of(solid.field, scene.domain)
        distance = np.minimum(distance, bed.contact(points, solid.field.friction)[0])
    return distance


ON_HILL = hill(baffles=(Baffle(lower=(0.62, 0.0, 0.2), size=(0.05, 0.6, 0.2)),))


@pytest.mark.double
@pytest.mark.parametrize(
    "scene",
    [through_a_slot(2), through_a_slot(3), pytest.param(ON_HILL, marks=pytest.mark.slow)],
    ids=["2D", "3D", "beside a baffle on rough ground"],
)
def test_the_face_that_is_followed_is_the_nearest(scene: Scene) -> None:
    """Distance and normal are those of a search of all faces; nothing is in a solid."""
    runtime.start("f64", enough=1)
    batch, cell = Batch([scene], precision="f64", record=LAST), scene.domain.cell
    contacts, solid = batch.features.state.contacts, contact_surface_of(scene)
    for frame in range(1, scene.frames):
        compute(batch, frame + 1, 1)
        points = batch.numbers(0, 0, scene.dimension).T
        distance = distance_from(scene, points)
        assert distance.min() > -1.0e-5 * cell
        exact = np.clip(distance, 0.0, None)
        followed = batch.numbers(0, contacts, len(Contact))[Contact.DISTANCE]
        assert (followed <= exact + 1.0e-9 * cell)[exact < 2.0 * cell].all()
        assert np.abs(followed - exact)[exact < cell].max(initial=0.0) < 1.0e-9 * cell
        seen = nearest(solid.faces, points)
        apart = (exact > 1.0e-3 * cell) & (exact < cell) & (seen.distance == distance)
        facing = batch.numbers(0, contacts + Contact.NORMAL, scene.dimension).T
        assert np.abs(facing - seen.normal)[apart].max(initial=0.0) < 1.0e-6
    assert (exact < cell).sum() > 20


@pytest.mark.double
def test_an_impact_is_continuous_in_the_speed() -> None:
    """By the sign of a stress that rounding leaves, a tenth of a nanometre a second moved sand by 0.3 mm."""

    def positions(speed: float) -> Any:
        body = Mass(lower=(0.1, 0.025, 0.1), size=(0.3, 0.2, 0.3), velocity=(speed, 0.0, 0.0))
        settings = {"size": (1.0, 0.5, 0.5), "cell": 1.0 / 32.0, "duration": 0.1, "step_fraction": 0.9}
        baffles = (Baffle(lower=(0.5, 0.0, 0.125), size=(0.125, 0.25, 0.125)),)
        # Of contact alone: a gap begins to count at once, and sand that splashes is chaotic.
        scene = sand(body, material=Material(friction_deg=35.0), baffles=baffles, volume_correction=False, **settings)
        return simulate(scene, precision="f64").positions[-1]

    assert np.abs(positions(2.0 + 1.0e-10) - positions(2.0)).max() < 2.0e-6


@pytest.mark.double
@pytest.mark.parametrize("shift", [-1.0e-8, pytest.param(1.0e-8, marks=pytest.mark.slow)])
def test_the_flow_is_continuous_in_the_place_of_a_baffle_whose_sides_stand_on_nodes(shift: float) -> None:
    """Held from half a cell of depth on, by the nearest face alone, nodes let sand jump by 0.3 mm."""

    def positions(x: float) -> Any:
        column, baffle = Mass(lower=(0.0, 0.0), size=(0.2, 0.3)), Baffle(lower=(x, 0.0), size=(0.05, 0.08))
        settings = {"size": (1.0, 0.6), "cell": 0.01, "floor_friction": 0.4, "duration": 0.25, "frame_dt": 0.01}
        settings["volume_correction"] = False
        return simulate(scene_of(column, baffles=(baffle,), **settings), precision="f64", record=LAST).positions[-1]

    assert np.abs(positions(0.3 + shift) - positions(0.3)).max() < 3.0e-6


@pytest.mark.parametrize(
    ("wall", "cell", "cohesion"),
    [("rough", 0.01, 0.0), ("rough", 0.02, 0.0), ("rough", 0.02, 10.0), ("no-slip", 0.01, 0.0)],
)
def test_a_rough_wall_does_not_hold_sand_that_falls_beside_it(wall: str, cell: float, cohesion: float) -> None:
    """Sand that presses on nothing rubs on nothing: 0.96 of free fall before, and 0.92 on cells of 20 mm.

    Cohesion may hold it by c h t, 0.3 % at 10 Pa."""
    block = Solid(kind="box", lower=(0.0, 0.0), size=(0.2, 0.6), contact="no-slip")
    beside, solids = (0.2, (block,)) if wall == "no-slip" else (0.0, ())
    body, friction = Mass(lower=(beside, 0.3), size=(0.2, 0.2)), 0.0 if solids else "rough"
    settings = {"cell": cell, "solids": solids, "wall_friction": friction, "duration": 0.11}
    flow = simulate(sand(body, size=(0.6, 0.6), material=dataclasses.replace(SAND, cohesion=cohesion), **settings))
    fall = FreeFlight.of_flow(flow).displacement(flow.time)[-1, 1]
    assert centre_displacement(flow)[-1, 1] == pytest.approx(fall, rel=0.01)


def test_what_is_rough_holds_clay_alone() -> None:
    clay = Material(friction_deg=30.0, cohesion=1.0e4, tension_cutoff=1.0e4)
    scene = sand(Mass(lower=(0.0, 0.3), size=(0.2, 0.2)), size=(0.6, 0.6), material=clay, wall_friction="rough")
    weak = dataclasses.replace(clay, cohesion=1.0, tension_cutoff=0.0)
    assert roughest(scene) > 10.0 * DRY_GRIP
    assert roughest(dataclasses.replace(scene, material=weak)) == pytest.approx(DRY_GRIP, rel=0.01)
    assert roughest(dataclasses.replace(scene, material=SAND)) == DRY_GRIP
    assert roughest(dataclasses.replace(scene, gravity=0.0)) == NO_SLIP
    baffle = Baffle(lower=(0.4, 0.0), size=(0.1, 0.1), friction="rough")
    assert np.isinf(surface(dataclasses.replace(scene, baffles=(baffle,))).friction).all()
    refused(dataclasses.replace, scene, wall_friction="glued", said="'rough', got 'glued'")
