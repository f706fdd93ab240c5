"""Maps in plan against exact shapes: volume, an even layer, a cone, an incline; what moves, what has left."""

import dataclasses

import numpy as np
import pytest

from datasets.maps.plan import Floats, PlanMaps, maps_of
from datasets.material import Material
from datasets.measures import height_profile
from datasets.particles import initial_particles
from datasets.scene import Baffle, Domain, Mass, Scene, Solid
from datasets.trajectory import Trajectory


def scene_of(size: tuple[float, ...], *boxes: tuple[tuple[float, ...], tuple[float, ...]], cell: float = 0.05) -> Scene:
    """Boxes of sand (lower corner, size) in a box."""
    return Scene(
        domain=Domain(size=size, cell=cell),
        material=Material(friction_deg=30.0),
        masses=tuple(Mass(lower=lower, size=extent) for lower, extent in boxes),
        jitter=0.0,
    )


def still(scene: Scene, *frames: Floats, frame_dt: float = 0.1) -> Trajectory:
    """A trajectory of given positions, shape [N, D] each."""
    count, dimension = frames[0].shape
    return Trajectory(
        positions=np.array(frames, np.float32),
        time=np.arange(len(frames)) * frame_dt,
        velocity0=np.zeros((count, dimension), np.float32),
        friction=np.full(count, 0.5, np.float32),
        scene=scene,
    )


def volume_in(maps: PlanMaps) -> float:
    return float((maps.thickness * maps.areas).sum())


@pytest.mark.parametrize("cell", [0.026, 0.17])
@pytest.mark.parametrize("dimension", [2, 3])
def test_volume_is_that_of_the_particles(dimension: int, cell: float) -> None:
    """Wherever they are, in corners and on walls too, in masses of different particles."""
    size = (1.0, 0.5, 0.6)[:dimension]
    boxes = (
        ((0.0, 0.0, 0.0)[:dimension], (0.21, 0.13, 0.3)[:dimension]),
        ((0.5, 0.0, 0.1)[:dimension], (0.3, 0.1, 0.2)[:dimension]),
    )
    scene = scene_of(size, *boxes)
    start = initial_particles(scene)
    coordinates = np.random.default_rng(1).random(start.positions.shape) * size
    coordinates[:8] = np.array(np.meshgrid(*[(0.0, length) for length in size])).reshape(dimension, -1).T[[0, -1] * 4]
    maps = maps_of(still(scene, start.positions, coordinates), cell)
    assert volume_in(maps) == pytest.approx(start.volume.sum(), rel=1e-12)
    assert maps.volume == pytest.approx(start.volume.sum(), rel=1e-12)
    assert maps.left == 0.0
    assert maps.thickness.min() >= 0.0
    assert maps.start is not None
    np.testing.assert_allclose(maps.depth, np.maximum(maps.start, maps.thickness), rtol=1e-12)
    if dimension == 2:
        # The one definition of a profile.
        profile = height_profile(np.float32(coordinates), start.volume, maps.grid.axes[0])
        np.testing.assert_allclose(maps.thickness, profile, rtol=1e-12)


@pytest.mark.parametrize("cell", [0.025, 0.1])
def test_an_even_layer_is_even_to_the_walls(cell: float) -> None:
    scene = scene_of((0.5, 0.2, 0.3), ((0.0, 0.0, 0.0), (0.5, 0.05, 0.3)))
    maps = maps_of(still(scene, initial_particles(scene).positions), cell)
    # A last cell that goes beyond the box is covered in part.
    whole = maps.thickness[:-1, :-1]
    np.testing.assert_allclose(whole, 0.05, rtol=1e-5)


def test_a_cone() -> None:
    """Of height 0.2 and radius 0.4, filled evenly: its thickness, its outline and its volume."""
    height, radius, spacing = 0.2, 0.4, 0.01
    axis = (np.arange(100) + 0.5) * spacing
    x, y, z = (each.ravel() for each in np.meshgrid(axis, axis[:20], axis, indexing="ij"))
    surface = height * (1.0 - np.hypot(x - 0.5, z - 0.5) / radius)
    cone = np.stack([x, y, z], axis=1)[y < surface]
    exact = np.pi * radius**2 * height / 3.0
    # A mass of the same volume; its own particles are others.
    scene = scene_of((1.0, 0.5, 1.0), ((0.0, 0.0, 0.0), (1.0, exact, 1.0)), cell=0.02)
    assert len(cone) * spacing**3 == pytest.approx(exact, rel=5e-3)
    maps = maps_of(still(scene, cone), 0.05, threshold=0.01)
    middle = np.meshgrid(*maps.grid.axes, indexing="ij")
    true = np.maximum(0.0, height * (1.0 - np.hypot(middle[0] - 0.5, middle[1] - 0.5) / radius))
    assert volume_in(maps) == pytest.approx(exact, rel=1e-9)
    # Cells round the tip and the foot off; the flank is straight.
    assert np.abs(maps.thickness - true).max() < 1.2 * spacing
    flank = (true > 0.03) & (true < 0.16)
    assert np.abs(maps.thickness - true)[flank].max() < 0.35 * spacing
    assert (maps.areas[maps.thickness > 0.01]).sum() == pytest.approx(np.pi * (0.95 * radius) ** 2, rel=0.04)


def test_velocity_is_the_mean_over_the_depth_and_the_largest_over_time() -> None:
    scene = scene_of((1.0, 0.5, 0.4), ((0.2, 0.0, 0.1), (0.2, 0.1, 0.2)))
    start = initial_particles(scene).positions
    lower = start[:, 1] < 0.05
    # The upper half slides at 2 m/s, the lower one at 1 m/s; then all stops.
    speeds = np.where(lower, 1.0, 2.0)[:, None] * [1.0, 0.0, 0.0]
    velocities = np.array([speeds, speeds, np.zeros_like(speeds)], np.float32)
    flow = dataclasses.replace(still(scene, start, start, start), velocities=velocities)
    maps = maps_of(flow, 0.05)
    assert maps.velocity is not None
    inside = maps.thickness > 0.099
    assert inside.sum() == 4
    np.testing.assert_allclose(maps.velocity[inside], 1.5, rtol=1e-6)
    np.testing.assert_array_equal(maps.velocity[maps.depth <= maps.threshold], 0.0)
    assert maps.threshold == pytest.approx(0.025)


def test_the_ground_of_terrain_and_baffles() -> None:
    heights = ((0.3, 0.3), (0.1, 0.1))
    scene = dataclasses.replace(
        scene_of((1.0, 0.8, 0.5), ((0.2, 0.5, 0.1), (0.2, 0.1, 0.2))),
        solids=(Solid(kind="terrain", origin=(0.0, 0.0), spacing=(1.0, 0.5), heights=heights),),
        baffles=(Baffle(lower=(0.6, 0.0, 0.0), size=(0.1, 0.4, 0.2)),),
    )
    maps = maps_of(still(scene, initial_particles(scene).positions), 0.05)
    x, z = np.meshgrid(*maps.grid.axes, indexing="ij")
    expected = np.where((x > 0.6) & (x < 0.7) & (z < 0.2), 0.4, 0.3 - 0.2 * x)
    np.testing.assert_allclose(maps.ground, expected, atol=1e-6)


def test_the_ground_line_in_two_dimensions() -> None:
    scene = dataclasses.replace(
        scene_of((1.0, 0.8), ((0.1, 0.5), (0.2, 0.1))),
        solids=(Solid(kind="terrain", points=((0.0, 0.3), (0.5, 0.0), (1.0, 0.0))),),
        baffles=(Baffle(lower=(0.7, 0.0), size=(0.1, 0.2)),),
    )
    maps = maps_of(still(scene, initial_particles(scene).positions), 0.03125)
    (x,) = maps.grid.axes
    assert (x[0], x[-1]) == (0.0, 1.0)
    expected = np.where((x >= 0.7) & (x <= 0.8), 0.2, np.maximum(0.0, 0.3 - 0.6 * x))
    np.testing.assert_allclose(maps.ground, expected, atol=1e-9)
    bare = dataclasses.replace(scene, solids=(), baffles=())
    assert not maps_of(still(bare, initial_particles(bare).positions), 0.03125).ground.any()
