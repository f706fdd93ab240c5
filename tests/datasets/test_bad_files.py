"""Files and scenes damaged at random: each is read, or is one line that names the file and what was expected."""

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
import tomli_w

from datasets import InputError, read_scene, read_trajectory
from datasets.exchange import geoelements
from datasets.files import read_columns, read_toml
from datasets.library import SCENES, scene_from
from datasets.particles import initial_particles
from datasets.trajectory import Trajectory
from tests.datasets.conftest import toy
from tests.datasets.geometry.solids import sphere

SEEDS = range(4)
PER_SEED = 25
LONGEST = 3000
"""Characters of a line."""
STRANGE: tuple[Any, ...] = (
    *(-1, 0, 1, 2, 10**9, 10**30, -1.0, 0.0, 1e-300, 1e9, 1e300, float("inf"), float("nan")),
    *("", "x", "box", "mesh", "layer", True, [], [[]], [0.1], [1.0, 2.0, 3.0], [[0.1, 0.2], [0.3, 0.4]], {}, {"x": 1}),
)


def one_line(error: InputError, path: Path) -> None:
    line = str(error)
    assert "\n" not in line
    assert str(path) in line
    assert "expected" in line
    assert len(line) < LONGEST


def damaged(stream: random.Random, content: bytes) -> bytes:
    """`content` with some of its bytes changed, cut, doubled, or gone from somewhere on."""
    changed = bytearray(content)
    for _ in range(stream.randint(1, 4)):
        index = stream.randrange(max(1, len(changed)))
        match stream.randrange(5):
            case 0 if changed:
                changed[index] = stream.randrange(256)
            case 1 if changed:
                changed[index] ^= 1 << stream.randrange(8)
            case 2:
                del changed[index : index + stream.randint(1, 20)]
            case 3:
                changed[index:index] = changed[index : index + stream.randint(1, 20)]
            case _:
                del changed[max(index, 4) :]
    return bytes(changed)


def mesh_scene(path: Path) -> None:
    """A body of the mesh in a file."""
    data = {
        "domain": {"size": [1.0, 1.0, 1.0], "cell": 0.1},
        "material": {"friction_deg": 30.0},
        "masses": [{"kind": "mesh", "file": path.name}],
    }
    scene_from(data, path.parent)


KINDS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "scene": ("scene.toml", read_scene),
    "trajectory": ("flow.npz", read_trajectory),
    "long trajectory": ("flow.h5", read_trajectory),
    "object arrays": ("train.npz", lambda path: list(geoelements.read(path))),
    "table": ("dem.csv", lambda path: read_columns(path, ("x", "z", "y"))),
    "mesh": ("ball.stl", mesh_scene),
}


@pytest.fixture
def whole(request: pytest.FixtureRequest, tmp_path: Path, trajectory: Trajectory) -> Path:
    """A good file of the kind that is asked for."""
    path = tmp_path / KINDS[request.param][0]
    match request.param:
        case "scene":
            path.write_bytes((SCENES / "layers-10.toml").read_bytes())
        case "trajectory" | "long trajectory":
            trajectory.save(path)
        case "object arrays":
            geoelements.write(path, [("flow", toy(2))])
        case "table":
            path.write_text("# surveyed\nx,z,y\n" + "".join(f"{x},{z},{x + z}\n" for x in range(4) for z in range(3)))
        case _:
            vertices, triangles = sphere((0.5, 0.5, 0.5), 0.3, 8)
            meshio.Mesh(vertices, [("triangle", triangles)]).write(path)
    return path


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("kind", "whole"), [(kind, kind) for kind in KINDS], indirect=["whole"])
def test_damaged_files(kind: str, whole: Path) -> None:
    read, content, refused = KINDS[kind][1], whole.read_bytes(), 0
    read(whole)
    for seed in SEEDS:
        stream = random.Random(f"{kind} {seed}")
        for _ in range(PER_SEED):
            whole.write_bytes(damaged(stream, content))
            try:
                read(whole)
            except InputError as error:
                # Of a scene that is right as a file the keys are wrong, which has no file where it was not read.
                one_line(error, whole if error.where else Path())
                refused += 1
    assert refused > 10


def changed(stream: random.Random, data: Any) -> Any:
    """The tables of a scene with one value, somewhere, that is gone, doubled, renamed or of another kind."""
    if isinstance(data, dict) and data and stream.random() < 0.8:
        key = stream.choice(sorted(data))
        match stream.randrange(6):
            case 0:
                return {name: value for name, value in data.items() if name != key}
            case 1:
                return {(f"{name}x" if name == key else name): value for name, value in data.items()}
            case _:
                return data | {key: changed(stream, data[key])}
    if isinstance(data, list) and data and stream.random() < 0.8:
        index = stream.randrange(len(data))
        return [*data[:index], changed(stream, data[index]), *data[index + stream.randrange(2) :]]
    return stream.choice(STRANGE)


@pytest.mark.parametrize("name", ["baffles-2", "layers-10", "slope-layers", "valley-3d"])
@pytest.mark.parametrize("seed", SEEDS)
def test_strange_scenes(name: str, seed: int, tmp_path: Path) -> None:
    stream, path = random.Random(f"{name} {seed}"), tmp_path / "scene.toml"
    (tmp_path / "valley-3d.asc").write_bytes((SCENES / "valley-3d.asc").read_bytes())
    good = read_toml(SCENES / f"{name}.toml")
    outcomes = []
    for _ in range(PER_SEED):
        key = stream.choice(sorted(good))
        path.write_text(tomli_w.dumps(good | {key: changed(stream, good[key])}))
        try:
            scene = read_scene(path)
            outcomes.append(1)
            if scene.particle_volume * 1e6 > np.prod(scene.domain.size):
                assert np.isfinite(initial_particles(scene).positions).all()
        except InputError as error:
            one_line(error, tmp_path)  # or a file beside it
            outcomes.append(0)
    assert outcomes.count(0) > PER_SEED // 4


def test_line_breaks_leave_one_line() -> None:
    error = InputError("expected a name, got a\nb", where="a\r\nb.toml", key="key")
    assert str(error) == "a b.toml: key: expected a name, got a b"
    with pytest.raises(InputError, match=r"^no scene: expected the path of a scene"):
        read_scene("no\nscene")


@pytest.mark.parametrize("solid", ["baffles", "solids"])
@pytest.mark.parametrize("lower", [[0.0, 0.0], [0.3, 0.1]])
def test_a_solid_without_thickness_is_one_line(solid: str, lower: list[float]) -> None:
    data = {
        "domain": {"size": [1.0, 0.4], "cell": 0.02},
        "material": {"friction_deg": 30.0},
        "masses": [{"lower": [0.5, 0.0], "size": [0.1, 0.1]}],
        solid: [{"lower": lower, "size": [5.0e-13, 0.1]}],
    }
    with pytest.raises(InputError, match=rf"{solid}\[0\].*: expected .* 1e-09"):
        scene_from(data, Path())
