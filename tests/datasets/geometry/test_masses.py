"""Bodies of every kind: exact volume, particles inside, one line for what is no body."""

import dataclasses
from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest
import shapely

from datasets.geometry.bodies import filling
from datasets.geometry.placement import heights_above_ground, remembers_gaps
from datasets.scene import Mass, Scene, Solid
from datasets.scene.particles import initial_particles, mass_centroids, mass_volumes, particle_count, warn_if_unresolved
from tests import scenes
from tests.datasets.geometry.solids import as_rows, sphere
from tests.refusals import refused

SLOPE = Solid(kind="terrain", points=((0.0, 0.5), (1.0, 0.1), (2.0, 0.1)))
HEIGHTS = tuple(tuple(0.1 + 0.4 * abs(z - 0.5) for z in np.linspace(0.0, 1.0, 11)) for _ in range(21))
VALLEY = Solid(kind="terrain", origin=(0.0, 0.0), spacing=(0.1, 0.1), heights=HEIGHTS)
TRIANGLE = ((0.5, 0.1), (1.0, 0.1), (0.5, 0.6))


def scene_of(*masses: Mass, solids: tuple[Solid, ...] = (), dimension: int = 2, **changes: Any) -> Scene:
    """Masses in a box of 2 x 1 x 1 m on cells of 5 cm."""
    return scenes.scene_of(*masses, solids=solids, size=(2.0, 1.0, 1.0)[:dimension], **{"cell": 0.05} | changes)


def ball(centre: tuple[float, float, float], radius: float) -> Mass:
    vertices, triangles = sphere(centre, radius, 32)
    return Mass(kind="mesh", vertices=as_rows(vertices), triangles=as_rows(triangles))


def polygon(*vertices: tuple[float, float]) -> Mass:
    return Mass(kind="polygon", vertices=vertices)


def test_a_polygon_has_its_area_and_holds_its_particles() -> None:
    scene = scene_of(Mass(kind="polygon", vertices=TRIANGLE, velocity=(1.0, 0.0)), cell=0.02)
    particles = initial_particles(scene)
    assert particles.volume.sum() == pytest.approx(0.125, rel=1e-12)
    assert particle_count(scene) == len(particles.positions) == pytest.approx(0.125 / 1e-4, rel=0.02)
    assert shapely.contains_xy(shapely.Polygon(TRIANGLE), *particles.positions.T).all()
    assert (particles.velocities == [1.0, 0.0]).all()
    assert scene.masses[0].lower == (0.5, 0.1)
    np.testing.assert_allclose(scene.masses[0].size, (0.5, 0.5))
    # The jitter moved them.
    still = initial_particles(dataclasses.replace(scene, jitter=0.0)).positions
    assert (np.abs(particles.positions - still).max(axis=1) > 1e-6).mean() > 0.8
    assert np.abs(particles.positions - still).max() <= 0.4 * 0.01 + 1e-12


def test_a_mesh_has_its_volume_and_holds_its_particles() -> None:
    scene = scene_of(ball((1.0, 0.5, 0.5), 0.3), dimension=3)
    particles = initial_particles(scene)
    vertices, triangles = sphere((0.0, 0.0, 0.0), 0.3, 32)
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    assert particles.volume.sum() == pytest.approx(np.einsum("ni,ni->", a, np.cross(b, c)) / 6.0, rel=1e-12)
    assert (np.linalg.norm(particles.positions - [1.0, 0.5, 0.5], axis=1) < 0.3).all()
    assert len(particles.positions) * 0.025**3 == pytest.approx(4.0 / 3.0 * np.pi * 0.3**3, rel=0.03)


def test_a_layer_follows_the_ground_in_2d() -> None:
    scene = scene_of(Mass(kind="layer", thickness=0.1, outline=((0.2,), (1.4,))), solids=(SLOPE,))
    particles = initial_particles(scene)
    above = particles.positions[:, 1] - np.interp(particles.positions[:, 0], [0.0, 1.0, 2.0], [0.5, 0.1, 0.1])
    assert particles.volume.sum() == pytest.approx(0.12, rel=1e-12)
    assert above.min() > 0.0
    assert above.max() < 0.1
    np.testing.assert_allclose(particles.depth, 0.1 - above, atol=1e-12)
    assert 0.2 < particles.positions[:, 0].min() < 0.23
    assert 1.37 < particles.positions[:, 0].max() < 1.4
    # As many in every stretch.
    counts, _ = np.histogram(particles.positions[:, 0], bins=np.linspace(0.2, 1.4, 13))
    assert counts.max() - counts.min() <= 4
    assert (heights_above_ground(scene) == 0.0).all()


@pytest.mark.parametrize("outline", [None, ((0.5, 0.2), (1.5, 0.2), (1.0, 0.8))])
def test_a_layer_on_a_height_field(outline: tuple[tuple[float, float], ...] | None) -> None:
    rows = tuple(tuple(0.1 + 0.1 * x for _ in range(6)) for x in np.linspace(0.0, 2.0, 11))
    area, mean_x = (2.0, 1.0) if outline is None else (0.3, 1.0)
    for thickness, extra, volume in (
        (0.1, {}, 0.1 * area),
        (rows, {"origin": (0.0, 0.0), "spacing": (0.2, 0.2)}, (0.1 + 0.1 * mean_x) * area),
    ):
        mass = Mass(kind="layer", thickness=thickness, outline=outline, **extra)
        scene = scene_of(mass, solids=(VALLEY,), dimension=3)
        particles = initial_particles(scene)
        x, y, z = particles.positions.T
        above = y - 0.1 - 0.4 * np.abs(z - 0.5)
        assert mass_volumes(scene)[0] == pytest.approx(volume, rel=1e-9)
        assert particles.volume.sum() == pytest.approx(volume, rel=1e-9)
        assert above.min() > 0.0
        # A thickness is that of the cell of 0.2 m around its place.
        assert (above < (0.1 if extra == {} else 0.1 + 0.02 * np.rint(x / 0.2))).all()
        if outline is not None:
            assert shapely.contains_xy(shapely.Polygon(outline), x, z).all()


@pytest.mark.parametrize(("thin", "share"), [(0.012, 0.178), (0.05, 0.0)])
def test_parts_too_thin_for_any_particle_are_warned_of(thin: float, share: float) -> None:
    """A column of 0.1 m2 on a foot 1.8 m long: what has no particle near it is said, of polygons and of meshes."""
    tall = ((0.0, 0.0), (1.9, 0.0), (1.9, thin), (0.2, thin), (0.2, 0.5), (0.0, 0.5))
    scene = scene_of(polygon(*tall))
    missed = filling(scene, scene.masses[0]).missed()
    assert missed == pytest.approx(share, abs=0.01)
    warned = pytest.warns(UserWarning, match=r"masses\[0\]: 1\d% of its volume is thinner")
    with warned if share > 0.0 else nullcontext():
        warn_if_unresolved(scene)
    round_scene = scene_of(ball((1.0, 0.5, 0.5), 0.3), dimension=3)
    assert filling(round_scene, round_scene.masses[0]).missed() == 0.0


@pytest.mark.parametrize("jitter", [0.0, 0.8])
def test_each_cell_of_a_thickness_holds_its_own_volume(jitter: float) -> None:
    # Thinner than half a row, thicker than several, none; rows of the lattice are 25 mm high.
    given = ((0.1, 0.012), (0.03, 0.0), (0.004, 0.3), (0.047, 0.05))
    mass = Mass(kind="layer", thickness=given, origin=(0.25, 0.25), spacing=(0.5, 0.5))
    scene = scene_of(mass, solids=(dataclasses.replace(VALLEY, friction=0.3),), dimension=3, jitter=jitter)
    particles, thickness = initial_particles(scene), np.array(given)
    x, y, z = particles.positions.T
    held, _, _ = np.histogram2d(x, z, bins=(np.arange(5) * 0.5, np.arange(3) * 0.5), weights=particles.volume)
    np.testing.assert_allclose(held, 0.25 * thickness, rtol=1e-9)
    here = thickness[(x // 0.5).astype(int), (z // 0.5).astype(int)]
    above = y - 0.1 - 0.4 * np.abs(z - 0.5)
    # The raster of the valley is linear between its posts.
    assert (above > -1e-3).all()
    assert (above < here + 1e-3).all()
    assert particles.volume.sum() == pytest.approx(mass_volumes(scene)[0], rel=1e-12)
    centre = np.average(np.stack([x, z]), axis=1, weights=particles.volume)
    np.testing.assert_allclose(mass_centroids(scene)[0, [0, 2]], centre, atol=2e-3)


BOX, BALL = Mass(lower=(0.1, 0.3), size=(0.3, 0.3)), ball((1.0, 0.5, 0.5), 0.2)
OPEN = dataclasses.replace(BALL, triangles=(BALL.triangles or ())[1:])
SWAPPED = dataclasses.replace(BALL, triangles=((BALL.triangles or ())[0][::-1], *(BALL.triangles or ())[1:]))
LAYER_BESIDE = Mass(kind="layer", thickness=((0.1,),), origin=(3.0, 0.5), spacing=(0.5, 0.5))
THIN = Solid(lower=(1.4, 0.3), size=(0.001, 0.1), turned_deg=10.0)
REFUSED: list[tuple[int, list[Mass], list[Solid], str]] = [
    (2, [polygon((0.1, 0.1), (0.5, 0.5), (0.5, 0.1), (0.1, 0.5))], [], "masses[0].vertices: expected a polygon that"),
    (2, [polygon((0.1, 0.1), (2.5, 0.1), (0.5, 0.5))], [], "masses[0]: expected a polygon inside the domain"),
    (2, [Mass(kind="layer", thickness=-1.0)], [], "masses[0].thickness: expected thicknesses in m of at least 0"),
    (2, [dataclasses.replace(BOX, thickness=0.1)], [], "masses[0].thickness: expected no such key of kind box"),
    (2, [Mass(lower=(0.1, 0.1))], [], "masses[0].size: expected a value, the key is missing"),
    (3, [dataclasses.replace(LAYER_BESIDE, thickness=((0.1, 0.2), (0.1,)))], [], "thickness[1]: expected 2 lengths"),
    (3, [BALL, LAYER_BESIDE], [], "masses[1]: expected a layer that lies in the box"),
    (3, [OPEN], [], "masses[0].triangles: expected a closed surface, got one with 3 open edges"),
    (3, [SWAPPED], [], "masses[0].triangles: expected a closed surface whose triangles all face the same way"),
    (2, [BOX], [SLOPE], "masses[0]: expected a body clear of solids[0]"),
    (2, [Mass(lower=(1.2, 0.2), size=(0.4, 0.3))], [SLOPE, THIN], "masses[0]: expected a body clear of solids[1]"),
    (2, [BOX], [Solid(lower=(2.5, 0.3), size=(0.3, 0.3))], "solids[0]: expected a solid that reaches into the domain"),
    (2, [BOX, polygon((0.3, 0.5), (0.5, 0.5), (0.5, 0.7))], [], "masses[1]: expected a body clear of masses[0]"),
    (2, [Mass(kind="layer", thickness=0.4), BOX], [], "masses[1]: expected a body clear of masses[0]"),
    (3, [ball((1.0, 0.4, 0.5), 0.35)], [VALLEY], "masses[0]: expected a body clear of solids[0]"),
    (3, [BALL, ball((1.1, 0.5, 0.5), 0.2)], [], "masses[1]: expected a body clear of masses[0]"),
]


@pytest.mark.parametrize(("dimension", "masses", "solids", "words"), REFUSED)
def test_what_is_no_body_and_what_overlaps(dimension: int, masses: list[Mass], solids: list[Solid], words: str) -> None:
    refused(lambda: scene_of(*masses, solids=tuple(solids), dimension=dimension), said=words)


@pytest.mark.parametrize("gap", [0.0, 0.12])
def test_bodies_on_and_above_solids(gap: float) -> None:
    flat = Mass(lower=(1.2, 0.1 + gap), size=(0.4, 0.2))
    along = Mass(kind="polygon", vertices=((0.0, 0.5 + gap), (0.5, 0.3 + gap), (0.5, 0.8), (0.0, 0.8)))
    box = Solid(lower=(1.7, 0.0), size=(0.2, 0.4))
    on_box = Mass(lower=(1.7, 0.4 + gap), size=(0.1, 0.1))
    scene = scene_of(flat, along, on_box, solids=(SLOPE, box))
    np.testing.assert_allclose(heights_above_ground(scene), gap, atol=0.0125)
    assert remembers_gaps(scene)
    assert remembers_gaps(scene_of(Mass(lower=(0.5, 0.0), size=(0.4, 0.2), velocity=(1.0e-3, 0.0))))
    assert not remembers_gaps(scene_of(Mass(lower=(0.5, 0.0), size=(0.4, 0.2))))
    deep = scene_of(Mass(lower=(0.4, 0.3 + gap, 0.0), size=(0.2, 0.1, 0.2)), solids=(VALLEY,), dimension=3)
    np.testing.assert_allclose(heights_above_ground(deep), gap, atol=1e-6)
