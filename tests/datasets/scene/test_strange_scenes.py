"""Scenes changed at random: each is read, or is one line that names the file and what was expected."""

import copy
import operator
from collections.abc import Iterator
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from datasets import InputError, read_scene
from datasets.files import read_toml
from datasets.scene.library import SCENES
from datasets.scene.particles import initial_particles

LONGEST = 3000
"""Characters of a line."""
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
