"""Contact with a height field is that with its triangles."""

from time import process_time

import numpy as np
import pytest

from datasets.geometry.nearest import nearest
from datasets.scene import Baffle, Mass, Scene, Solid
from datasets.scene.material import Material
from mpm import LAST, runtime, simulate
from mpm.arrays.batch import Batch
from mpm.arrays.layout import Contact, Offset, node_shape
from mpm.kernel import Phase, kernel
from mpm.solids.obstacles import obstacles_in
from tests.datasets.geometry.solids import surface
from tests.scenes import scene_of

CELL = 0.05


def hill(**changes: object) -> Scene:
    """A layer on a rough incline, posts two cells apart."""
    rng = np.random.default_rng(0)
    heights = 0.45 - 0.02 * np.arange(13)[:, None] + 0.04 * rng.random((13, 7))
    rows = tuple(map(tuple, heights.tolist()))
    ground = Solid(kind="terrain", origin=(0.0, 0.0), spacing=(0.1, 0.1), heights=rows, friction=0.4)
    layer = Mass(kind="layer", thickness=0.12, outline=((0.1, 0.15), (0.6, 0.15), (0.6, 0.45), (0.1, 0.45)))
    soil = Material(friction_deg=30.0, young=1.0e6, density=1500.0)
    settings = {"size": (1.2, 0.8, 0.6), "cell": CELL, "duration": 0.1, "frame_dt": 0.02} | changes
    return scene_of(layer, material=soil, solids=(ground,), **settings)


@pytest.mark.double
@pytest.mark.slow
def test_the_distance_is_that_from_the_nearest_of_all_faces() -> None:
    """On rough ground and beside a baffle that stands in it; nothing is in a solid."""
    scene = hill(baffles=(Baffle(lower=(0.62, 0.0, 0.2), size=(0.05, 0.6, 0.2)),))
    runtime.start("f64", enough=1)
    batch = Batch([scene], precision="f64", record=LAST)
    for frame in range(1, scene.frames):
        kernel(batch.features)(*batch.arguments.values(), frame, frame + 1, Phase.FRAMES)
        exact = nearest(surface(scene), batch.numbers(0, 0, 3).T)
        found = batch.numbers(0, batch.features.state.contacts, len(Contact))[Contact.DISTANCE]
        assert exact.distance.min() > -1.0e-5 * CELL
        apart = np.clip(exact.distance, 0.0, None)
        assert (found <= apart + 1.0e-9 * CELL).all()
        assert np.abs(found - apart)[apart < CELL].max() < 1.0e-9 * CELL
    assert (apart < CELL).sum() > 100


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


def test_nothing_of_a_height_field_is_listed() -> None:
    scene = hill()
    solids = obstacles_in(scene)
    assert len(solids.faces) == len(solids.near_faces) == len(solids.holds) == 0
    assert len(solids.cell_faces) == len(solids.covered) == 1
    batch = Batch([scene], precision="f32", record=LAST)
    posts = 13 * 7
    assert posts < len(batch.terrain) < 2 * posts + 50
    assert batch.offsets[0, Offset.POSTS_X] >= 13
    assert batch.offsets[0, Offset.POSTS_Z] >= 7
    assert batch.column_heights.size == 1 + np.prod(node_shape(scene.domain)[::2])


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
