"""`docs/formats.md` names every key that the files have, with the defaults they have, and shows a scene that loads."""

import dataclasses
import json
import re
import tomllib
from pathlib import Path

import meshio
import numpy as np
import pytest

from datasets.command_line import run
from datasets.definitions import NAMES, read_definition
from datasets.definitions.definition import Split
from datasets.definitions.flow2d import FLOW2D
from datasets.field import Field
from datasets.forces import write_forces
from datasets.geometry.surface import surface_of
from datasets.library import read_scene
from datasets.maps import __main__ as maps
from datasets.material import Material
from datasets.particles import initial_particles, mass_volumes
from datasets.records import from_mapping
from datasets.scene import Baffle, Domain, Mass, Scene, Solid
from datasets.training.metadata import metadata
from datasets.training.statistics import MOVING_SPEED, motion_statistics
from datasets.trajectory import Trajectory
from tests.datasets.toys import toy

PAGE = (Path(__file__).parents[2] / "docs" / "formats.md").read_text(encoding="utf-8")


def section(title: str) -> str:
    """The part of the page under `title`."""
    return PAGE.split(f"\n## {title}\n")[1].split("\n## ")[0]


def rows_of(title: str) -> list[list[str]]:
    """The rows of the tables under `title`, their cells from the second on."""
    return [line.split("|") for line in section(title).splitlines() if line.startswith("|")]


@pytest.mark.parametrize("kind", [Scene, Domain, Material, Mass, Field, Baffle, Solid])
def test_every_key_of_a_scene(kind: type) -> None:
    rows = rows_of("Scene (TOML)")
    if kind is Mass:
        rows += rows_of("Solids and bodies (TOML)")
    if kind is Solid:
        rows = rows_of("Solids and bodies (TOML)")
    for field in dataclasses.fields(kind):
        if field.name in ("domain", "masses", "fields", "baffles", "solids"):
            assert f"[{field.name}]" in PAGE
            continue
        (row, *_) = [row for row in rows if f"`{field.name}`" in row[1]]
        if isinstance(field.default, int | float):
            index = re.findall(r"`(\w+)`", row[1]).index(field.name)
            assert json.loads(row[2].split(",")[index]) == field.default


def test_the_scene_on_the_page_loads() -> None:
    (text,) = re.findall(r"```toml\n(.*?)```", section("Scene (TOML)"), re.DOTALL)
    assert from_mapping(Scene, tomllib.loads(text)).damping == 0.12


def test_the_solids_and_bodies_on_the_page_load(tmp_path: Path) -> None:
    flume, valley = re.findall(r"```toml\n(.*?)```", section("Solids and bodies (TOML)"), re.DOTALL)
    (tmp_path / "flume.toml").write_text(flume)
    scene = read_scene(str(tmp_path / "flume.toml"))
    assert [solid.kind for solid in scene.solids] == ["terrain", "box", "polygon"]
    assert initial_particles(scene).volume.sum() == pytest.approx(0.12)

    def raster(name: str, rows: list[str]) -> None:
        head = f"ncols {len(rows[0].split())}\nnrows {len(rows)}\nxllcorner 0\nyllcorner 0\ncellsize 0.1\n"
        (tmp_path / name).write_text(head + "\n".join(rows) + "\n")

    raster("dem.asc", ["0.2 " * 20] * 10)
    raster("friction.asc", ["0.4 " * 20] * 10)
    raster("release.tif", ["0.1 " * 5] * 10)  # what a raster is, its content says
    (tmp_path / "boulder.csv").write_text("x,y,z,vx,vy,vz\n0.6,0.5,0.5,1,0,0\n0.62,0.5,0.5,1,0,0\n")
    corners = np.array([[x, y, z] for x in (0.0, 200.0) for y in (0.0, 300.0) for z in (0.0, 200.0)])
    triangles = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    triangles += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    meshio.Mesh(corners, [("triangle", np.array(triangles))]).write(tmp_path / "block.stl")
    (tmp_path / "valley.toml").write_text(valley)
    scene = read_scene(str(tmp_path / "valley.toml"))
    assert [solid.kind for solid in scene.solids] == ["terrain", "mesh"]
    # Between the centres of the raster's cells.
    assert mass_volumes(scene)[0] == pytest.approx(0.4 * 0.9 * 0.1, rel=1e-6)
    assert initial_particles(scene).velocities[-1].tolist() == [1.0, 0.0, 0.0]
    surface = surface_of(scene)
    assert surface is not None
    assert set(surface.solid.tolist()) == {0, 1, 2}


def test_every_key_of_a_trajectory(tmp_path: Path, trajectory: Trajectory) -> None:
    shapes = {
        "volume": (5,),
        "mass": (5,),
        "velocities": (3, 5, 2),
        "stress": (3, 5, 4),
        "pressure": (3, 5),
        "density": (3, 5),
        "plastic_strain": (3, 5),
        "solid_impulse": (3, 0, 2),
    }
    fields = {key: np.zeros(shape, np.int32 if key == "mass" else np.float64) for key, shape in shapes.items()}
    dataclasses.replace(trajectory, **fields).save(tmp_path / "trajectory.npz")
    with np.load(tmp_path / "trajectory.npz", allow_pickle=False) as file:
        named = set(re.findall(r"^\| `(\w+)` \|", section("Trajectory (NPZ)"), re.MULTILINE))
        assert named == set(file.files)


def test_every_key_of_the_metadata() -> None:
    written = metadata(
        FLOW2D, FLOW2D.entries(seed=0, count=1), seed=0, statistics=motion_statistics(np.zeros((3, 1, 2)), 0.0025)
    )
    named = re.findall(r"`(\w+)`", section("Dataset (folder)"))
    assert written.keys() | written["statistics"].keys() <= set(named)
    assert f"{MOVING_SPEED:g} m/s" in PAGE


@pytest.mark.parametrize("name", NAMES)
def test_the_sizes_of_the_datasets(name: str) -> None:
    definition = read_definition(name)
    splits = [definition.split(index) for index in range(definition.size)]
    parts = [splits.count(split) for split in Split]
    assert f"| `{definition.name}` | {definition.size} ({', '.join(map(str, parts))}) |" in PAGE


def test_every_file_and_key_of_the_maps(tmp_path: Path) -> None:
    """What the command leaves in 2D and in 3D is on the page, and nothing else is."""
    text = section("Maps (folder)")
    for dimension in (2, 3):
        toy(dimension).save(tmp_path / f"{dimension}.npz")
        assert (
            run(maps.command, "maps", [str(tmp_path / f"{dimension}.npz"), "--out", str(tmp_path / str(dimension))])
            == 0
        )
    keys = {key for folder in "23" for key in json.loads((tmp_path / folder / "maps.json").read_text())}
    table = text.split("| key of `maps.json` |")[1]
    assert set(re.findall(r"`(\w+)`", table)) == keys
    columns = text.split("| column of `profile.csv` |")[1].split("\n\n")[0]
    assert set(re.findall(r"`(\w+)`", "".join(re.findall(r"^\| (`.*?) \|", columns, re.M)))) == set(
        (tmp_path / "2" / "profile.csv").read_text().splitlines()[0].split(",")
    )
    files = text.split("| file | holds |")[1].split("\n\n")[0]
    named = {
        name if not name.startswith(".") else row[0].split(".")[0] + name
        for row in (re.findall(r"`([\w.]+)`", line.split("|")[1]) for line in files.splitlines()[2:])
        for name in row
    }
    assert named == {path.name for path in (tmp_path / "3").iterdir()}
    assert all(f"`{path.name}`" in text for path in (tmp_path / "2").iterdir())


def test_the_columns_of_forces(tmp_path: Path) -> None:
    """The page names the columns as they are, in 2D and in 3D."""
    text = section("Forces (CSV and PNG)")
    for dimension in (2, 3):
        flow = toy(dimension)
        impulse = np.ones((len(flow.time), 2, dimension))
        write_forces(dataclasses.replace(flow, solid_impulse=impulse), tmp_path)
        head = (tmp_path / "forces.csv").read_text().splitlines()[0].split(",")
        assert f"`{head[0]}`" in text
        for column in head[1 : 1 + dimension]:
            name, ending = column.split("]_")
            assert f"`{name}]`" in text
            assert f"`_{ending}`" in text or f"`NAME_{ending}`" in text
    assert all(f"`{path.name}`" in text for path in tmp_path.iterdir())
