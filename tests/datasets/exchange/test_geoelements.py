"""python -m datasets.exchange: there and back; nothing overwritten or executed."""

import dataclasses
import json
import os
import pickle
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from datasets import Baffle, Mass, Material, Solid, read_scene, write_scene
from datasets.command_line import run
from datasets.exchange import geoelements
from datasets.exchange.__main__ import at_tangent, command, lattice_spacing
from datasets.files import write_json
from datasets.flow.trajectory import Trajectory
from datasets.scene.particles import initial_particles, lattice_counts
from tests.breaking import dataset_files
from tests.datasets.conftest import FRAMES, toy, toy_dataset, toy_scene
from tests.datasets.flow.test_array_files import OBJECTS, Calls, npy, with_member
from tests.refusals import refused, refused_by
from tests.scenes import scene_of

TO, FROM = ("--to", "geoelements"), ("--from", "geoelements")
KEYS = ("bounds", "sequence_length", "dim", "dt", "vel_mean", "vel_std", "acc_mean")
SAND = (toy(2).positions + 0.1, 6)
BROKEN = np.where(np.arange(FRAMES)[:, None, None] == 3, np.nan, SAND[0])
POSITIONS = np.random.default_rng(0).random((4, 5, 2))
TYPES = np.array([6, 3, 6, 6, 3])


def exchange(*arguments: object) -> int:
    return run(command, "python -m datasets.exchange", [str(argument) for argument in arguments])


def scene_file(folder: Path, dimension: int) -> Path:
    """The scene of the toys without baffles, of other sand and another body."""
    toys, path = toy_scene(dimension, 0), folder / f"scene-{dimension}.toml"
    body, sand = Mass(lower=(0.0,) * dimension, size=(0.06,) * dimension), Material(friction_deg=25.0)
    write_scene(dataclasses.replace(toys, baffles=(), masses=(body,), material=sand, duration=1.0), path)
    return path


@pytest.mark.parametrize(("dimension", "up"), [(2, "y"), (3, "y"), (3, "z")])
def test_there_and_back(tmp_path: Path, dimension: int, up: str) -> None:
    ours, theirs, back = (tmp_path / name for name in ("ours", "theirs", "back"))
    scene = scene_file(tmp_path, dimension)
    toy_dataset(ours, dimension)
    assert exchange(ours, *TO, "--out", theirs) == 0
    # As the peers' loader does it, on a file that this test has just written.
    with np.load(theirs / "train.npz", allow_pickle=True) as file:
        assert file.files == ["toy-0000", "toy-0001"]
        positions, types, material = file["toy-0001"]
        assert (positions.dtype, set(types.tolist())) == (np.float32, {3, 6})
        np.testing.assert_array_equal(material == 0.0, types == 3)
        solid = geoelements.obstacle_particles(toy_scene(dimension, 1))  # baffles stand
        np.testing.assert_array_equal(positions[:, types == 3], np.float32(solid)[None].repeat(FRAMES, axis=0))
    if up == "z":
        lay_down(theirs)
    assert exchange(theirs, *FROM, "--scene", scene, "--up", up, "--out", back) == 0
    for split in ("train", "valid", "test"):
        before, after = (sorted((folder / split).glob("*.npz")) for folder in (ours, back))
        assert [path.name for path in before] == [path.name for path in after] != []
        for a, b in zip(map(Trajectory.load, before), map(Trajectory.load, after), strict=True):
            np.testing.assert_array_equal(a.positions, b.positions)
            np.testing.assert_array_equal(a.friction, b.friction)
            np.testing.assert_allclose(a.volumes, b.volumes, rtol=1e-6)
            np.testing.assert_allclose(a.time, b.time, rtol=1e-12)
            assert (b.scene.domain, b.scene.frames) == (a.scene.domain, FRAMES)
            assert b.scene.material.friction_deg == pytest.approx(a.scene.material.friction_deg, rel=1e-6)
            tenth = 0.1 * a.scene.domain.cell
            for key, tolerance in (("lower", tenth), ("size", tenth), ("velocity", 0.01)):
                body, whole = (getattr(flow.scene.masses[0], key) for flow in (a, b))
                np.testing.assert_allclose(whole, body, atol=tolerance)
    before, after = (json.loads((folder / "metadata.json").read_text()) for folder in (ours, back))
    for key in KEYS:
        np.testing.assert_allclose(before[key], after[key], rtol=1e-9)
    assert (after["splits"], after["seed"]) == ({"train": 2, "valid": 1, "test": 1}, None)
    assert (after["definition"], after["exchange"]["from"]) == ("geoelements", "geoelements")


def lay_down(folder: Path) -> None:
    """Exchange y and z in all files of a set in 3D."""
    for path in folder.glob("*.npz"):
        with np.load(path, allow_pickle=True) as file:
            flows = {name: file[name] for name in file.files}
        for flow in flows.values():
            flow[0] = flow[0][..., [0, 2, 1]]
        np.savez(path, **flows)
    content = json.loads((folder / "metadata.json").read_text())
    write_json(folder / "metadata.json", content | {"bounds": [content["bounds"][axis] for axis in (0, 2, 1)]})


def test_nothing_else_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ours = toy_dataset(tmp_path / "ours", 2)
    assert "empty folder" in refused_by(capsys, command, ours, *TO, "--out", ours)
    exchange(ours, *TO, "--out", tmp_path / "theirs")
    before = dataset_files(tmp_path / "theirs")
    assert "empty folder" in refused_by(capsys, command, ours, *TO, "--out", tmp_path / "theirs")
    assert dataset_files(tmp_path / "theirs") == before
    toy(3).save(ours / "train" / "toy-0009.npz")
    assert "toy-0009.npz" in refused_by(capsys, command, ours, *TO, "--out", tmp_path / "mixed")
    assert not (tmp_path / "mixed").exists()


def objects(*parts: Any) -> np.ndarray:
    """An array of objects, as they pickle it."""
    data = np.empty(len(parts), dtype=object)
    for index, part in enumerate(parts):
        data[index] = part
    return data


def foreign(folder: Path, *, material: float | None = 0.7) -> Path:
    """A set as geoelements' own generator makes it: one array of all trajectories, a box away from the origin."""
    sand = toy(2).positions + 0.1
    positions = np.concatenate([sand, np.full((FRAMES, 3, 2), 0.2)], axis=1)
    types, given = np.repeat([6, 3], [sand.shape[1], 3]), () if material is None else (material,)
    data = objects((positions, types, *given), (positions[:, types == 6], 6, *given))
    folder.mkdir(parents=True)
    np.savez_compressed(folder / "train.npz", gns_data=data)
    bounds = [[0.1, 0.1 + length] for length in toy_scene(2, 0).domain.size]
    described = {"bounds": bounds, "dim": 2, "dt": 0.0025}
    write_json(folder / "metadata.json", {"train": described, "rollout": described})
    return folder


@pytest.mark.parametrize(("material", "tangent"), [(0.7, 0.7), (None, np.tan(np.radians(25.0)))])
def test_a_set_that_geoelements_generated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], material: float | None, tangent: float
) -> None:
    source = foreign(tmp_path / "theirs", material=material)
    assert exchange(source, *FROM, "--scene", scene_file(tmp_path, 2), "--out", tmp_path / "back") == 0
    for name in ("00000", "00001"):
        flow = Trajectory.load(tmp_path / "back" / "train" / f"{name}.npz")
        np.testing.assert_allclose(flow.positions, toy(2).positions, atol=1.0e-6)
        np.testing.assert_allclose(flow.velocity0[:, 0], 1.0, atol=0.05)
        np.testing.assert_allclose(flow.friction, tangent, rtol=1e-6)
        np.testing.assert_allclose(flow.volumes, toy(2).volumes, rtol=0.02)  # though nothing says their spacing
        np.testing.assert_allclose(flow.scene.masses[0].size, toy_scene(2, 0).masses[0].size, rtol=0.01)
    line = refused_by(capsys, command, source, *FROM, "--scene", "column-tall-42", "--out", tmp_path / "b")
    assert "expected a scene in the box of the set" in line


def test_volumes_follow_the_spacing_of_each_trajectory(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, spacings = foreign(tmp_path / "theirs"), {"coarse": 0.01, "fine": 0.004}

    def write(spacings: dict[str, float]) -> None:
        flows = {}
        for name, spacing in spacings.items():
            lattice = 0.15 + spacing * np.stack(np.meshgrid(np.arange(9.0), np.arange(7.0)), axis=-1).reshape(-1, 2)
            flows[name] = objects(np.repeat(lattice[None], FRAMES, axis=0), 6)
        np.savez(source / "train.npz", **flows)

    write(spacings)
    assert exchange(source, *FROM, "--scene", scene_file(tmp_path, 2), "--out", tmp_path / "back") == 0
    for name, spacing in spacings.items():
        flow = Trajectory.load(tmp_path / "back" / "train" / f"{name}.npz")
        np.testing.assert_allclose(flow.volumes, spacing**2, rtol=1e-4)
        assert len(flow.volumes) == 63
    for name, spacing, said in (("../away", 0.01, "a name that a file can have"), ("heap", 0.0, "that are apart")):
        write({name: spacing})
        wrong = (source, *FROM, "--scene", scene_file(tmp_path, 2), "--out", tmp_path / "other")
        assert said in refused_by(capsys, command, *wrong)


@pytest.mark.parametrize("jitter", [0.0, 0.5, 0.8])
@pytest.mark.parametrize("size", [(0.187, 0.124), (0.4, 0.05), (0.113, 0.08, 0.126)])
def test_the_lattice_of_a_box(size: tuple[float, ...], jitter: float) -> None:
    body, dimension = Mass(lower=(0.1,) * len(size), size=size), len(size)
    scene = scene_of(body, size=(1.0,) * dimension, jitter=jitter)
    places = initial_particles(scene).positions
    rows, own = lattice_counts(scene, body), (np.prod(size) / len(places)) ** (1.0 / dimension)
    for given, spacing, rtol in ((0.01, 0.01, 1.0e-12), (None, own, 0.04)):
        np.testing.assert_allclose(lattice_spacing(places, given)[0], spacing, rtol=rtol)
        assert lattice_spacing(places, given)[1] == tuple(rows)
    inside = (((places - 0.1) / size - 0.5) ** 2).sum(axis=1) < 0.25
    assert lattice_spacing(places[inside], 0.01) == (0.01, None)
    assert lattice_spacing(places[inside], None)[1] is None


def trajectories(folder: Path, *flows: tuple[Any, ...], **described: Any) -> Path:
    """A set with these trajectories to train on, and other keys of `metadata.json`."""
    source = foreign(folder)
    np.savez(source / "train.npz", **{f"{index}": objects(*parts) for index, parts in enumerate(flows)})
    write_json(source / "metadata.json", json.loads((source / "metadata.json").read_text())["train"] | described)
    return source


def test_the_scene_keeps_its_materials(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sand, positions = Material(friction_deg=40.0, cohesion=3000.0, density=2000.0), toy(2).positions + 0.1
    cone = positions[:, positions[0, :, 0] - 0.15 < positions[0, :, 1] - 0.1]
    source = trajectories(tmp_path / "theirs", (positions, 6, 0.7), (positions, 6), (cone, 6, 0.7))
    path, body = scene_file(tmp_path, 2), Mass(lower=(0.0, 0.0), size=(0.06, 0.06), material=sand, k0=0.5)
    scene = dataclasses.replace(read_scene(path), masses=(body,))
    write_scene(scene, path)
    assert exchange(source, *FROM, "--scene", path, "--out", tmp_path / "one") == 0
    said = capsys.readouterr().out.splitlines()
    assert [line for line in said if "trajectories" in line] == [
        "1 of 3 trajectories have the masses of the scene, their particles begin in no box of one material: train 2"
    ]
    for index, tangent in enumerate((0.7, np.tan(np.radians(40.0)), 0.7)):
        flow = Trajectory.load(tmp_path / "one" / "train" / f"{index}.npz")
        (mass,), material = flow.scene.masses, flow.scene.material_of(flow.scene.masses[0])
        assert (mass.size == (0.06, 0.06), mass.k0) == (index == 2, 0.5)
        assert (material.cohesion, material.density) == (3000.0, 2000.0)
        np.testing.assert_allclose([material.friction, flow.friction.min()], tangent, rtol=1e-6)
    write_scene(dataclasses.replace(scene, masses=(body, Mass(lower=(0.3, 0.0), size=(0.1, 0.1)))), path)
    line = refused_by(capsys, command, source, *FROM, "--scene", path, "--out", tmp_path / "several")
    assert line.startswith(f"talus: {source / 'train.npz'}: 1: expected tan(phi) of the particles, or a scene of one")


def test_an_angle_stays_of_its_kind() -> None:
    slope = Material(friction_deg=20.0, angle="slope", friction_limit_deg=40.0, grain_diameter=1.0e-3)
    for sand in (slope, Material(friction_deg=20.0, dilation_deg=5.0)):
        other = at_tangent(sand, 0.6)
        assert other.friction == pytest.approx(0.6)
        assert dataclasses.replace(other, friction_deg=20.0) == sand


@pytest.mark.parametrize(
    ("parts", "described", "said"),
    [
        ((1000.0 * SAND[0], 6), {}, "train.npz: 0: expected positions within bounds"),
        ((BROKEN, 6), {}, "train.npz: 0: expected positions within bounds"),
        ((np.pad(SAND[0], ((0, 0), (0, 0), (0, 1))), 6), {}, "train.npz: 0: expected positions in 2D, as bounds"),
        ((*SAND, 35.0), {}, "train.npz: 0: expected a material property that is a tan(phi), 0 to 5, got 35.0"),
        ((*SAND, np.linspace(-0.1, 0.6, 320)), {}, "is a tan(phi), 0 to 5, got -0.1"),
        ((*SAND, 0.0), {}, "train.npz: 0.material.friction_deg: expected an angle above 0"),
        ((SAND[0][:, :1], 6), {}, "train.npz: 0: expected particles that are apart in the first frame"),
        (SAND, {"dx": 10.0}, "train.npz: 0: expected particles that are apart in the first frame and fit the box"),
        (SAND, {"dx": 1.0e-5}, "train.npz: 0: expected particles about dx in metadata.json apart, 1e-05 m"),
        (SAND, {"dx": -0.01}, "metadata.json: dx: expected a length in m"),
        (SAND, {"dt": -1.0}, "metadata.json: dt: expected a time in s"),
        (SAND, {"bounds": [[0.6, 0.1], [0.1, 0.35]]}, "metadata.json: bounds: expected a lower and an upper end"),
        (SAND, {"bounds": []}, "metadata.json: bounds: expected a lower and an upper end"),
        (SAND, {"train": 5}, "metadata.json: train: expected a JSON object"),
    ],
)
def test_what_is_not_imported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], parts: tuple[Any, ...], described: dict[str, Any], said: str
) -> None:
    source = trajectories(tmp_path / "theirs", parts, **described)
    line = refused_by(capsys, command, source, *FROM, "--scene", scene_file(tmp_path, 2), "--out", tmp_path / "back")
    assert said in line


def test_keys_that_name_no_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = trajectories(tmp_path / "theirs", SAND)
    with zipfile.ZipFile(source / "train.npz") as archive:
        content = archive.read("0.npy")
    for names, said in ((["k" * 300], "of at most 200 bytes"), (["a", "a"], "expected each key once")):
        with warnings.catch_warnings(action="ignore"), zipfile.ZipFile(source / "train.npz", "w") as archive:
            for name in names:
                archive.writestr(f"{name}.npy", content)
        wrong = (source, *FROM, "--scene", scene_file(tmp_path, 2), "--out", tmp_path / "back")
        assert said in refused_by(capsys, command, *wrong)
    np.savez(source / "train.npz", gns_data=np.array({}, dtype=object))
    refused(lambda: list(geoelements.read(source / "train.npz")), said="positions, particle types")


def test_every_solid_becomes_particles_that_stand() -> None:
    slope, spacing = Solid(kind="terrain", points=((0.0, 0.2), (1.0, 0.0))), 0.005
    roof = Solid(kind="polygon", vertices=((0.5, 0.2), (0.8, 0.2), (0.65, 0.35)))
    plate = Baffle(lower=(0.2, 0.3), size=(0.2, 0.004), turned_deg=30.0)
    body = Mass(lower=(0.05, 0.4), size=(0.1, 0.1))
    scene = scene_of(body, size=(1.0, 0.6), cell=0.01, solids=(slope, roof), baffles=(plate,))
    points = geoelements.obstacle_particles(scene)
    ground = 0.2 * (1.0 - points[:, 0]) - points[:, 1]
    below = points[ground > 0.0]
    # Two layers, but for what lies below the floor.
    np.testing.assert_allclose(np.unique(ground[ground > 0.0].round(6)), (0.5 * spacing, 1.5 * spacing), atol=1e-9)
    assert 2 * 200 - 60 < len(below) <= 2 * 200
    roofed = shapely.contains_xy(shapely.Polygon(roof.vertices), points[ground <= 0.0])
    assert roofed.sum() * spacing**2 == pytest.approx(0.5 * 0.3 * 0.15, rel=0.05)
    plated = points[ground <= 0.0][~roofed] - (0.3, 0.302)
    c, s = np.cos(np.radians(30.0)), np.sin(np.radians(30.0))
    along, across = plated @ (c, s), plated @ (-s, c)
    assert np.abs(across).max() < 0.002
    # No gap through which sand could pass.
    assert np.diff(np.sort(along), prepend=-0.1, append=0.1).max() < 2.0 * spacing


def test_solids_in_3d_become_particles_that_stand() -> None:
    heights = tuple(tuple(0.1 - 0.05 * i + 0.02 * j for j in range(3)) for i in range(3))
    terrain = Solid(kind="terrain", origin=(0.0, 0.0), spacing=(0.5, 0.2), heights=heights)
    corners = ((0.6, 0.3, 0.1), (0.8, 0.3, 0.1), (0.6, 0.5, 0.1), (0.6, 0.3, 0.3))
    tetrahedron = Solid(kind="mesh", vertices=corners, triangles=((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)))
    body = Mass(lower=(0.05, 0.3, 0.1), size=(0.1, 0.1, 0.1))
    turned = Baffle(lower=(0.2, 0.3, 0.1), size=(0.1, 0.1, 0.1), turned_deg=45.0)
    scene = scene_of(body, size=(1.0, 0.6, 0.4), cell=0.04, solids=(terrain, tetrahedron), baffles=(turned,))
    points, spacing = geoelements.obstacle_particles(scene), 0.02
    x, y, z = points.T
    depth = 0.1 - 0.1 * x + 0.1 * z - y
    np.testing.assert_allclose(np.unique(depth[depth > 0.0].round(6)), (0.5 * spacing, 1.5 * spacing), atol=1e-9)
    mesh, box = (x > 0.55) & (depth <= 0.0), (x <= 0.55) & (depth <= 0.0)
    assert mesh.sum() * spacing**3 == pytest.approx(0.2**3 / 6.0, rel=0.25)
    assert box.sum() * spacing**3 == pytest.approx(0.1**3, rel=0.15)
    assert ((x - 0.6) / 0.2 + (y - 0.3) / 0.2 + (z - 0.1) / 0.2)[mesh].max() < 1.0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--out", "o"), "one of --to and --from"),
        ((*TO, "--up", "z", "--out", "o"), "go with --from only"),
        ((*FROM, "--out", "o"), "--from needs --scene"),
        ((*FROM, "--scene", "column-tall-42", "--out", "o"), "metadata.json"),
    ],
)
def test_mistakes(tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], said: str) -> None:
    assert said in refused_by(capsys, command, tmp_path, *arguments)
    assert "there is none" in refused_by(capsys, command, tmp_path / "absent", *TO, "--out", "o")


def stored(path: Path, content: bytes, count: int = 1) -> Path:
    """An NPZ of one object array, pickled so."""
    return with_member(path, npy(OBJECTS.replace("(1,)", f"({count},)"), content))


def test_pickles_of_the_older_numpy(tmp_path: Path) -> None:
    content = pickle.dumps(objects(POSITIONS, TYPES), 2).replace(b"numpy._core.", b"numpy.core.")
    ((_, (positions, friction)),) = geoelements.read(stored(tmp_path / "train.npz", content, 2))
    np.testing.assert_array_equal(positions, POSITIONS[:, TYPES == 6])
    assert friction is None


@pytest.mark.parametrize(
    ("content", "count", "expected"),
    [
        (pickle.dumps(objects(POSITIONS), 2), 1, "positions, particle types"),
        (pickle.dumps(objects(POSITIONS, 3), 2), 2, "sand that moves"),
        (pickle.dumps(objects(POSITIONS, TYPES, np.array(["a"] * 5)), 2), 3, "material properties as numbers"),
        (b"", 1, "positions, particle types"),
        (pickle.dumps([1, 2]), 1, "positions as numbers"),
        (pickle.dumps(Calls(os.mkdir, "/nowhere/else")), 1, f"arrays and nothing else, found the name '{os.name}"),
    ],
)
def test_what_is_no_trajectory_or_hostile(tmp_path: Path, content: bytes, count: int, expected: str) -> None:
    path = stored(tmp_path / "bad.npz", content, count)
    error = refused(lambda: list(geoelements.read(path)), said=expected)
    assert (error.where, error.key) == (str(path), "data")
