"""Two flows side by side: of flows that are shifted, faster or thinner every figure is known; fields between frames."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from datasets.command_line import run
from datasets.compare import command, compare
from datasets.flow.fields import FlowFields, pairs
from datasets.flow.trajectory import Trajectory
from tests.datasets.conftest import toy
from tests.refusals import refused_by

APART = 0.05


def shifted(flow: Trajectory, by: float) -> Trajectory:
    """The same flow, from its second frame on farther along x [m]."""
    positions = flow.positions.copy()
    positions[1:, :, 0] += np.float32(by)
    return dataclasses.replace(flow, positions=positions)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_shift_is_found_in_every_figure_and_energies_are_those_of_the_particles(dimension: int) -> None:
    flow = toy(dimension)
    comparison = compare(flow, shifted(flow, APART))
    one, other = comparison.figures
    moved = [other[key][-1] - one[key][-1] for key in ("front", "runout", "toe")]
    assert moved == pytest.approx([APART] * 3, abs=1e-6)
    assert comparison.apart["transport"][-1] == pytest.approx(APART, rel=1e-5)
    assert comparison.apart["positions"].tolist() == pytest.approx([0.0] + [APART] * len(flow.time), rel=1e-5)
    assert comparison.apart["thickness"][-1] > 0.0
    assert comparison.apart["thickness"][0] == 0.0
    assert 0.2 < comparison.apart["overlap"][-1] < comparison.apart["overlap"][0] == 1.0
    assert one["height"] == pytest.approx(other["height"], rel=1e-6)
    # The block begins at 1 m/s, its centre 0.04 m above the floor.
    mass, centre = flow.scene.material.density * flow.volumes.sum(), np.average(flow.positions[0, :, 1])
    assert one["kinetic"][0] == pytest.approx(0.5 * mass, rel=1e-5)
    assert one["potential"][0] == pytest.approx(mass * -flow.scene.gravity_vector[1] * centre, rel=1e-5)


@pytest.mark.parametrize("dimension", [2, 3])
def test_heights_are_those_of_the_sand(dimension: int) -> None:
    flow = toy(dimension)
    flat = dataclasses.replace(flow, positions=flow.positions * np.array([1.0, 0.0, 1.0][:dimension], np.float32))
    comparison = compare(flow, flat)
    half = 0.5 * float(np.mean(flow.volumes)) ** (1.0 / dimension)
    assert comparison.heights[0].max() == pytest.approx(0.08, rel=0.1)
    assert comparison.heights[1].max() == pytest.approx(half, rel=0.1)
    assert comparison.figures[0]["height"] == pytest.approx(0.04, rel=0.02)
    assert comparison.figures[1]["height"] == pytest.approx(0.0, abs=1e-12)
    assert comparison.apart["thickness"][-1] == pytest.approx(0.08 - half, rel=0.1)
    assert comparison.apart["transport"][-1] == 0.0


def test_flows_that_have_no_time_in_common_are_compared_where_they_end() -> None:
    flow = toy(2)
    late = dataclasses.replace(flow, positions=flow.positions[-1:], time=flow.time[-1:])
    comparison = compare(late, dataclasses.replace(flow, positions=flow.positions[:2], time=flow.time[:2]))
    assert comparison.ends == (flow.time[-1], flow.time[1])
    assert comparison.apart["transport"][-1] == pytest.approx(flow.time[-1] - flow.time[1], rel=1e-2)
    assert comparison.time.tolist() == [flow.time[-1]]


def test_the_command(tmp_path: Path) -> None:
    flow = toy(2)
    for name, trajectory in {"one": flow, "other": shifted(flow, APART)}.items():
        trajectory.save(tmp_path / name / "trajectory.npz")
    out = tmp_path / "out"
    assert run(command, "compare", [str(tmp_path / "one"), str(tmp_path / "other"), "--out", str(out)]) == 0
    comparison = json.loads((out / "comparison.json").read_text())
    assert comparison["runs"] == ["one", "other"]
    assert comparison["end"]["difference"]["transport"] == pytest.approx(APART, rel=1e-5)
    assert len(comparison["series"]["a"]["front"]) == len(comparison["time"]) == len(flow.time)
    assert (out / "comparison.png").stat().st_size > 10_000


def test_a_mistake_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    toy(2).save(tmp_path / "flat.npz")
    toy(3).save(tmp_path / "deep.npz")
    for other, said in (("deep.npz", "deep.npz: expected a 2D flow"), ("none", "none: expected")):
        assert said in refused_by(capsys, command, tmp_path / "flat.npz", tmp_path / other)


def test_between_two_frames_a_flow_is_linear() -> None:
    flow = toy(2)
    half = FlowFields(flow).at_time(float(flow.time[1] + flow.time[2]) / 2.0)
    np.testing.assert_allclose(half["position"], 0.5 * (flow.positions[1] + flow.positions[2]), rtol=1e-6)
    assert half["material"].dtype == np.int32
    np.testing.assert_array_equal(FlowFields(flow).at_time(1.0e3)["position"], flow.positions[-1])


def test_a_thinned_flow_has_the_particles_of_the_whole_one() -> None:
    flow = toy(2)
    chosen = np.arange(0, flow.positions.shape[1], 3)
    ratio = np.float32(flow.volumes.sum() / flow.volumes[chosen].sum())
    thin = dataclasses.replace(
        flow,
        positions=flow.positions[:, chosen],
        velocity0=flow.velocity0[chosen],
        friction=flow.friction[chosen],
        volume=(ratio * flow.volumes[chosen]).astype(np.float32),
        mass=np.zeros(len(chosen), np.int32),
    )
    matched = pairs(FlowFields(flow), FlowFields(thin))
    np.testing.assert_array_equal(matched[0], chosen)
    np.testing.assert_array_equal(matched[1], np.arange(len(chosen)))
    assert compare(flow, thin).apart["positions"][-1] == 0.0
    elsewhere = dataclasses.replace(thin, positions=thin.positions + np.float32(0.05))
    assert pairs(FlowFields(flow), FlowFields(elsewhere)) is None
    assert np.isnan(compare(flow, elsewhere).apart["positions"][-1])
