"""`docs/formats.md` names every key that the files have, with the defaults they have, and shows a scene that loads."""

import dataclasses
import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from datasets.definitions import NAMES, read_definition
from datasets.definitions.definition import Split
from datasets.definitions.flow2d import FLOW2D
from datasets.field import Field
from datasets.library import read_scene
from datasets.material import Material
from datasets.particles import initial_particles
from datasets.records import from_mapping
from datasets.scene import Baffle, Channel, Domain, Gate, Mass, Scene, Solid
from datasets.training import MOVING_SPEED, metadata, motion_statistics
from datasets.trajectory import Trajectory

PAGE = (Path(__file__).parents[2] / "docs" / "formats.md").read_text(encoding="utf-8")


def section(title: str) -> str:
    """The part of the page under `title`."""
    return PAGE.split(f"\n## {title}\n")[1].split("\n## ")[0]


def rows_of(title: str) -> list[list[str]]:
    """The rows of the tables under `title`, their cells from the second on."""
    return [line.split("|") for line in section(title).splitlines() if line.startswith("|")]


@pytest.mark.parametrize("kind", [Scene, Domain, Material, Mass, Gate, Field, Channel, Baffle, Solid])
def test_every_key_of_a_scene(kind: type) -> None:
    rows = rows_of("Scene (TOML)")
    if kind is Mass:
        rows += rows_of("Solids and bodies (TOML)")
    if kind is Solid:
        rows = rows_of("Solids and bodies (TOML)")
    for field in dataclasses.fields(kind):
        if field.name in ("domain", "masses", "fields", "baffles", "solids", "stages", "channel"):
            assert f"[{field.name}]" in PAGE
            continue
        (row, *_) = [row for row in rows if f"`{field.name}`" in row[1]]
        if isinstance(field.default, int | float):
            index = re.findall(r"`(\w+)`", row[1]).index(field.name)
            assert json.loads(row[2].split(",")[index]) == field.default


def test_the_scene_on_the_page_loads() -> None:
    (text,) = re.findall(r"```toml\n(.*?)```", section("Scene (TOML)"), re.DOTALL)
    assert from_mapping(Scene, tomllib.loads(text)).damping == 0.12


def test_the_solids_on_the_page_load(tmp_path: Path) -> None:
    (flume,) = re.findall(r"```toml\n(.*?)```", section("Solids and bodies (TOML)"), re.DOTALL)
    (tmp_path / "flume.toml").write_text(flume)
    scene = read_scene(str(tmp_path / "flume.toml"))
    assert [solid.kind for solid in scene.solids] == ["terrain", "box", "polygon"]
    assert initial_particles(scene).volume.sum() == pytest.approx(0.12)


def test_every_key_of_a_trajectory(tmp_path: Path, trajectory: Trajectory) -> None:
    shapes = {
        "volume": (5,),
        "mass": (5,),
        "velocities": (3, 5, 2),
        "stress": (3, 5, 4),
        "pressure": (3, 5),
        "plastic_strain": (3, 5),
        "solid_impulse": (3, 0, 2),
    }
    fields = {key: np.zeros(shape, np.int32 if key == "mass" else np.float64) for key, shape in shapes.items()}
    dataclasses.replace(trajectory, **fields).save(tmp_path / "trajectory.npz")
    with np.load(tmp_path / "trajectory.npz", allow_pickle=False) as file:
        named = set(re.findall(r"^\| `(\w+)` \|", section("Trajectory (NPZ)"), re.MULTILINE))
        assert named == set(file.files)


def test_every_key_of_the_metadata() -> None:
    entries, statistics = FLOW2D.entries(seed=0, count=1), motion_statistics(np.zeros((3, 1, 2)), 0.0025)
    written = metadata("flow2d", entries, seed=0, statistics=statistics)
    rows = [
        row for row in rows_of("Dataset (folder)") if "definition" not in row[1] and row[1].strip()[1:-1] not in NAMES
    ]
    named = {key for row in rows for key in re.findall(r"`(\w+)`", row[1])}
    assert named == set(list(written)[: list(written).index("definition")])
    assert f"{MOVING_SPEED:g} m/s" in PAGE


def test_the_sizes_of_the_datasets() -> None:
    for definition in map(read_definition, NAMES):
        splits = [definition.split(index) for index in range(definition.size)]
        parts = [splits.count(split) for split in Split]
        assert f"| `{definition.name}` | {definition.size} ({', '.join(map(str, parts))}) |" in PAGE
