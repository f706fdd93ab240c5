"""A definition in TOML: the one on the page draws what it says, by its seed; mistakes are one line."""

import re
from pathlib import Path

import numpy as np
import pytest

from datasets.definitions import read_definition
from datasets.definitions.definition import Definition, Split
from datasets.errors import InputError
from datasets.geometry.placement import overlaps

PAGE = (Path(__file__).parents[2] / "docs" / "formats.md").read_text(encoding="utf-8")
(EXAMPLE,) = re.findall(r"```toml\n(.*?)```", PAGE.split("\n## Definition (TOML)\n")[1].split("\n## ")[0], re.DOTALL)

SMALL = """
[scene]
duration = 0.01
[scene.domain]
size = [0.4, 0.2]
cell = 0.02
[scene.material]
friction_deg = {friction}
[[scene.masses]]
lower = [{lower}, 0.0]
size = [0.1, 0.1]
"""


def definition(folder: Path, text: str = EXAMPLE, name: str = "steps.toml") -> Definition:
    (folder / name).write_text(text)
    return read_definition(str(folder / name))


def test_the_definition_on_the_page(tmp_path: Path) -> None:
    steps = definition(tmp_path)
    entries = steps.entries(seed=0)
    assert len(entries) == 200
    assert [sum(entry.split is split for entry in entries) for split in Split] == [160, 20, 20]
    scenes = [entry.scene for entry in entries]
    assert {scene.domain.size for scene in scenes} == {(1.0, 0.5), (1.5, 0.5)}
    assert {scene.domain.cell for scene in scenes} == {0.02, 0.025}
    assert {scene.duration for scene in scenes} == {0.5, 0.75}
    assert {len(scene.masses) for scene in scenes} == {1, 2}
    assert {len(scene.baffles) for scene in scenes} == {0, 1, 2}
    assert len({scene.seed for scene in scenes}) == 200
    angles = np.array([scene.material.friction_deg for scene in scenes])
    assert 20.0 <= angles.min() < 21.5
    assert 38.5 < angles.max() <= 40.0
    for scene in scenes:
        assert scene.material.tension_cutoff == pytest.approx(0.5 * scene.material.cohesion)
        assert len({mass.size[1] for mass in scene.masses}) == 1
        assert all(0.0999 < mass.size[1] < 0.3001 for mass in scene.masses)
        boxes = (*scene.masses, *scene.baffles)
        assert not overlaps(boxes).any()
        for baffle in scene.baffles:
            others = [box for box in boxes if box is not baffle]
            gaps = [max(b.lower[0] - a.lower[0] - a.size[0] for a, b in ((baffle, o), (o, baffle))) for o in others]
            assert all(gap > 0.0399 for gap in gaps) or any(o.lower[1] > 0.0 for o in others)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("{friction}", "{ uniform = [1.0] }", "scene.material.friction_deg.uniform: expected two numbers"),
        ("{friction}", "{ normal = [30, 2], step = 1 }", "no other key beside it than it, got step"),
        (
            "{friction}",
            "30.0\ncohesoin = 1.0",
            "scene.material.cohesoin: expected a known key, did you mean 'cohesion'",
        ),
        ("{friction}", "{ uniform = [91, 95] }", "(in each of 1000 draws)"),
    ],
)
def test_mistakes_name_file_and_key(tmp_path: Path, old: str, new: str, expected: str) -> None:
    text = SMALL.replace(old, new).replace("{friction}", "30.0").replace("{lower}", "0.1")
    with pytest.raises(InputError) as caught:
        definition(tmp_path, text)
    assert str(caught.value).startswith(f"{tmp_path / 'steps.toml'}: ")
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)
