"""Baffles: what stops a flow, and by how much."""

import dataclasses

import numpy as np
import pytest

from datasets.material import Material
from datasets.scene import Baffle, Domain, Mass, Scene
from datasets.trajectory import Trajectory
from mpm import simulate, simulate_many

SAND = Material(friction_deg=30.0)
CELL = 0.02


def flow(*baffles: Baffle, **changes: object) -> Scene:
    """A column that runs along a floor."""
    settings = {
        "domain": Domain(size=(1.6, 0.6), cell=CELL),
        "masses": (Mass(lower=(0.0, 0.0), size=(0.3, 0.4)),),
        "floor_friction": 0.4,
        "baffle_friction": 0.4,
        "duration": 0.8,
        "frame_dt": 0.01,
        "step_fraction": 0.9,
    } | changes
    return Scene(material=SAND, baffles=baffles, **settings)  # type: ignore[arg-type]


def inside(trajectory: Trajectory) -> int:
    """Points deeper than rounding in a baffle, over all frames."""
    count = 0
    for baffle in trajectory.scene.baffles:
        low, high = np.array(baffle.lower) + 1e-6, np.array(baffle.lower) + np.array(baffle.size) - 1e-6
        count += int(((trajectory.positions > low) & (trajectory.positions < high)).all(axis=2).sum())
    return count


def test_no_point_comes_inside_and_most_stay_behind() -> None:
    baffle = Baffle(lower=(0.5, 0.0), size=(0.1, 0.12))
    stopped, free = simulate_many([flow(baffle), flow()])
    assert inside(stopped) == 0
    assert (stopped.positions[-1, :, 0] > 0.6).mean() < 0.02
    assert (free.positions[-1, :, 0] > 0.6).mean() > 0.1


@pytest.mark.slow
def test_moving_a_baffle_moves_the_deposit_by_degrees() -> None:
    """Over two cells in steps of a fifth: the deposit follows a smooth curve, no plateau and no jump.

    Means over eight jitters, which scatter a single deposit by 0.025 cells.
    """
    offsets = np.arange(0.0, 2.01, 0.2)
    scenes = [
        flow(Baffle(lower=(0.5 + offset * CELL, 0.0), size=(0.1, 0.12)), seed=seed)
        for offset in offsets
        for seed in range(8)
    ]
    mean = np.array([t.positions[-1, :, 0].mean() for t in simulate_many(scenes)]).reshape(len(offsets), 8).mean(axis=1)
    smooth = np.polyval(np.polyfit(offsets, mean, 2), offsets)
    assert np.abs(mean - smooth).max() < 0.03 * CELL
    # Two cells further away is a deposit whose centre lies visibly further away, tenth by tenth.
    assert mean[-1] - mean[0] > 0.25 * CELL
    assert np.diff(mean).min() > -0.03 * CELL


def test_a_wall_of_baffle_is_a_wall() -> None:
    """A baffle as high as the box, at a wall's place, leaves the deposit that the wall leaves.

    Within 0.4 cells: a wall acts at the nodes, up to a cell early, a baffle at the particles.
    """
    walled = flow(domain=Domain(size=(0.6, 0.6), cell=CELL), wall_friction=0.4)
    blocked = flow(Baffle(lower=(0.6, 0.0), size=(0.2, 0.6)), wall_friction=0.4)
    one, other = simulate_many([walled, blocked])
    np.testing.assert_allclose(one.positions[-1].mean(axis=0), other.positions[-1].mean(axis=0), atol=0.4 * CELL)
    assert inside(other) == 0


def test_three_baffles_in_three_dimensions() -> None:
    scene = Scene(
        domain=Domain(size=(1.0, 0.52, 0.6), cell=0.04),
        material=SAND,
        masses=(Mass(lower=(0.0, 0.0, 0.1), size=(0.24, 0.32, 0.4), velocity=(1.0, 0.0, 0.0)),),
        baffles=(
            Baffle(lower=(0.45, 0.0, 0.05), size=(0.11, 0.3, 0.13)),
            Baffle(lower=(0.45, 0.0, 0.42), size=(0.11, 0.3, 0.13)),
            Baffle(lower=(0.75, 0.0, 0.235), size=(0.11, 0.3, 0.13)),
        ),
        floor_friction=0.4,
        baffle_friction=0.4,
        duration=0.6,
        frame_dt=0.01,
    )
    trajectory = simulate(scene)
    mirrored = simulate(dataclasses.replace(scene, seed=5))
    assert inside(trajectory) == 0
    assert trajectory.solid_impulse is not None
    assert mirrored.solid_impulse is not None
    push = trajectory.solid_impulse[-1]
    assert np.all(push[:, 0] > 0.0)
    # The scene is symmetric about its middle: the two in front take alike, and push each other's mirror image sideways.
    assert push[0, 0] == pytest.approx(push[1, 0], rel=0.15)
    assert push[0, 2] == pytest.approx(-push[1, 2], abs=0.15 * push[0, 0])
    assert np.abs(mirrored.solid_impulse[-1, :, 0] / push[:, 0] - 1).max() < 0.3
