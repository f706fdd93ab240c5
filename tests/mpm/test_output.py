"""What a run records: the frames and fields that were asked for, smooth and right; when it rests; what is said."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from datasets.scene import Baffle, Mass, Scene
from datasets.scene.library import read_scene
from datasets.scene.particles import initial_particles
from mpm import WITH_FIELDS, Recording, simulate
from mpm.output.outcome import caveats
from mpm.output.recording import window_frames
from mpm.output.smoothing import smoothed, weights
from tests.refusals import refused
from tests.scenes import SAND, box, scene_of

REST = Recording(frames=3, fields=True, until_rest=True)
WALLED = Baffle(lower=(0.3, 0.0), size=(0.1, 0.1))


@pytest.mark.parametrize(
    ("frames", "kept"),
    [("all", [*range(7)]), ("last", [6]), (1, [*range(7)]), (4, [0, 4, 6]), (6, [0, 6]), (9, [0, 6])],
)
def test_the_frames_that_are_kept(frames: object, kept: list[int]) -> None:
    assert Recording(frames=frames).kept(7) == kept
    for wrong, said in ((0, "frames: expected"), ("first", "frames: expected all, last or every how many")):
        refused(Recording, frames=wrong, said=said)


@pytest.mark.slow
def test_fewer_frames_are_those_of_the_whole_run() -> None:
    scene = box(baffles=(WALLED,), duration=0.3)
    whole = simulate(scene, record=WITH_FIELDS)
    for frames, kept in ((7, [*range(0, 60, 7), 60]), ("last", [60])):
        few = simulate(scene, record=dataclasses.replace(WITH_FIELDS, frames=frames))
        np.testing.assert_array_equal(few.time, whole.time[kept])
        for key in ("positions", "velocities", "stress", "pressure", "plastic_strain", "solid_impulse"):
            np.testing.assert_array_equal(getattr(few, key), getattr(whole, key)[kept])
        for key in ("energy", "wall_impulse", "front", "steps"):
            assert few.summary[key] == whole.summary[key]


def test_the_stress_in_a_settled_bed_is_the_weight_above() -> None:
    scene = box(Mass(lower=(0.0, 0.0), size=(1.0, 0.3)), damping=0.3, duration=1.0)
    flow = simulate(scene, record=dataclasses.replace(WITH_FIELDS, frames="last"))
    weight = SAND.density * 9.81
    y = flow.positions[-1, :, 1].astype(np.float64)
    off = (flow.stress[-1, :, 1] + weight * (0.3 - y)) / (weight * 0.3)
    assert np.sqrt(np.mean(off**2)) < 0.025
    # On the floor the mean over a neighbourhood is that of what lies above it.
    assert abs(off[y < 0.02].mean()) < 0.04
    np.testing.assert_allclose(flow.pressure, -flow.stress[:, :, :3].mean(axis=2), rtol=1e-4, atol=1.0)


def test_smoothing_keeps_constants_and_integrals() -> None:
    scene = box()
    positions, stream = initial_particles(scene).positions[None], np.random.default_rng(3)
    values = stream.normal(size=(1, positions.shape[1], 4))
    volume = stream.uniform(0.5, 1.5, positions.shape[1])
    one = np.ones_like(values)
    np.testing.assert_allclose(smoothed(one, positions, volume, scene), 1.0, rtol=1e-6)
    smooth = smoothed(values, positions, volume, scene)
    np.testing.assert_allclose(volume @ smooth[0], volume @ values[0], rtol=1e-4)
    assert smooth.std() < 0.3 * values.std()
    np.testing.assert_allclose(smoothed(values[:, :, 0], positions, volume, scene), smooth[:, :, 0], rtol=1e-5)
    # A spline reproduces linear functions.
    nodes = weights(positions[0], scene)
    x = (np.arange(50 + 7) - 3) * 0.02
    grid = np.broadcast_to(x[:, None], (57, 57)).ravel()
    np.testing.assert_allclose(nodes @ grid, positions[0, :, 0], atol=1e-12)


@pytest.mark.slow
def test_a_settled_deposit_is_at_rest_and_repeats_its_last_frame() -> None:
    scene = box(floor_friction=0.5, duration=2.0)
    whole, ended = simulate(scene), simulate(scene, record=REST)
    summary = ended.summary
    assert whole.summary["rest_time"] is None
    assert 0.5 < summary["rest_time"] < 1.0
    window = window_frames(scene, [SAND]) * scene.frame_dt
    assert summary["end_time"] == pytest.approx(summary["rest_time"] + window - scene.frame_dt)
    assert summary["steps"] < 0.6 * whole.summary["steps"]
    assert len(ended.time) == 135
    after = ended.time > summary["end_time"]
    for series in (ended.positions, ended.velocities, ended.pressure):
        assert after.sum() > 50
        assert np.all(series[after] == series[-1])
    before = np.round(ended.time[~after] / scene.frame_dt).astype(int)
    np.testing.assert_array_equal(ended.positions[~after], whole.positions[before])
    assert summary["front"] == pytest.approx(whole.summary["front"], abs=0.001)
    # The last frame alone is the one in which it was found at rest, too.
    last = simulate(scene, record=dataclasses.replace(REST, frames="last"))
    np.testing.assert_array_equal(last.positions[-1], ended.positions[-1])
    assert last.summary["rest_time"] == summary["rest_time"]


COLUMN = read_scene("column-short-21")


def said(scene: Scene = COLUMN, *, x: float = 0.0, energy: float = 0.0, present: float = 1.0, left: Any = None) -> str:
    """Remarks on the column moved by `x` [m], whose kinetic energy ends at `energy` [J/m], that of a share of it."""
    particles = initial_particles(scene)
    deposit = particles.positions + np.array([x, 0.0])
    kinetic = np.array([0.0, 10.0, energy])
    over_time = {"kinetic": kinetic, "present": np.array([1.0, 1.0, present]), "end_time": 1.0}
    return "\n".join(caveats(scene, particles, deposit, **over_time, outflow=left or {}))


def test_what_has_left_says_nothing_of_the_speed_of_what_has_not() -> None:
    """A thousandth of the column at 2 m/s, after all of it was faster."""
    points = initial_particles(COLUMN)
    left = 1.0e-3 * float(np.sum(points.density * points.volume))
    assert "it still moves at 2 m/s" in said(energy=0.5 * left * 2.0**2, present=1.0e-3)
    assert said(present=1.0e-6) == ""


def test_what_speeds_up_is_not_at_rest_after_most_has_left() -> None:
    """Its force was divided by the weight of all, its energy compared with that of what had left."""
    fast, slow = Mass(lower=(1.5, 0.0), size=(0.5, 0.4), velocity=(6.0, 0.0)), Mass(lower=(0.1, 0.0), size=(0.1, 0.04))
    opened = {"size": (2.0, 0.6), "cell": 0.02, "open_sides": ("x+",), "floor_friction": 0.0, "slope_deg": 3.0}
    flow = simulate(scene_of(fast, slow, **opened, duration=0.5), record=Recording(frames="last", until_rest=True))
    assert flow.summary["outflow"]["x+"] == pytest.approx(0.98 * flow.volumes.sum() * SAND.density, rel=0.01)
    assert flow.summary["rest_time"] is None
    assert flow.summary["remarks"][0].startswith("not at rest: at t = 0.5 s")


def test_what_is_said_of_motion_walls_open_sides_and_thin_bodies() -> None:
    """Of a wall that holds the front, not of the one that the column stood at; of rest in a large box nothing."""
    assert said(x=0.1) == said(energy=1e-7) == ""
    assert "not at rest: at t = 1 s" in said(energy=1.0)
    room = COLUMN.domain.size[0] - COLUMN.masses[0].lower[0] - COLUMN.masses[0].size[0]
    assert "side x+ of the box stops" in said(x=room)
    opened = dataclasses.replace(COLUMN, open_sides=("x+",))
    assert "x+" not in said(opened, x=room)
    assert "left the box through its open side x+" in said(opened, left={"x+": 1.0})
    # A body of fewer than three cells.
    for cells, thin in ((2.0, True), (5.0, False)):
        mass = dataclasses.replace(COLUMN.masses[0], size=(COLUMN.masses[0].size[0], cells * COLUMN.domain.cell))
        assert ("masses[0]" in said(dataclasses.replace(COLUMN, masses=(mass,)))) is thin
