"""`python -m validation.vtk`: a picture shows what is where, mistakes are one line."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import pyvista
from matplotlib.image import imread

from datasets import Baffle, Mass, Trajectory
from datasets.command_line import run
from datasets.errors import WorkFailed
from datasets.flow.fields import Colour
from tests.refusals import refused_by
from tests.scenes import flow_of, scene_of
from validation import rendering
from validation.rendering import drawn
from validation.vtk import command


@pytest.fixture(autouse=True)
def small_images(monkeypatch: pytest.MonkeyPatch) -> None:
    """Letters and bars stay as large, what is drawn is small."""
    monkeypatch.setattr(rendering, "WIDTH", 800)
    monkeypatch.setattr(rendering, "HEIGHT", 600)


@pytest.fixture(scope="module")
def _opengl() -> None:
    try:
        rendering.window(64, 64).close()
    except WorkFailed as error:
        pytest.skip(str(error))


opengl = pytest.mark.usefixtures("_opengl")


def slide(dimension: int) -> Trajectory:
    """Three frames of a block that slides towards a baffle and flattens."""
    z, deep = ((0.1,), (0.2,)) if dimension == 3 else ((), ())
    scene = scene_of(
        Mass(lower=(0.1, 0.0, *z), size=(0.2, 0.2, *deep)),
        size=(1.0, 0.5, 0.4)[:dimension],
        baffles=(Baffle(lower=(0.7, 0.0, *z), size=(0.1, 0.3, *deep)),),
        duration=0.2,
        frame_dt=0.1,
    )
    counts = ((24,) * 2, (12,) * 3)[dimension - 2]
    grid = np.stack(np.meshgrid(*(np.linspace(0.0, 1.0, count) for count in counts)), axis=-1).reshape(-1, dimension)
    start = np.array(scene.masses[0].lower) + grid * scene.masses[0].size
    ahead, up = np.eye(dimension)[:2]
    return flow_of(scene, [start + frame * (0.15 * ahead - 0.2 * start * up) for frame in range(3)])


@opengl
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_picture_shows_what_is_where(dimension: int) -> None:
    flow, depth = slide(dimension), (0.3,)[: dimension - 2]
    plotter = drawn(flow, Colour.DISPLACEMENT, 2)
    image = np.asarray(plotter.screenshot(return_img=True))
    height, width = image.shape[:2]

    def pixel(position: tuple[float, ...]) -> np.ndarray:
        """Column and row, from the lower left, of a point [m] in the image."""
        coordinate = pyvista._vtk.vtkCoordinate()
        coordinate.SetCoordinateSystemToWorld()
        coordinate.SetValue(*position, *(0.0,) * (3 - len(position)))
        return np.array(coordinate.GetComputedDisplayValue(plotter.renderer))

    def colour_at(position: tuple[float, ...]) -> np.ndarray:
        """Mean colour of a few pixels at a point [m], in 0..1."""
        across, up = pixel(position)
        return image[height - 3 - up : height + 2 - up, across - 2 : across + 3, :3].mean(axis=(0, 1)) / 255.0

    # All that moves is in the image, left of the colour bar.
    for position in flow.positions.reshape(-1, dimension)[::50]:
        across, up = pixel(tuple(position))
        assert 0 < across < 0.9 * width
        assert 0 < up < 0.95 * height
    # The particles have a colour; the baffle is grey where it faces the eye, and its edges are where they belong.
    assert np.ptp(colour_at((0.5, 0.06, *depth))) > 0.15
    steel = colour_at((0.75, 0.26, *depth))
    assert np.ptp(steel) < 0.15
    assert 0.2 < steel.mean() < 0.8
    for beside, within in (((0.68, 0.26), (0.72, 0.26)), ((0.75, 0.36), (0.75, 0.28))):
        colours = [colour_at((*position, *depth)).mean() for position in (beside, within)]
        assert max(colours) > min(colours) + 0.2
    plotter.close()


@opengl
def test_the_command(tmp_path: Path) -> None:
    slide(2).save(tmp_path / "run" / "trajectory.npz")
    out = tmp_path / "out"
    flags = ["--out", str(out), "--picture", "--time", "0.12"]
    assert run(command, "vtk", [str(tmp_path / "run"), *flags]) == 0
    assert pyvista.get_reader(out / "trajectory.pvd").time_values == [0.0, 0.1, 0.2]
    picture = imread(out / "picture.png")
    assert len(np.unique(picture.reshape(-1, picture.shape[2]), axis=0)) > 100


def test_no_opengl_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    blind = SimpleNamespace(Initialize=lambda: None, IsCurrent=lambda: False)
    plotter = SimpleNamespace(render_window=blind, close=lambda: None)
    monkeypatch.setattr(rendering.pyvista, "Plotter", lambda **_: plotter)
    slide(2).save(tmp_path / "trajectory.npz")
    assert run(command, "vtk", [str(tmp_path), "--out", str(tmp_path / "out"), "--picture"]) == 1
    assert "OpenGL" in capsys.readouterr().err.splitlines()[-1]
    assert (tmp_path / "out" / "trajectory.pvd").exists()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["absent.npz"], "absent.npz: expected a whole NPZ of plain arrays (a trajectory), there is no such file"),
        (["flow.npz", "--time", "0.3"], "--time: expected a time from 0 to 0.2 s"),
        (["flow.npz", "--frames", "0"], "--frames: expected an integer of at least 1"),
        (["flow.npz", "--colour", "pressure"], "flow.npz: pressure: expected a trajectory that recorded it"),
        (["flow.npz", "--out", "flow.npz"], "--out: expected a folder"),
    ],
)
def test_wrong_input_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str], expected: str
) -> None:
    monkeypatch.chdir(tmp_path)
    slide(2).save(Path("flow.npz"))
    words = words if "--out" in words else [*words, "--out", "out"]
    assert expected in refused_by(capsys, command, *words)
    assert not Path("out").exists()
