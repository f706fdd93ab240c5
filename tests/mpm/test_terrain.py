"""Contact with a height field, and lists that hold every face that a particle of a cell can need."""

import dataclasses
import math
from time import process_time

import numpy as np
import pytest
from numpy.typing import NDArray

from datasets.geometry.contact_surface import contact_surface_of
from datasets.geometry.nearest import feet, nearest
from datasets.scene import Baffle, Domain, Mass, Scene, Solid
from datasets.scene.material import Material
from mpm import simulate
from mpm.arrays.layout import PADDING, node_shape
from mpm.solids.bed import Bed, bed_of
from mpm.solids.obstacles import BLEND, Window, faces_near, holds_of, obstacles_in
from mpm.solids.terrain import FADE
from tests.datasets.geometry.solids import surface
from tests.scenes import scene_of

CELL = 0.05


def hill(**changes: object) -> Scene:
    """A layer on a rough incline, posts two cells apart; changes: to the scene."""
    rng = np.random.default_rng(0)
    heights = 0.45 - 0.02 * np.arange(13)[:, None] + 0.04 * rng.random((13, 7))
    ground = Solid(kind="terrain", origin=(0.0, 0.0), spacing=(0.1, 0.1), heights=heights, friction=0.4)
    layer = Mass(kind="layer", thickness=0.12, outline=((0.1, 0.15), (0.6, 0.15), (0.6, 0.45), (0.1, 0.45)))
    soil = Material(friction_deg=30.0, young=1.0e6, density=1500.0)
    settings = {"size": (1.2, 0.8, 0.6), "cell": CELL, "duration": 0.1, "frame_dt": 0.02, "solids": (ground,)} | changes
    return scene_of(layer, material=soil, **settings)


def test_a_raster_of_300_000_posts_is_set_up_at_once() -> None:
    """In 0.5 s of CPU, where a list of its triangles near every cell took more than 40; a baffle stands in it."""
    x = 5.0 * np.arange(550)
    heights = 800.0 * np.exp(-x / 1000.0)[:, None] + 3.0 * np.sin(x / 40.0)[:, None] * np.sin(x / 55.0) + 20.0
    rows = tuple(map(tuple, heights.tolist()))
    started = process_time()
    ground = Solid(kind="terrain", origin=(0.0, 0.0), spacing=(5.0, 5.0), heights=rows, friction=0.4)
    layer = Mass(kind="layer", thickness=5.0, outline=((270.0, 1300.0), (370.0, 1300.0), (370.0, 1400.0)))
    baffle = Baffle(lower=(600.0, 0.0, 1350.0), size=(20.0, 600.0, 40.0))
    settings = {"size": (2740.0, 900.0, 2740.0), "cell": 10.0, "baffles": (baffle,)}
    solids = obstacles_in(scene_of(layer, solids=(ground,), **settings))
    assert process_time() - started < 5.0
    assert len(solids.faces) < 1000
    alone = obstacles_in(hill())
    assert len(alone.faces) == len(alone.near_faces) == len(alone.holds) == 0


def test_sand_that_flies_away_from_a_terrain_keeps_its_parabola_beside_sand_that_lies_there() -> None:
    """It has flown farther than the ground was away at first, so that it is searched for, and not there."""
    level = tuple((0.1,) * 5 for _ in range(9))
    ground = Solid(kind="terrain", origin=(0.0, 0.0), spacing=(0.1, 0.1), heights=level, friction=0.4)
    thrown = Mass(lower=(0.2, 0.2, 0.2), size=(0.05, 0.05, 0.05), velocity=(1.0, 4.0, 0.0))
    lying = Mass(lower=(0.2, 0.1, 0.2), size=(0.1, 0.05, 0.05))
    flow = simulate(scene_of(thrown, lying, solids=(ground,), size=(0.8, 1.2, 0.4), cell=CELL, duration=0.3))
    assert len(flow.positions[0]) < 32, "one block"
    flying = flow.positions[0, :, 1] > 0.2
    moved = (flow.positions[-1] - flow.positions[0])[flying].mean(axis=0)
    # A step of 5 ms takes g t dt / 2 off a parabola.
    assert moved == pytest.approx([0.3, 1.2 - 0.5 * 9.81 * 0.09, 0.0], abs=0.01)


def bed(heights: NDArray[np.float64], spacing: float) -> Bed:
    """Of a raster under the box of the hill."""
    ground = Solid(kind="terrain", origin=(0.0, 0.0), spacing=(spacing, spacing), heights=heights)
    scene = hill(solids=(ground,))
    return bed_of(contact_surface_of(scene).field, scene.domain)


@pytest.mark.parametrize("spacing", [0.1, 0.011, 0.6])
def test_the_bed_of_a_plane_is_the_plane(spacing: float) -> None:
    """In any direction, wherever points lie, for posts closer than the lattice of the bed or farther apart."""
    x, z = (spacing * np.arange(round(length / spacing) + 2) for length in (1.2, 0.6))
    ground = bed(0.5 - 0.3 * x[:, None] + 0.2 * z, spacing)
    points = np.random.default_rng(0).uniform(0.05, [1.15, 0.8, 0.55], (200, 3))
    d, normal, _ = ground.contact(points, np.full((1, 1), 0.4))
    facing = np.array([0.3, 1.0, -0.2]) / math.sqrt(1.13)
    np.testing.assert_allclose(d, (points - [0.0, 0.5, 0.0]) @ facing, atol=1.0e-12)
    np.testing.assert_allclose(normal, np.broadcast_to(facing, normal.shape), atol=1.0e-12)


@pytest.mark.parametrize("shift", [0.0, 0.25, 0.5])
def test_a_crease_is_rounded_by_a_quarter_of_the_lattice_times_its_change_of_slope_at_most(shift: float) -> None:
    """A valley with slopes of 0.5 to both sides; half a cell away from its line the bed is the raster's."""
    posts, line = 0.0125 * np.arange(98), 0.6 + shift * CELL
    ground = bed(0.2 + 0.5 * np.abs(posts[:, None] - line) + np.zeros(50), 0.0125)
    x = np.linspace(0.3, 0.9, 601)
    points = np.stack([x, 0.0 * x, 0.3 + 0.0 * x], axis=1)
    d, normal, _ = ground.contact(points, np.full((1, 1), 0.4))
    raised = -d / normal[:, 1] - (0.2 + 0.5 * np.abs(x - line))
    assert raised.min() > -1.0e-12
    assert 0.1 < raised.max() / (0.5 * CELL) <= 0.25 + 1.0e-9
    assert np.abs(raised[np.abs(x - line) > CELL]).max() < 1.0e-12


def test_friction_goes_to_the_bed_and_back_to_the_posts() -> None:
    rng = np.random.default_rng(2)
    ground = bed(0.2 * rng.random((14, 8)), 0.1)
    posts, adjoint = rng.random(ground.field.heights.shape), rng.random(ground.heights.shape)
    back = np.vdot(posts, ground.to_posts(adjoint))
    assert np.vdot(ground.at_nodes(posts), adjoint) == pytest.approx(back, rel=1e-12)
    assert ground.at_nodes(np.full_like(posts, 0.3)) == pytest.approx(0.3)


X, Z = np.linspace(0.0, 1.0, 14), np.linspace(0.0, 1.0, 11)
WAVES = 0.1 + 0.05 * np.sin(3.0 * X[:, None]) + 0.1 * np.abs(Z - 0.5)
SCENES = {
    2: (
        Solid(kind="terrain", points=((0.0, 0.5), (0.43, 0.2), (1.0, 0.22)), friction=(0.1, 0.3, 0.4)),
        Solid(kind="polygon", vertices=((0.6, 0.4), (0.9, 0.42), (0.7, 0.45), (0.72, 0.8))),
        Solid(lower=(0.2, 0.6), size=(0.013, 0.2), turned_deg=25.0, contact="no-slip"),
    ),
    3: (
        Solid(kind="terrain", origin=(0.0, 0.0), spacing=(1.0 / 13.0, 0.1), heights=WAVES, friction=0.3),
        Solid(lower=(0.5, 0.0, 0.3), size=(0.02, 0.7, 0.3), turned_deg=30.0, friction=0.5),
    ),
}


def mixed(dimension: int) -> Scene:
    """A scene with solids of several kinds and a baffle."""
    body = Mass(lower=(0.9,) * dimension, size=(0.1,) * dimension)
    baffle = Baffle(lower=(0.8, 0.0, 0.8)[:dimension], size=(0.1, 0.6, 0.2)[:dimension])
    return scene_of(body, size=(1.0,) * dimension, cell=CELL, baffles=(baffle,), solids=SCENES[dimension])


def whole_box(domain: Domain) -> Window:
    """All cells of a box and its padding."""
    return Window(low=(0,) * domain.dimension, shape=node_shape(domain), cell=domain.cell)


@pytest.mark.parametrize("cutoff", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_cell_lists_what_its_points_need(dimension: int, cutoff: float) -> None:
    scene = mixed(dimension)
    whole = surface(scene)
    first, near_faces = faces_near(whole_box(scene.domain), whole, cutoff=cutoff)
    rng = np.random.default_rng(3)
    points = rng.uniform(-2.9 * CELL, 1.0 + 2.9 * CELL, (150, dimension))
    cells = whole_box(scene.domain).numbers(np.floor(points / CELL).astype(np.int64) + PADDING)
    seen = nearest(whole, points)
    directions = rng.normal(size=points.shape)
    ends = points + CELL * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    ways = points + np.linspace(0.0, 1.0, 17)[:, None, None] * (ends - points)
    near = 0
    for number, cell in enumerate(cells.tolist()):
        faces = set(near_faces[first[cell] : first[cell + 1]].tolist())
        if abs(seen.distance[number]) <= cutoff * CELL:
            near += 1
            assert int(seen.face[number]) in faces
        # A face that is met on the way comes closer to a sample than the samples lie apart.
        corners = np.broadcast_to(whole.corners, (17, *whole.corners.shape))
        flat = np.repeat(ways[:, number], len(whole.corners), axis=0)
        distance = feet(corners.reshape(-1, dimension, dimension), flat)[1].reshape(17, -1).min(axis=0)
        assert set(np.flatnonzero(distance < 1e-3 * CELL).tolist()) <= faces
    assert near > 8
    lengths = np.diff(first)
    assert lengths.max() < (25 if dimension == 2 else 120)
    assert (lengths == 0).sum() > 0.2 * len(lengths)


@pytest.mark.parametrize("dimension", [2, 3])
def test_holds_of_nodes_are_continuous_in_the_place_of_the_solids(dimension: int) -> None:
    """What all holds of a node take of any velocity into them, sum_k share_k N_k N_k^T."""
    scene = mixed(dimension)
    whole = surface(scene)
    every = np.arange(np.prod(node_shape(scene.domain)))
    # In 3D every fourth node tells as much.
    nodes = every[:: 1 if dimension == 2 else 4]

    def removed(shift: float) -> NDArray[np.float64]:
        moved = dataclasses.replace(whole, corners=whole.corners + shift)
        first, holds = holds_of(whole_box(scene.domain), moved, nodes, cutoff=2.0)
        normal = moved.normals[holds[:, 0].astype(int)]
        taken = np.zeros((len(every), dimension, dimension))
        node = np.repeat(every, np.diff(first))
        np.add.at(taken, node, holds[:, 2, None, None] * normal[:, :, None] * normal[:, None, :])
        return taken[nodes]

    here = removed(0.0)
    depth = -nearest(whole, whole_box(scene.domain).positions(nodes)).distance / CELL
    share = np.trace(here, axis1=1, axis2=2)
    assert np.abs(share[depth <= 0.0]).max() == 0.0
    held = (depth > FADE) & (depth < 2.0)
    assert held.sum() > 10
    np.testing.assert_allclose(share[held], 1.0, atol=1e-12)
    # Shares fall from 1 to 0 over half a cell.
    for shift in (1e-9, -1e-9):
        assert np.abs(removed(shift) - here).max() < 20.0 * abs(shift) / (BLEND * CELL)
