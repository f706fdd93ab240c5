"""Forces: exact means of the momentum that solids took, whatever the frames and the window; as CSV and as a plot."""

import csv
import dataclasses
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from datasets import Baffle, Trajectory
from datasets.command_line import run
from datasets.forces import command, forces_of, momentum
from tests.refusals import refused, refused_by

TIME = np.array([0.0, 0.01, 0.02, 0.05, 0.06, 0.10])
BAFFLES = (Baffle(lower=(0.12, 0.0), size=(0.02, 0.03)), Baffle(lower=(0.16, 0.0), size=(0.02, 0.03)))


@pytest.fixture
def flow(trajectory: Trajectory) -> Trajectory:
    """Frames at uneven times, two baffles that take random momentum, walls that take 3 N/m along x, -5 along y."""
    stream = np.random.default_rng(7)
    impulse = np.cumsum(stream.normal(0.0, 1.0, (len(TIME), 2, 2)), axis=0)
    impulse[0] = 0.0
    every = np.arange(11) * 0.01
    scene = dataclasses.replace(trajectory.scene, baffles=BAFFLES, duration=0.1, frame_dt=0.01)
    moving = {"positions": stream.random((len(TIME), 5, 2), np.float32), "time": TIME, "solid_impulse": impulse}
    walls = {"y-": (every[:, None] * [3.0, -5.0]).tolist()}
    return dataclasses.replace(trajectory, scene=scene, **moving, summary={"side_impulse": walls})


@pytest.mark.parametrize("window", [0.0, 0.003, 0.2])
def test_force_times_time_is_the_impulse(flow: Trajectory, window: float) -> None:
    forces = forces_of(flow, window=window)
    assert forces.names == ("baffles[0]", "baffles[1]", "y-")
    np.testing.assert_array_equal(forces.edges, TIME)
    np.testing.assert_allclose(forces.impulse[:2], flow.solid_impulse[-1], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(forces.impulse[2], [0.3, -0.5], rtol=1e-12)
    # A constant force is none other in a window, ends included.
    np.testing.assert_allclose(forces.force[:, 2], np.tile([3.0, -5.0], (5, 1)), rtol=1e-9)


def test_a_window_is_a_moving_mean(flow: Trajectory) -> None:
    """2000 N/m for 0.03 s, over a window twice as long: from a quarter to three quarters in that time."""
    impulse = np.zeros_like(flow.solid_impulse)
    impulse[3:, 0, 0] = 60.0
    smooth = forces_of(dataclasses.replace(flow, solid_impulse=impulse), window=0.06)
    assert smooth.force[2, 0, 0] == pytest.approx((0.75 - 0.25) * 60.0 / 0.03)


def test_frames_after_rest_are_none(flow: Trajectory) -> None:
    """They repeat the moment of rest: a force of zero in them would be wrong."""
    impulse = flow.solid_impulse.copy()
    impulse[3:] = impulse[3]
    walls = np.minimum(np.arange(11) * 0.01, 0.04)[:, None] * [3.0, -5.0]
    summary = {"end_time": 0.04, "side_impulse": {"y-": walls.tolist()}}
    forces = forces_of(dataclasses.replace(flow, solid_impulse=impulse, summary=summary))
    np.testing.assert_allclose(forces.time, [0.01, 0.02, 0.04])
    np.testing.assert_allclose(forces.impulse[:2], impulse[-1], atol=1e-12)
    np.testing.assert_allclose(forces.force[:, 2], np.tile([3.0, -5.0], (3, 1)))


def test_after_rest_the_last_force_goes_on(flow: Trajectory) -> None:
    """The momentum that it gives, whose change is that force; recorded is that of the end."""
    impulse = flow.solid_impulse.copy()
    impulse[3:] = impulse[3]
    rested = dataclasses.replace(flow, solid_impulse=impulse, summary={"end_time": 0.04})
    force = (impulse[3] - impulse[2]) / 0.02
    taken = momentum(rested)
    np.testing.assert_array_equal(taken[:3], impulse[:3])
    np.testing.assert_allclose(taken[3:], impulse[3] + np.array([0.01, 0.02, 0.06])[:, None, None] * force, rtol=1e-12)
    np.testing.assert_allclose(force, forces_of(rested).force[-1], rtol=1e-12)
    # Of the last frame alone it is the mean since the start; of a flow that does not rest it is what was recorded.
    last = {"positions": flow.positions[-1:], "time": TIME[-1:], "solid_impulse": impulse[-1:]}
    np.testing.assert_allclose(momentum(dataclasses.replace(rested, **last)), 2.5 * impulse[-1:], rtol=1e-12)
    np.testing.assert_array_equal(momentum(flow), flow.solid_impulse)


def test_what_cannot_be(flow: Trajectory) -> None:
    refused(forces_of, dataclasses.replace(flow, solid_impulse=None, summary={}), said="recorded the momentum")
    refused(forces_of, flow, window=0.3, said="window of 0 to 0.2 s, got 0.3 s")


def test_the_command(tmp_path: Path, flow: Trajectory, capsys: pytest.CaptureFixture[str]) -> None:
    """Two peaks of known size, printed, drawn and in a table that holds the impulse."""
    impulse = np.zeros_like(flow.solid_impulse)
    impulse[3:, 0, 0], impulse[5:, 1, 1] = 60.0, -40.0
    dataclasses.replace(flow, solid_impulse=impulse).save(tmp_path / "run" / "trajectory.npz")
    out = tmp_path / "out"
    assert run(command, "forces", [str(tmp_path / "run"), "--out", str(out)]) == 0
    first, second, floor = capsys.readouterr().out.splitlines()
    assert first == "baffles[0]: peak 2000 N/m at 0.035 s, impulse (60, 0) N s/m"
    assert second == "baffles[1]: peak 1000 N/m at 0.08 s, impulse (0, -40) N s/m"
    assert "impulse (0.3, -0.5) N s/m" in floor
    assert imread(out / "forces.png").shape[0] > 400
    with (out / "forces.csv").open(newline="") as file:
        head, *lines = list(csv.reader(file))
    values = np.array(lines, float)
    assert head[:2] + head[-1:] == ["time_s", "baffles[0]_fx_N_per_m", "y-_fy_N_per_m"]
    np.testing.assert_allclose(values[:, 0], TIME[1:])
    given = (np.diff(values[:, 0], prepend=0.0)[:, None] * values[:, 1:5]).sum(axis=0)
    np.testing.assert_allclose(given, impulse[-1].ravel(), atol=1e-6)
    dataclasses.replace(flow, solid_impulse=None, summary={}).save(tmp_path / "none.npz")
    assert str(tmp_path / "none.npz") in refused_by(capsys, command, tmp_path / "none.npz", "--out", out)
