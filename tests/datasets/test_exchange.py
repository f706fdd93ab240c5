"""python -m datasets.exchange: there and back, finished after an interruption; nothing overwritten or executed."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from datasets.command_line import run
from datasets.errors import InputError
from datasets.exchange import geoelements, lagrangebench
from datasets.exchange.__main__ import command
from datasets.exchange.cloud import Cloud, cloud_of
from datasets.exchange.conversion import LAYOUTS
from datasets.files import write_json
from datasets.scene import Solid
from datasets.trajectory import Trajectory
from tests.datasets.toys import FRAMES, toy, toy_dataset, toy_scene

SPLITS = ("train", "valid", "test")

layouts = pytest.mark.parametrize("layout", list(LAYOUTS))


def exchange(*arguments: object) -> int:
    return run(command, "python -m datasets.exchange", [str(argument) for argument in arguments])


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    capsys.readouterr()
    assert exchange(*arguments) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("talus: ")]
    return line


def contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("dimension", [2, 3])
@layouts
def test_there_and_back(tmp_path: Path, layout: str, dimension: int) -> None:
    ours, theirs, back, again = (tmp_path / name for name in ("ours", "theirs", "back", "again"))
    toy_dataset(ours, dimension)
    assert exchange(ours, "--to", layout, "--out", theirs) == 0
    assert exchange(theirs, "--from", layout, "--out", back) == 0
    for split in SPLITS:
        before, after = (sorted((folder / split).glob("*.npz")) for folder in (ours, back))
        assert [path.name for path in before] == [path.name for path in after] != []
        for path, other in zip(before, after, strict=True):
            a, b = Trajectory.load(path), Trajectory.load(other)
            np.testing.assert_array_equal(a.positions, b.positions)
            np.testing.assert_array_equal(a.friction, b.friction)
            np.testing.assert_allclose(a.time, b.time, rtol=1e-12)
            assert a.scene == b.scene
    # Types too: what comes back gives the peers the same bytes.
    assert exchange(back, "--to", layout, "--out", again) == 0
    for split in SPLITS:
        name = f"{split}{LAYOUTS[layout].SUFFIX}"
        assert (theirs / name).read_bytes() == (again / name).read_bytes()
    before, after = (json.loads((folder / "metadata.json").read_text()) for folder in (ours, back))
    for key in ("bounds", "sequence_length", "default_connectivity_radius", "dim", "dt", "cell", "friction_deg"):
        assert before[key] == after[key]
    for key in ("vel_mean", "vel_std", "acc_mean", "acc_std"):
        np.testing.assert_allclose(before[key], after[key], rtol=1e-12)
    assert after["splits"] == {"train": 2, "valid": 1, "test": 1}
    assert "seed" not in after


@pytest.mark.parametrize("direction", ["--to", "--from"])
@layouts
def test_an_interrupted_conversion_is_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, layout: str, direction: str
) -> None:
    source = toy_dataset(tmp_path / "ours", 2)
    if direction == "--from":
        exchange(source, "--to", layout, "--out", tmp_path / "theirs")
        source = tmp_path / "theirs"
    assert exchange(source, direction, layout, "--out", tmp_path / "whole") == 0
    calls = 0
    load, save = Trajectory.load, Trajectory.save

    def stop(function: Any) -> Any:
        def counted(*arguments: Any) -> Any:
            nonlocal calls
            calls += 1
            if calls == 3:
                raise KeyboardInterrupt
            return function(*arguments)

        return counted

    with monkeypatch.context() as patch:
        if direction == "--to":
            patch.setattr(Trajectory, "load", staticmethod(stop(load)))
        else:
            patch.setattr(Trajectory, "save", stop(save))
        assert exchange(source, direction, layout, "--out", tmp_path / "broken") == 130
    assert not (tmp_path / "broken" / "metadata.json").exists()
    assert 1 < len(contents(tmp_path / "broken")) < len(contents(tmp_path / "whole"))
    for _ in range(2):
        assert exchange(source, direction, layout, "--out", tmp_path / "broken") == 0
        assert contents(tmp_path / "broken") == contents(tmp_path / "whole")


def test_nothing_else_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ours = toy_dataset(tmp_path / "ours", 2)
    assert "empty folder" in refused(capsys, ours, "--to", "geoelements", "--out", ours)
    exchange(ours, "--to", "geoelements", "--out", tmp_path / "theirs")
    before = contents(tmp_path / "theirs")
    assert "begun with" in refused(capsys, ours, "--to", "lagrangebench", "--out", tmp_path / "theirs")
    other = toy_dataset(tmp_path / "other", 2)
    assert "begun with" in refused(capsys, other, "--to", "geoelements", "--out", tmp_path / "theirs")
    assert contents(tmp_path / "theirs") == before
    exchange(tmp_path / "theirs", "--from", "geoelements", "--out", tmp_path / "back")
    toy(2).save(tmp_path / "back" / "train" / "stranger.npz")
    line = refused(capsys, tmp_path / "theirs", "--from", "geoelements", "--out", tmp_path / "back")
    assert "stranger.npz" in line


def test_what_their_formats_do_not_hold(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ours = toy_dataset(tmp_path / "ours", 2)
    toy(3).save(ours / "train" / "toy-0009.npz")
    assert "toy-0009.npz" in refused(capsys, ours, "--to", "geoelements", "--out", tmp_path / "theirs")
    flow = toy(2)
    wall = Solid(lower=(0.45, 0.0), size=(0.02, 0.1))
    path = ours / "train" / "toy-0000.npz"
    dataclasses.replace(flow, scene=dataclasses.replace(flow.scene, solids=(wall,))).save(path)
    line = refused(capsys, ours, "--to", "geoelements", "--out", tmp_path / "theirs")
    assert "toy-0000.npz: solids: expected a scene without solids" in line
    assert not (tmp_path / "theirs").exists()


def foreign(folder: Path, dimension: int, *, material: Any = 0.7, **more: Any) -> Path:
    """A set as geoelements' own generator makes it: one array of all trajectories, a box away from the origin."""
    cloud = cloud_of(toy(dimension), "")
    positions, types = cloud.positions + 0.1, np.where(cloud.stationary, 3, 6)
    data = np.empty(2, dtype=object)
    for index, each in enumerate([(positions, types, material), (positions[:, types == 6], 6, material)]):
        data[index] = each if material is not None else each[:2]
    folder.mkdir(parents=True)
    np.savez_compressed(folder / "train.npz", gns_data=data)
    described = {
        "bounds": [[0.1, 0.1 + length] for length in toy_scene(dimension, 0).domain.size],
        "default_connectivity_radius": 0.029,
        "dim": dimension,
        "dt": 0.0025,
        **more,
    }
    write_json(folder / "metadata.json", {"train": described, "rollout": described})
    return folder


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_set_that_geoelements_generated_is_given_a_scene(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], dimension: int
) -> None:
    source, scene = foreign(tmp_path / "theirs", dimension), tmp_path / "scene.toml"
    scene.write_text(toml_of(dimension))
    assert "--scene" in refused(capsys, source, "--from", "geoelements", "--out", tmp_path / "none")
    assert exchange(source, "--from", "geoelements", "--scene", scene, "--out", tmp_path / "back") == 0
    for name in ("00000", "00001"):
        flow = Trajectory.load(tmp_path / "back" / "train" / f"{name}.npz")
        np.testing.assert_allclose(flow.positions, toy(dimension).positions, atol=1.0e-6)
        np.testing.assert_allclose(flow.velocity0[:, 0], 1.0, atol=0.05)
        np.testing.assert_allclose(flow.friction, 0.7)
        assert (flow.scene.domain, flow.scene.frames) == (toy_scene(dimension, 0).domain, FRAMES)
    described = json.loads((tmp_path / "back" / "metadata.json").read_text())
    assert (described["definition"], described["exchange"]["from"]) == ("geoelements", "geoelements")
    bare = foreign(tmp_path / "bare", dimension, material=None)
    assert exchange(bare, "--from", "geoelements", "--scene", scene, "--out", tmp_path / "bare-back") == 0
    friction = Trajectory.load(tmp_path / "bare-back" / "train" / "00000.npz").friction
    np.testing.assert_allclose(friction, np.tan(np.radians(25.0)), rtol=1e-6)
    line = refused(capsys, source, "--from", "geoelements", "--scene", "column-tall-42", "--out", tmp_path / "b")
    assert "expected a scene in the box of the set" in line


def toml_of(dimension: int) -> str:
    """The box of the toys, with one mass."""
    domain, mass = toy_scene(dimension, 0).domain, toy_scene(dimension, 0).masses[0]
    return (
        f"duration = 1.0\n[domain]\nsize = {list(domain.size)}\ncell = {domain.cell}\n[material]\nfriction_deg = 25.0\n"
        f"[[masses]]\nlower = {list(mass.lower)}\nsize = {list(mass.size)}\n"
    )


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--out", "o"), "one of --to and --from"),
        (("--to", "geoelements", "--up", "z", "--out", "o"), "with --from alone"),
        (("--from", "geoelements", "--out", "o"), "metadata.json"),
        (("--to", "geoelements", "--out", "o"), "metadata.json"),
    ],
)
def test_mistakes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], expected: str
) -> None:
    assert expected in refused(capsys, tmp_path, *arguments)
    assert "there is none" in refused(capsys, tmp_path / "absent", "--to", "geoelements", "--out", "o")


STREAM = np.random.default_rng(0)
POSITIONS = STREAM.random((4, 5, 2))
TYPES = np.array([6, 3, 6, 6, 3])
FRICTION = np.array([0.5, 0.0, 0.6, 0.7, 0.0], np.float32)


def stored_npz(path: Path, *parts: Any) -> Path:
    data = np.empty(len(parts), dtype=object)
    for index, part in enumerate(parts):
        data[index] = part
    np.savez(path, simulation_trajectory_0=data)
    return path


def stored_hdf5(path: Path, **arrays: Any) -> Path:
    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            file[f"00000/{name}"] = array
    return path


def only(path: Path) -> Cloud:
    """The one trajectory of a file in either layout."""
    layout: Any = geoelements if path.suffix == ".npz" else lagrangebench
    (name,) = layout.names(path)
    (cloud,) = layout.read(path, {name})
    assert isinstance(cloud, Cloud)
    return cloud


@pytest.mark.parametrize("dimension", [2, 3])
def test_their_readers_take_what_talus_writes(tmp_path: Path, dimension: int) -> None:
    written = [cloud_of(toy(dimension, seed), f"toy-{seed}") for seed in range(2)]
    for name in ("a", "b"):
        geoelements.write(tmp_path / f"{name}.npz", written)
        lagrangebench.write(tmp_path / f"{name}.h5", written)
    for suffix in (".npz", ".h5"):
        assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()
    # As the peers' loader does it, on a file that this test has just written.
    with np.load(tmp_path / "a.npz", allow_pickle=True) as file:
        assert file.files == ["toy-0", "toy-1"]
        for (positions, types, material), cloud in zip([file[key] for key in file.files], written, strict=True):
            assert positions.dtype == np.float32
            np.testing.assert_array_equal(positions, cloud.positions)
            np.testing.assert_array_equal(types == 3, cloud.stationary)
            assert set(types.tolist()) == {3, 6}
            np.testing.assert_array_equal(material == 0.0, cloud.stationary)
    with h5py.File(tmp_path / "a.h5") as file:
        for name, cloud in zip(file, written, strict=True):
            np.testing.assert_array_equal(file[f"{name}/position"][1:3], cloud.positions[1:3])
            np.testing.assert_array_equal(file[f"{name}/particle_type"][:], cloud.stationary.astype(int))
            np.testing.assert_array_equal(file[f"{name}/material_property"][:], cloud.friction)


@pytest.mark.parametrize(
    ("material", "expected"),
    [
        (None, None),
        (FRICTION.astype(np.float64)[:, None], FRICTION),
        (0.5, [0.5, 0.0, 0.5, 0.5, 0.0]),
        (FRICTION[TYPES == 6], FRICTION),
    ],
)
def test_material_properties(tmp_path: Path, material: Any, expected: Any) -> None:
    cloud = only(stored_npz(tmp_path / "train.npz", POSITIONS, TYPES, *(() if material is None else (material,))))
    np.testing.assert_array_equal(cloud.stationary, TYPES == 3)
    np.testing.assert_array_equal(cloud.positions, POSITIONS)
    if expected is None:
        assert cloud.friction is None
    else:
        np.testing.assert_array_equal(cloud.friction, np.asarray(expected, np.float32))


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        ((POSITIONS,), "positions, particle types"),
        ((np.where(POSITIONS > 0.5, np.nan, POSITIONS), TYPES), "positions within"),
        ((POSITIONS, 3), "sand that moves"),
        ((POSITIONS, TYPES, np.array(["a"] * 5)), "found the dtype"),
    ],
)
def test_what_is_no_trajectory(tmp_path: Path, parts: tuple[Any, ...], expected: str) -> None:
    path = stored_npz(tmp_path / "train.npz", *parts)
    with pytest.raises(InputError) as caught:
        only(path)
    assert expected in str(caught.value)
    assert (caught.value.where, caught.value.key) == (str(path), "simulation_trajectory_0")


def test_links_out_of_the_file(tmp_path: Path) -> None:
    stored_hdf5(tmp_path / "other.h5", position=POSITIONS)
    path = stored_hdf5(tmp_path / "train.h5", particle_type=TYPES)
    with h5py.File(path, "a") as file:
        file["00000/position"] = h5py.ExternalLink("other.h5", "00000/position")
    with pytest.raises(InputError, match="an array of numbers in the file"):
        only(path)
