"""Scenes that look like another unit's or are none: warned of, or refused in one line."""

import dataclasses
from pathlib import Path

import pytest

from datasets import Domain, InputError, Mass, Material, Scene, read_scene
from datasets.checks import warn_if_unlikely
from datasets.library import SCENES

SAND = Material(friction_deg=30.0)
SCENE = Scene(
    domain=Domain(size=(1.0, 0.5), cell=0.05), material=SAND, masses=(Mass(lower=(0.0, 0.0), size=(0.2, 0.4)),)
)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"friction_deg": 0.52}, r"material\.friction_deg = 0\.52 degrees .* in radians it would be 29\.8 degrees"),
        ({"young": 200.0}, r"material\.young = 200 Pa is less than 10 rho g h = 7\.06e\+04 Pa"),
        (
            {"friction_limit_deg": 40.0, "grain_diameter": 0.7},
            r"diameter = 0\.7 m .* in mm it would be 0\.0007 m",
        ),
    ],
)
def test_numbers_of_another_unit_are_warned_of(changes: dict[str, float], message: str) -> None:
    with pytest.warns(UserWarning, match=message):
        warn_if_unlikely(dataclasses.replace(SCENE, material=dataclasses.replace(SAND, **changes)))


@pytest.mark.parametrize("name", sorted(path.stem for path in SCENES.glob("*.toml")))
def test_shipped_scenes_are_likely(name: str) -> None:
    warn_if_unlikely(read_scene(name))


def test_a_problem_is_no_scene(tmp_path: Path) -> None:
    path = tmp_path / "problem.toml"
    path.write_text('scene = "column-tall-42"\n[[unknowns]]\nname = "friction_deg"\n')
    with pytest.raises(InputError, match=r"problem\.toml: unknowns: expected a scene, got a problem: python"):
        read_scene(path)
