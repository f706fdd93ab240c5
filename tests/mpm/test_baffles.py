"""Baffles: what stops a flow, and by how much."""

import numpy as np
import pytest

from datasets.material import Material
from datasets.scene import Baffle, Domain, Mass, Scene
from datasets.trajectory import Trajectory
from mpm import simulate_many

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
