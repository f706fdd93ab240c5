"""Listed faces and the raster's triangles together are the surface of everything solid."""

import numpy as np
import pytest

from datasets.geometry.contact_surface import contact_surface_in, has_faces, has_field, with_rectangle
from datasets.geometry.nearest import nearest
from datasets.geometry.surface import surface_in
from datasets.scene import Baffle, Domain, Mass, Solid
from tests.scenes import scene_of

BOX = Domain(size=(2.0, 1.0, 1.0), cell=0.05)
SOLIDS = (
    Solid(lower=(0.93, 0.0, 0.33), size=(0.1, 0.6, 0.27), friction=0.2),
    Solid(lower=(1.5, 0.0, 0.0), size=(0.1, 0.7, 0.27), friction=0.2, turned_deg=20.0),
)


def terrain(roughness: float) -> Solid:
    """An incline of 0.2 with posts 0.1 m apart, raised at random."""
    rng = np.random.default_rng(0)
    heights = 0.5 - 0.02 * np.arange(21)[:, None] + roughness * rng.random((21, 11))
    return Solid(kind="terrain", origin=(0.0, 0.0), spacing=(0.1, 0.1), heights=tuple(map(tuple, heights.tolist())))


@pytest.mark.parametrize("roughness", [0.0, 0.06])
def test_distances_are_those_of_the_whole_surface(roughness: float) -> None:
    solids, keys = (SOLIDS[0], terrain(roughness), SOLIDS[1]), ("a", "b", "c")
    whole, found = surface_in(BOX, solids, keys), contact_surface_in(BOX, solids, keys)
    points = np.random.default_rng(1).uniform([-0.1, 0.1, -0.1], [2.1, 1.0, 1.1], (2000, 3))
    near, numbers = found.around(points, 0.2)
    ours, theirs = nearest(near, points), nearest(whole, points)
    np.testing.assert_allclose(ours.distance, theirs.distance, atol=1.0e-12)
    np.testing.assert_allclose(ours.foot, theirs.foot, atol=1.0e-12)
    assert (near.solid[ours.face] == whole.solid[theirs.face]).all()
    assert len(np.unique(numbers)) == len(numbers)
    assert 0 < len(found.faces.corners) < 0.3 * len(whole.corners)


def test_one_terrain_in_3d_is_a_height_field() -> None:
    body = Mass(lower=(0.0, 0.9, 0.0), size=(0.1, 0.1, 0.1))
    alone = scene_of(body, size=BOX.size, cell=BOX.cell, solids=(terrain(0.0),))
    assert has_field(alone)
    assert not has_faces(alone)
    baffle = Baffle(lower=(1.0, 0.0, 0.4), size=(0.1, 0.6, 0.2))
    behind = scene_of(body, size=BOX.size, cell=BOX.cell, solids=(terrain(0.0),), baffles=(baffle,))
    assert has_field(behind)
    assert has_faces(behind)
    two = scene_of(body, size=BOX.size, cell=BOX.cell, solids=(terrain(0.0), terrain(0.01)))
    assert not has_field(two)
    assert has_faces(two)


def test_rectangles_of_cells_stay_apart() -> None:
    """Those that come within three cells of each other become one."""
    found = with_rectangle([(0, 2, 0, 2), (10, 12, 0, 2)], (4, 6, 1, 3))
    assert sorted(found) == [(0, 6, 0, 3), (10, 12, 0, 2)]
    assert with_rectangle(found, (8, 9, 0, 1)) == [(0, 12, 0, 3)]
