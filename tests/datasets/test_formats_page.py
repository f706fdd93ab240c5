"""The scenes that `docs/formats.md` shows are read."""

import re
import tomllib
from pathlib import Path

import pytest

from datasets.scene import Scene
from datasets.scene.library import read_scene
from datasets.scene.particles import initial_particles
from datasets.schema import from_mapping

PAGE = (Path(__file__).parents[2] / "docs" / "formats.md").read_text(encoding="utf-8")


def section(title: str) -> str:
    """The part of the page under `title`."""
    return PAGE.split(f"\n## {title}\n")[1].split("\n## ")[0]


def test_the_scene_on_the_page_loads() -> None:
    (text,) = re.findall(r"```toml\n(.*?)```", section("Scene (TOML)"), re.DOTALL)
    assert from_mapping(Scene, tomllib.loads(text)).damping == 0.12


def test_the_solids_on_the_page_load(tmp_path: Path) -> None:
    (flume,) = re.findall(r"```toml\n(.*?)```", section("Solids and bodies (TOML)"), re.DOTALL)
    (tmp_path / "flume.toml").write_text(flume)
    scene = read_scene(str(tmp_path / "flume.toml"))
    assert [solid.kind for solid in scene.solids] == ["terrain", "box", "polygon"]
    assert initial_particles(scene).volume.sum() == pytest.approx(0.12)
