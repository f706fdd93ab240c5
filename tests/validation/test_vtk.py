"""`python -m validation.vtk`: the pictures show what is where, the movie has every frame, mistakes are one line."""

from pathlib import Path
from types import SimpleNamespace

import av
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
from validation.rendering import Picture
from validation.vtk import command


@pytest.fixture(autouse=True)
def small_images(monkeypatch: pytest.MonkeyPatch) -> None:
    """Letters and bars stay as large, what is drawn is small."""
    monkeypatch.setattr(rendering, "WIDTH", 800)
    monkeypatch.setattr(rendering, "HEIGHT", 600)


@pytest.fixture(scope="module")
def _opengl() -> None:
    try:
        rendering._window(64, 64).close()
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


def pixel(picture: Picture, position: tuple[float, ...]) -> np.ndarray:
    """Column and row, from the lower left, of a point [m] in the image."""
    coordinate = pyvista._vtk.vtkCoordinate()
    coordinate.SetCoordinateSystemToWorld()
    coordinate.SetValue(*position, *(0.0,) * (3 - len(position)))
    return np.array(coordinate.GetComputedDisplayValue(picture.plotter.renderer))


def colour_at(image: np.ndarray, picture: Picture, position: tuple[float, ...]) -> np.ndarray:
    """Mean colour of a few pixels at a point [m], in 0..1."""
    across, up = pixel(picture, position)
    row = image.shape[0] - 1 - up
    return image[row - 2 : row + 3, across - 2 : across + 3, :3].mean(axis=(0, 1)) / 255.0


@opengl
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_picture_shows_what_is_where(dimension: int) -> None:
    flow = slide(dimension)
    depth = (0.3,)[: dimension - 2]
    with Picture(flow, Colour.DISPLACEMENT) as picture:
        image = picture.at(2)
        assert image.shape == (*picture.plotter.window_size[::-1], 3)
        assert image.shape[0] % 2 == image.shape[1] % 2 == 0
        # All that moves is in the image, left of the colour bar.
        for position in flow.positions.reshape(-1, dimension)[::50]:
            across, up = pixel(picture, tuple(position))
            assert 0 < across < 0.9 * image.shape[1]
            assert 0 < up < 0.95 * image.shape[0]
        # The baffle is grey where it faces the eye, and its edges are where they belong.
        steel = colour_at(image, picture, (0.75, 0.26, *depth))
        assert np.ptp(steel) < 0.15
        assert 0.2 < steel.mean() < 0.8
        for beside, within in (((0.68, 0.26), (0.72, 0.26)), ((0.75, 0.36), (0.75, 0.28))):
            colours = [colour_at(image, picture, (*position, *depth)).mean() for position in (beside, within)]
            assert max(colours) > min(colours) + 0.2
        assert (image[0] == 255).all()
        assert 0.25 < picture.values(2).max() < 0.4


@opengl
def test_the_command(tmp_path: Path) -> None:
    slide(2).save(tmp_path / "run" / "trajectory.npz")
    out = tmp_path / "out"
    flags = ["--out", str(out), "--picture", "--movie", "--time", "0.12"]
    assert run(command, "vtk", [str(tmp_path / "run"), *flags]) == 0
    assert pyvista.get_reader(out / "trajectory.pvd").time_values == [0.0, 0.1, 0.2]
    picture = imread(out / "picture.png")
    assert len(np.unique(picture.reshape(-1, picture.shape[2]), axis=0)) > 100
    with av.open(str(out / "movie.mp4")) as file:
        assert len([*file.decode(video=0)]) == 3
    names = {file.name for file in out.iterdir() if "-" not in file.name}
    assert names == {"domain.vtp", "movie.mp4", "picture.png", "solids.vtp", "trajectory.pvd"}


def test_no_opengl_is_one_line_after_the_series(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
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
        (["absent.npz"], "absent.npz: expected a whole NPZ of plain arrays (a trajectory), there is none"),
        (["flow.npz", "--time", "0.3"], "--time: expected a time from 0 to 0.2 s"),
        (["flow.npz", "--frames", "0"], "--frames: expected an integer of at least 1"),
        (["flow.npz", "--colour", "pressure"], "flow.npz: pressure: expected a trajectory that recorded it"),
        (["flow.npz", "--colour", "red"], "velocity"),
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
