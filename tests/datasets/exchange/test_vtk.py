"""VTK series, read back by VTK: every field and time; never half of one series and half of another."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import pyvista

from datasets import Baffle, Mass, Material, Solid, Trajectory
from datasets.exchange import vtk
from datasets.exchange.vtk import write_vtk
from datasets.scene.particles import initial_particles
from tests.datasets.conftest import toy
from tests.scenes import flow_of, scene_of

LEFT, RIGHT = Material(friction_deg=30.0), Material(friction_deg=40.0)
START = np.array([[0.02, 0.01, 0.05], [0.06, 0.03, 0.05], [0.03, 0.02, 0.04], [0.07, 0.01, 0.06]])
SPEED, ACCELERATION = np.array([1.0, 0.5, -0.2]), np.array([0.0, -9.0, 4.0])


@pytest.fixture
def flow() -> Trajectory:
    """Four points of two materials in free flight, two baffles that get pushed harder and harder; 3D."""
    time = np.linspace(0.0, 0.04, 5)
    stream = np.random.default_rng(2)
    positions = START + SPEED * time[:, None, None] + 0.5 * ACCELERATION * time[:, None, None] ** 2
    left = Mass(lower=(0.0, 0.0, 0.02), size=(0.04, 0.04, 0.05))
    right = Mass(lower=(0.04, 0.0, 0.02), size=(0.04, 0.04, 0.05), material=RIGHT)
    near = Baffle(lower=(0.2, 0.0, 0.0), size=(0.02, 0.1, 0.03))
    far = Baffle(lower=(0.25, 0.0, 0.05), size=(0.01, 0.05, 0.02))
    box = {"size": (0.3, 0.2, 0.1), "cell": 0.01, "duration": 0.04, "frame_dt": 0.01}
    return flow_of(
        scene_of(left, right, material=LEFT, baffles=(near, far), **box),
        positions,
        time=time,
        velocity0=np.tile(SPEED, (4, 1)).astype(np.float32),
        friction=np.array([LEFT.friction, RIGHT.friction] * 2, np.float32),
        pressure=stream.random((5, 4), np.float32),
        plastic_strain=stream.random((5, 4), np.float32),
        solid_impulse=np.array([3.0, 0.0, 1.0]) * np.array([1.0, 2.0])[:, None] * time[:, None, None] ** 2,
    )


def read(folder: Path) -> dict[float, list[pyvista.PolyData]]:
    reader = pyvista.get_reader(folder / "trajectory.pvd")
    series = {}
    for time in reader.time_values:
        reader.set_active_time_value(time)
        series[time] = list(reader.read())
    return series


def test_points(tmp_path: Path, flow: Trajectory) -> None:
    write_vtk(flow, tmp_path)
    series = read(tmp_path)
    assert list(series) == flow.time.tolist()
    for frame, (points, _, _) in enumerate(series.values()):
        np.testing.assert_array_equal(points.points, flow.positions[frame])
        np.testing.assert_array_equal(points.verts.reshape(-1, 2), [[1, 0], [1, 1], [1, 2], [1, 3]])
        np.testing.assert_array_equal(points["displacement"], flow.positions[frame] - flow.positions[0])
        # A central difference is exact here; the last one is that of half a frame before.
        true = SPEED + ACCELERATION * min(flow.time[frame], 0.035)
        np.testing.assert_allclose(points["velocity"], np.tile(true, (4, 1)), atol=2e-5)
        np.testing.assert_array_equal(points["pressure"], flow.pressure[frame])
        np.testing.assert_array_equal(points["plastic_strain"], flow.plastic_strain[frame])
        np.testing.assert_array_equal(points["material"], [0, 1, 0, 1])
        np.testing.assert_allclose(points["friction_deg"], [30.0, 40.0, 30.0, 40.0], rtol=1e-6)


def test_a_last_frame_alone_knows_where_it_began(tmp_path: Path, flow: Trajectory) -> None:
    """Its first frame is not the start: materials and displacements are by the scene's own particles."""
    start = initial_particles(flow.scene)
    write_vtk(flow_of(flow.scene, [start.positions + 0.03], time=np.array([0.5])), tmp_path)
    ((points, *_),) = read(tmp_path).values()
    np.testing.assert_allclose(points["displacement"], 0.03, atol=1e-6)
    np.testing.assert_array_equal(points["material"], start.material)
    assert "velocity" not in points.point_data


def test_two_dimensions(tmp_path: Path) -> None:
    flow = toy(2)
    write_vtk(flow, tmp_path)
    points, solids, domain = read(tmp_path)[flow.time[-1]]
    np.testing.assert_array_equal(points.points, np.pad(flow.positions[-1], ((0, 0), (0, 1))))
    assert set(points.point_data) == {"velocity", "displacement", "material", "friction_deg"}
    assert points["velocity"].shape == points.points.shape
    assert set(solids.cell_data) == {"solid", "friction"}
    assert solids.n_lines == solids.n_cells
    assert domain.length == pytest.approx(np.hypot(0.5, 0.25))
    assert (tmp_path / "solids.vtp").exists()  # what never changes has one file


def test_solids_are_a_surface_of_their_own(tmp_path: Path, flow: Trajectory) -> None:
    """Above a terrain that falls along x and a wall without slip, which took momentum too."""
    grid = {"origin": (-0.1, -0.1), "spacing": (0.5, 0.3), "heights": ((0.02, 0.02), (0.01, 0.01))}
    ground = Solid(kind="terrain", **grid, friction=0.5)
    wall = Solid(name="wall", lower=(0.1, 0.0, 0.0), size=(0.02, 0.05, 0.02), contact="no-slip")
    raised = (dataclasses.replace(mass, lower=(mass.lower[0], 0.05, mass.lower[2])) for mass in flow.scene.masses)
    scene = dataclasses.replace(flow.scene, masses=tuple(raised), solids=(ground, wall))
    flow = dataclasses.replace(flow, scene=scene, solid_impulse=np.random.default_rng(5).random((5, 4, 3)))
    write_vtk(flow, tmp_path)
    _, solids, _ = read(tmp_path)[0.02]
    assert set(np.unique(solids["solid"])) == {0, 1, 2, 3}  # baffles first, then the terrain and the wall
    np.testing.assert_array_equal(np.unique(solids["friction"][solids["solid"] == 2]), np.float32(0.5))
    assert np.isinf(solids["friction"][solids["solid"] == 3]).all()
    low = solids.extract_cells(np.flatnonzero(solids["solid"] == 3)).bounds[4]
    assert low == pytest.approx(0.0, abs=1e-6)  # the wall ends at the side of the box
    for number in range(4):
        faces = solids["solid"] == number
        np.testing.assert_array_equal(np.unique(solids["impulse"][faces], axis=0)[0], flow.solid_impulse[2, number])


def test_a_deposit_at_rest_leans_on_a_solid(tmp_path: Path, flow: Trajectory) -> None:
    """Frames after the end repeat it: the force is the last one, also across the end, and never 0."""
    impulse = np.minimum(flow.time, 0.025)[:, None, None] * [[3.0, 0.0, 1.0], [6.0, 0.0, 2.0]]
    write_vtk(dataclasses.replace(flow, solid_impulse=impulse, summary={"end_time": 0.025}), tmp_path, every=2)
    for time, (_, solids, _) in read(tmp_path).items():
        near = solids["force"][solids["solid"] == 0]
        np.testing.assert_allclose(near, np.tile([3.0, 0.0, 1.0] if time else [0.0] * 3, (len(near), 1)), rtol=1e-9)
    # Of a last frame alone it is the mean since the start.
    last = dataclasses.replace(flow, positions=flow.positions[-1:], time=flow.time[-1:], pressure=None)
    last = dataclasses.replace(last, plastic_strain=None, solid_impulse=flow.solid_impulse[-1:])
    write_vtk(last, tmp_path)
    ((_, solids, _),) = read(tmp_path).values()
    np.testing.assert_allclose(solids["force"][0], [0.12, 0.0, 0.04])


def test_a_shorter_series_replaces_a_longer_one(tmp_path: Path, flow: Trajectory) -> None:
    write_vtk(flow, tmp_path)
    (tmp_path / "particles-of-interest.txt").write_text("mine")
    write_vtk(toy(2), tmp_path, every=3)
    names = {"domain.vtp", "solids.vtp", "trajectory.pvd", "particles-of-interest.txt"}
    names |= {f"particles-{frame:04d}.vtp" for frame in (0, 3, 5)}
    assert {file.name for file in tmp_path.iterdir()} == names
    assert list(read(tmp_path)) == toy(2).time[[0, 3, 5]].tolist()


def test_a_break_leaves_the_older_series(tmp_path: Path, flow: Trajectory, monkeypatch: pytest.MonkeyPatch) -> None:
    write_vtk(flow, tmp_path)
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    write, written = vtk._write, []

    def broken(mesh: pyvista.PolyData, path: Path) -> None:
        if len(written) == 3:
            raise KeyboardInterrupt
        written.append(path)
        write(mesh, path)

    monkeypatch.setattr(vtk, "_write", broken)
    with pytest.raises(KeyboardInterrupt):
        write_vtk(toy(2), tmp_path)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before
