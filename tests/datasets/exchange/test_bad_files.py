"""Files and scenes damaged at random: each is read, or is one line that names the file and what was expected."""

import copy
import operator
from collections.abc import Callable, Iterator
from functools import reduce
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from datasets import InputError, Trajectory, read_scene, read_trajectory
from datasets.exchange import geoelements
from datasets.exchange.spreadsheet import read_columns
from datasets.files import read_toml
from datasets.scene.library import SCENES, scene_from
from datasets.scene.particles import initial_particles
from tests.datasets.conftest import toy
from tests.datasets.geometry.solids import sphere

LONGEST = 3000
"""Characters of a line."""
EDITS = st.lists(
    st.tuples(st.floats(0.0, 1.0), st.sampled_from((0, 1, 1, 20, 10**9)), st.binary(max_size=8)), min_size=1, max_size=4
)
"""Where in a file, as a share of its length, how many bytes go, and what stands in their place."""
TEXTS = st.text(st.characters(codec="utf-8"), max_size=5) | st.sampled_from(("box", "mesh", "layer"))
NUMBERS = st.booleans() | st.integers() | st.floats() | st.sampled_from((10**9, 10**30, 1e-300, 1e300))
VALUES = st.recursive(
    NUMBERS | TEXTS, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXTS, inner, max_size=2), max_leaves=4
)


def one_line(error: InputError, path: Path) -> None:
    line = str(error)
    assert "\n" not in line
    assert str(path) in line
    assert "expected" in line
    assert len(line) < LONGEST


def damaged(content: bytes, edits: list[tuple[float, int, bytes]]) -> bytes:
    """`content` after `EDITS`."""
    for share, count, others in edits:
        index = int(share * len(content))
        content = content[:index] + others + content[index + count :]
    return content


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
    read, content, refused = KINDS[kind][1], whole.read_bytes(), []
    read(whole)

    @given(edits=EDITS)
    def is_read_or_refused(edits: list[tuple[float, int, bytes]]) -> None:
        whole.write_bytes(damaged(content, edits))
        try:
            read(whole)
        except InputError as error:
            # Of a scene that is right as a file the keys are wrong, which has no file where it was not read.
            one_line(error, whole if error.where else Path())
            refused.append(error)

    is_read_or_refused()
    assert len(refused) > 5


def places(data: Any, way: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The keys that lead to each value in tables and lists."""
    for key, value in data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ():
        yield (*way, key)
        yield from places(value, (*way, key))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", ["baffles-2", "layers-10", "slope-layers", "valley-3d"])
def test_strange_scenes(name: str, tmp_path: Path) -> None:
    """With another value somewhere, or one that is gone."""
    path, refused = tmp_path / "scene.toml", []
    (tmp_path / "valley-3d.asc").write_bytes((SCENES / "valley-3d.asc").read_bytes())
    good = read_toml(SCENES / f"{name}.toml")

    @given(place=st.sampled_from([*places(good)]), value=VALUES | st.none())
    def is_read_or_refused(place: tuple[Any, ...], value: Any) -> None:
        data = copy.deepcopy(good)
        inner = reduce(operator.getitem, place[:-1], data)
        inner[place[-1]] = value
        if value is None:
            del inner[place[-1]]
        path.write_text(tomli_w.dumps(data), encoding="utf-8")
        try:
            scene = read_scene(path)
            if scene.particle_volume * 1e6 > np.prod(scene.domain.size):
                assert np.isfinite(initial_particles(scene).positions).all()
        except InputError as error:
            one_line(error, tmp_path)  # or a file beside it
            refused.append(error)

    is_read_or_refused()
    assert len(refused) > 5


def test_line_breaks_leave_one_line() -> None:
    error = InputError("expected a name, got a\nb", where="a\r\nb.toml", key="key")
    assert str(error) == "a b.toml: key: expected a name, got a b"
    with pytest.raises(InputError, match=r"^no scene: expected the path of a scene"):
        read_scene("no\nscene")
