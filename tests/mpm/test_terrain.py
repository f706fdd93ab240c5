"""Flows over heightfields: no leaks over kinks and through funnels, rest in a valley, mirror images."""

import numpy as np
import pytest

from datasets.geometry.nearest import nearest
from datasets.geometry.surface import surface_of
from datasets.material import Material
from datasets.particles import initial_particles
from datasets.scene import Domain, Mass, Scene, Solid
from datasets.trajectory import Trajectory
from mpm import Recording, simulate
from mpm.output.smoothing import density

SAND = Material(friction_deg=32.0, density=1600.0, young=1.0e6, poisson=0.3)
CELL = 0.04


def heightfield(elevation: np.ndarray, spacing: float, friction: float) -> Solid:
    """A terrain from elevations [m], shape [X, Z], `spacing` [m] apart, from x = z = 0 on."""
    return Solid(
        kind="terrain",
        origin=(0.0, 0.0),
        spacing=(spacing, spacing),
        heights=tuple(tuple(float(y) for y in row) for row in elevation),
        friction=friction,
    )


def raster(size: tuple[float, float], spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """x and z of a raster over a box of `size` [m], shape [X, Z] each."""
    x, z = (np.arange(round(length / spacing) + 1) * spacing for length in size)
    return np.meshgrid(x, z, indexing="ij")


def flow_over(ground: Solid, body: Mass, size: tuple[float, float, float], duration: float) -> Trajectory:
    """What becomes of a body on a ground."""
    scene = Scene(
        domain=Domain(size=size, cell=CELL),
        material=SAND,
        masses=(body,),
        solids=(ground,),
        volume_correction=False,
        duration=duration,
        frame_dt=0.02,
        step_fraction=0.9,
    )
    return simulate(scene, record=Recording(frames=5))


def assert_outside(flow: Trajectory) -> None:
    """No particle is in the ground."""
    surface = surface_of(flow.scene)
    assert surface is not None
    for positions in flow.positions:
        assert nearest(surface, positions.astype(float)).distance.min() > -1.0e-5 * CELL


def test_a_kink_and_a_funnel_do_not_leak() -> None:
    """A trough along a kinked line, and an hourglass: a pit that narrows to a cell and a half."""
    x, z = raster((1.2, 0.48), 0.06)
    kinked = 0.1 + np.where(x < 0.5, 0.6 * (0.5 - x), 0.0) + 0.4 * np.abs(z - 0.24) + np.where(x > 0.7, 0.08, 0.0)
    body = Mass(lower=(0.04, 0.52, 0.12), size=(0.24, 0.16, 0.24))
    flow = flow_over(heightfield(kinked, 0.06, 0.3), body, (1.2, 0.8, 0.48), 0.8)
    assert_outside(flow)
    assert flow.positions[-1, :, 0].mean() > flow.positions[0, :, 0].mean() + 0.2
    x, z = raster((0.48, 0.48), 0.03)
    pit = 0.06 + 1.2 * np.maximum(np.hypot(x - 0.24, z - 0.24) - 0.03, 0.0)
    body = Mass(lower=(0.12, 0.4, 0.12), size=(0.24, 0.2, 0.24))
    flow = flow_over(heightfield(pit, 0.03, 0.1), body, (0.48, 0.8, 0.48), 0.6)
    assert_outside(flow)


def test_a_layer_on_a_slope_has_its_own_density() -> None:
    """Beside a ground that cuts the cells, as in the middle."""
    scene = Scene(
        domain=Domain(size=(1.2, 1.2), cell=CELL),
        material=SAND,
        masses=(Mass(kind="layer", thickness=0.3, outline=((0.2,), (1.0,))),),
        solids=(Solid(kind="terrain", points=((0.0, 0.7), (1.2, 0.1)), friction=0.5),),
    )
    particles = initial_particles(scene)
    mass = particles.density * particles.volume
    found = density(particles.positions[None].astype(np.float32), mass, scene)[0]
    assert np.median(found) == pytest.approx(SAND.density, rel=0.03)
    surface = surface_of(scene)
    assert surface is not None
    beside = nearest(surface, particles.positions).distance < 0.5 * CELL
    assert found[beside].mean() == pytest.approx(SAND.density, rel=0.1)
    assert found.max() < 2.0 * SAND.density


@pytest.mark.slow
def test_sand_rests_in_a_valley_and_its_halves_are_mirror_images() -> None:
    """A V-shaped valley, the body on one side of it and then on the other."""
    x, z = raster((1.6, 0.8), 0.08)
    valley = 0.1 + 0.25 * (1.6 - x) * (x < 1.2) + 0.1 * (x >= 1.2) + 0.5 * np.abs(z - 0.4)
    ground = heightfield(valley, 0.08, 0.5)
    ends = []
    for side in (0.0, 1.0):
        body = Mass(lower=(0.1, 0.76, 0.16 + 0.16 * side), size=(0.4, 0.16, 0.32))
        flow = flow_over(ground, body, (1.6, 1.2, 0.8), 2.0)
        assert_outside(flow)
        kinetic = np.array(flow.summary["energy"]["kinetic"])
        assert kinetic[-1] < 1.0e-3 * kinetic.max()
        ends.append(flow.positions[-1].astype(float))
    left, right = ends[0], ends[1] * [1.0, 1.0, -1.0] + [0.0, 0.0, 0.8]
    np.testing.assert_allclose(left.mean(axis=0), right.mean(axis=0), atol=0.25 * CELL)
    for share in (0.05, 0.5, 0.95):
        np.testing.assert_allclose(np.quantile(left, share, axis=0), np.quantile(right, share, axis=0), atol=CELL)
    # Across the valley the surface stands no steeper than the angle of friction.
    for deposit in ends:
        inner = deposit[np.abs(deposit[:, 0] - np.median(deposit[:, 0])) < 3.0 * CELL]
        tops = [
            inner[np.abs(inner[:, 2] - at) < 0.5 * CELL, 1].max()
            for at in np.arange(0.2, 0.61, 2.0 * CELL)
            if (np.abs(inner[:, 2] - at) < 0.5 * CELL).sum() > 3
        ]
        slopes = np.abs(np.diff(tops)) / (2.0 * CELL)
        assert slopes.max() < np.tan(np.radians(32.0 + 6.0))
