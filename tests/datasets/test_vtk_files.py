"""VTKHDF and VTU: read back with VTK's own readers and meshio's, every part, array and time."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline
from vtkmodules.vtkIOHDF import vtkHDFReader

from datasets.exchange.vtk import Meshes
from datasets.exchange.vtkhdf import write_vtkhdf
from datasets.scene import Solid
from datasets.trajectory import Trajectory
from tests.datasets.toys import toy


@pytest.fixture(params=[2, 3])
def flow(request: pytest.FixtureRequest) -> Trajectory:
    """A block before two baffles and a wall, with stresses and impulses."""
    flow, stream = toy(request.param), np.random.default_rng(8)
    frames, points, dimension = flow.positions.shape
    wall = Solid(lower=(0.46, 0.0, 0.0)[:dimension], size=(0.02, 0.1, 0.04)[:dimension])
    if dimension == 3:
        wall = dataclasses.replace(wall, lower=(0.36, 0.0, 0.0))
    return dataclasses.replace(
        flow,
        scene=dataclasses.replace(flow.scene, solids=(wall,)),
        stress=stream.random((frames, points, 4 if dimension == 2 else 6), np.float32),
        solid_impulse=stream.random((frames, 3, dimension)),
    )


def frames_in(reader: Any, path: Path) -> dict[float, Any]:
    """What a reader of VTK's gives for each time that it tells of."""
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    about, key = reader.GetOutputInformation(0), vtkStreamingDemandDrivenPipeline.TIME_STEPS()
    frames = {}
    for index in range(about.Length(key)):
        reader.UpdateTimeStep(about.Get(key, index))
        frames[about.Get(key, index)] = pyvista.wrap(reader.GetOutputDataObject(0)).copy()
    return frames


def same(found: Any, expected: pyvista.PolyData) -> None:
    np.testing.assert_array_equal(found.points, expected.points)
    for kind in ("point_data", "cell_data"):
        arrays, others = getattr(found, kind), getattr(expected, kind)
        assert set(arrays) == set(others)
        for name in others:
            np.testing.assert_array_equal(arrays[name], others[name])
            assert arrays[name].dtype == others[name].dtype


@pytest.mark.parametrize("every", [1, 2])
def test_vtkhdf_holds_what_the_series_holds(tmp_path: Path, flow: Trajectory, every: int) -> None:
    path, meshes = tmp_path / "trajectory.vtkhdf", Meshes(flow)
    write_vtkhdf(flow, path, every=every)
    frames = frames_in(vtkHDFReader(), path)
    kept = list(range(0, 6, every)) if every == 1 else [0, 2, 4, 5]
    assert list(frames) == flow.time[kept].tolist()
    since = 0
    for frame, blocks in zip(kept, frames.values(), strict=True):
        assert blocks.keys() == ["particles", "solids", "domain"]
        for name in ("particles", "solids", "domain"):
            expected = meshes.part(name, frame, since)
            same(blocks[name], expected)
            cells = [(mesh.verts, mesh.lines, mesh.faces) for mesh in (blocks[name], expected)]
            for found, known in zip(*cells, strict=True):
                np.testing.assert_array_equal(found, known)
        assert blocks["particles"].point_data.active_vectors_name == "velocity"
        assert blocks["solids"].cell_data.active_vectors_name == "force"
        since = frame
