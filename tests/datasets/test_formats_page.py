"""`docs/formats.md` names every key of a scene, with its default, and of a trajectory; its scenes are read."""

import dataclasses
import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from datasets import Baffle, Channel, Domain, Gate, Mass, Material, Scene, Solid, Trajectory, read_scene
from datasets.scene.grid_field import Field
from datasets.scene.particles import initial_particles
from datasets.schema import from_mapping

PAGE = (Path(__file__).parents[2] / "docs" / "formats.md").read_text(encoding="utf-8")


def section(title: str) -> str:
    """The part of the page under `title`."""
    return PAGE.split(f"\n## {title}\n")[1].split("\n## ")[0]


def rows_of(title: str) -> list[list[str]]:
    """The rows of the tables under `title`, as cells."""
    return [line.split("|") for line in section(title).splitlines() if line.startswith("|")]


@pytest.mark.parametrize("kind", [Scene, Domain, Material, Mass, Gate, Field, Channel, Baffle, Solid])
def test_every_key_of_a_scene_stands_on_the_page_with_its_default(kind: type) -> None:
    rows = rows_of("Scene (TOML)") if kind is not Solid else []
    if kind in (Mass, Solid):
        rows += rows_of("Solids and bodies (TOML)")
    for field in dataclasses.fields(kind):
        if field.name in ("domain", "masses", "fields", "baffles", "solids", "stages", "channel"):
            assert f"[{field.name}]" in PAGE
            continue
        row = next((row for row in rows if f"`{field.name}`" in row[1]), None)
        assert row is not None, field.name
        if isinstance(field.default, int | float):
            index = re.findall(r"`(\w+)`", row[1]).index(field.name)
            assert json.loads(row[2].split(",")[index]) == field.default


def test_every_key_of_a_trajectory_stands_on_the_page(tmp_path: Path, trajectory: Trajectory) -> None:
    vectors, scalars = np.zeros((3, 5, 2)), np.zeros((3, 5))
    fields = {"velocities": vectors, "stress": np.zeros((3, 5, 4)), "pressure": scalars, "plastic_strain": scalars}
    own = {"volume": np.ones(5), "mass": np.zeros(5, np.int32), "solid_impulse": np.zeros((3, 0, 2))}
    dataclasses.replace(trajectory, **fields, **own).save(tmp_path / "trajectory.npz")
    with np.load(tmp_path / "trajectory.npz", allow_pickle=False) as file:
        named = set(re.findall(r"^\| `(\w+)` \|", section("Trajectory (NPZ)"), re.MULTILINE))
        assert named == set(file.files)


def test_the_scene_on_the_page_loads() -> None:
    (text,) = re.findall(r"```toml\n(.*?)```", section("Scene (TOML)"), re.DOTALL)
    assert from_mapping(Scene, tomllib.loads(text)).damping == 0.12


def test_the_solids_on_the_page_load(tmp_path: Path) -> None:
    (flume,) = re.findall(r"```toml\n(.*?)```", section("Solids and bodies (TOML)"), re.DOTALL)
    (tmp_path / "flume.toml").write_text(flume)
    scene = read_scene(str(tmp_path / "flume.toml"))
    assert [solid.kind for solid in scene.solids] == ["terrain", "box", "polygon"]
    assert initial_particles(scene).volume.sum() == pytest.approx(0.12)
