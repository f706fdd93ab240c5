"""python -m datasets.exchange: there and back, finished after an interruption, nothing overwritten."""

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datasets.command_line import run
from datasets.exchange import conversion, geoelements, lagrangebench
from datasets.exchange.__main__ import command
from datasets.exchange.cloud import ForeignMetadata
from datasets.exchange.conversion import LAYOUTS
from datasets.files import write_json
from datasets.geometry.solid import Solid
from datasets.training.statistics import motion_statistics
from datasets.trajectory import Trajectory
from tests.datasets.toys import FRAMES, peer_dataset, peer_metadata, strewn, toy, toy_dataset, toy_scene

PAGE = Path(__file__).parents[2] / "docs" / "exchange.md"
SPLITS = ("train", "valid", "test")


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
@pytest.mark.parametrize("layout", ["geoelements", "lagrangebench"])
def test_there_and_back(tmp_path: Path, layout: str, dimension: int) -> None:
    ours, theirs, back, again = (tmp_path / name for name in ("ours", "theirs", "back", "again"))
    toy_dataset(ours, dimension)
    assert exchange(ours, "--to", layout, "--out", theirs) == 0
    assert exchange(theirs, "--from", layout, "--out", back) == 0
    for split in SPLITS:
        before, after = (sorted((folder / split).glob("*.npz")) for folder in (ours, back))
        assert len(before) == len(after) > 0
        if layout == "geoelements":
            assert [path.name for path in before] == [path.name for path in after]
        for path, other in zip(before, after, strict=True):
            a, b = Trajectory.load(path), Trajectory.load(other)
            np.testing.assert_array_equal(a.positions, b.positions)
            np.testing.assert_array_equal(a.friction, b.friction)
            np.testing.assert_allclose(a.time, b.time, rtol=1e-12)
            assert a.scene.domain == b.scene.domain
            assert a.scene.baffles == b.scene.baffles
            assert a.scene.material.friction_deg == b.scene.material.friction_deg
            assert b.summary["reconstructed"]["spacing_from"] == "dx"
    # Types too: what comes back gives the peers the same bytes.
    assert exchange(back, "--to", layout, "--out", again) == 0
    suffix = LAYOUTS[layout].SUFFIX
    for split in SPLITS:
        assert (theirs / f"{split}{suffix}").read_bytes() == (again / f"{split}{suffix}").read_bytes()
    before, after = (json.loads((folder / "metadata.json").read_text()) for folder in (ours, back))
    for key in ("bounds", "sequence_length", "default_connectivity_radius", "dim", "dt", "cell", "particles_per_axis"):
        assert before[key] == after[key]
    for key in ("vel_mean", "vel_std", "acc_mean", "acc_std"):
        np.testing.assert_allclose(before[key], after[key], rtol=1e-12)
    assert after["splits"] == {"train": 2, "valid": 1, "test": 1}
    assert "seed" not in after


@pytest.mark.parametrize("layout", ["geoelements", "lagrangebench"])
def test_what_the_peers_metadata_says(tmp_path: Path, layout: str) -> None:
    toy_dataset(tmp_path / "ours", 3)
    exchange(tmp_path / "ours", "--to", layout, "--out", tmp_path / "theirs")
    written = json.loads((tmp_path / "theirs" / "metadata.json").read_text())
    assert written["bounds"] == [[0.0, 0.4], [0.0, 0.2], [0.0, 0.16]]
    assert (written["dim"], written["dt"], written["dx"]) == (3, 0.0025, 0.01)
    train = np.stack([toy(3, seed).positions for seed in range(2)])
    expected = sum((motion_statistics(each, 0.0025) for each in train[1:]), motion_statistics(train[0], 0.0025))
    np.testing.assert_allclose(written["vel_std"], expected.velocity.std)
    particles = max(
        each.positions.shape[1]
        for split in SPLITS
        for path in [tmp_path / "theirs" / f"{split}{LAYOUTS[layout].SUFFIX}"]
        for each in LAYOUTS[layout].read(path, set(LAYOUTS[layout].names(path)))
    )
    if layout == "geoelements":
        # Of the peers' network: 5 velocities and 2 walls per axis, an embedding of 16, tan(phi).
        assert (written["nnode_in"], written["nedge_in"], written["material_feature_len"]) == (38, 4, 1)
        assert written["sequence_length"] == FRAMES
    else:
        assert (written["sequence_length_train"], written["num_trajs_train"]) == (FRAMES - 1, 2)
        assert written["num_particles_max"] == particles
        assert written["periodic_boundary_conditions"] == [False] * 3
        assert written["t_end"] == pytest.approx((FRAMES - 1) * 0.0025)


@pytest.mark.parametrize("direction", ["--to", "--from"])
@pytest.mark.parametrize("layout", ["geoelements", "lagrangebench"])
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
    finished = contents(tmp_path / "broken")
    assert 1 < len(finished) < len(contents(tmp_path / "whole"))
    assert exchange(source, direction, layout, "--out", tmp_path / "broken") == 0
    assert contents(tmp_path / "broken") == contents(tmp_path / "whole")
    assert exchange(source, direction, layout, "--out", tmp_path / "broken") == 0
    assert contents(tmp_path / "broken") == contents(tmp_path / "whole")


def test_nothing_else_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ours = toy_dataset(tmp_path / "ours", 2)
    assert "empty folder" in refused(capsys, ours, "--to", "geoelements", "--out", ours)
    exchange(ours, "--to", "geoelements", "--out", tmp_path / "theirs")
    before = contents(tmp_path / "theirs")
    assert "begun with" in refused(capsys, ours, "--to", "lagrangebench", "--out", tmp_path / "theirs")
    other = toy_dataset(tmp_path / "other", 2)
    toy(2, 9).save(other / "train" / "toy-0000.npz")
    assert "begun with" in refused(capsys, other, "--to", "geoelements", "--out", tmp_path / "theirs")
    assert contents(tmp_path / "theirs") == before
    exchange(tmp_path / "theirs", "--from", "geoelements", "--out", tmp_path / "back")
    toy(2).save(tmp_path / "back" / "train" / "stranger.npz")
    line = refused(capsys, tmp_path / "theirs", "--from", "geoelements", "--out", tmp_path / "back")
    assert "stranger.npz" in line


def test_trajectories_that_do_not_go_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ours = toy_dataset(tmp_path / "ours", 2)
    toy(3).save(ours / "train" / "toy-0009.npz")
    line = refused(capsys, ours, "--to", "geoelements", "--out", tmp_path / "theirs")
    assert "toy-0009.npz" in line
    assert not (tmp_path / "theirs").exists()


def test_solids_have_no_place_in_the_peers_formats(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ours = toy_dataset(tmp_path / "ours", 2)
    flow = toy(2)
    wall = Solid(lower=(0.45, 0.0), size=(0.02, 0.1))
    dataclasses.replace(flow, scene=dataclasses.replace(flow.scene, solids=(wall,))).save(
        ours / "train" / "toy-0000.npz"
    )
    line = refused(capsys, ours, "--to", "geoelements", "--out", tmp_path / "theirs")
    assert "toy-0000.npz: solids: expected a scene without solids" in line


def foreign(folder: Path, dimension: int, *, material: Any = 0.7, **more: Any) -> Path:
    """A set as geoelements' own generator makes it: points at random, obstacles too, bounds away from the origin."""
    stream = np.random.default_rng(dimension)
    spacing = 0.01 if dimension == 2 else 0.025
    sand = strewn(stream, (0.15, 0.11, 0.2)[:dimension], (0.2, 0.3, 0.3)[:dimension], spacing)
    obstacles = strewn(stream, (0.5, 0.1, 0.2)[:dimension], (0.1, 0.3, 0.1)[:dimension], spacing)
    points = np.concatenate([sand, obstacles])
    types = np.repeat([6, 3], [len(sand), len(obstacles)])
    step = np.zeros_like(points)
    step[: len(sand), 0] = 0.0025
    positions = points + step * np.arange(FRAMES)[:, None, None]
    trajectories = [(positions, types, material), (positions[:, : len(sand)], 6, material)]
    return peer_dataset(
        folder,
        [each if material is not None else each[:2] for each in trajectories],
        {"train": peer_metadata(dimension, **more), "rollout": peer_metadata(dimension, **more)},
    )


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_set_of_the_peers_own_making(tmp_path: Path, dimension: int) -> None:
    source = foreign(tmp_path / "theirs", dimension)
    assert exchange(source, "--from", "geoelements", "--out", tmp_path / "back") == 0
    first, second = (Trajectory.load(tmp_path / "back" / "train" / f"{name}.npz") for name in ("00000", "00001"))
    assert first.scene.domain.size == (0.8,) * dimension
    assert first.scene.domain == second.scene.domain
    assert first.scene.particle_volume == pytest.approx((0.01 if dimension == 2 else 0.025) ** dimension, rel=0.2)
    (baffle,) = first.scene.baffles
    np.testing.assert_allclose(baffle.lower, [0.4, 0.0, 0.1][:dimension], atol=0.01)
    assert second.scene.baffles == ()
    (mass,) = first.scene.masses
    np.testing.assert_allclose(mass.velocity, [1.0, 0.0, 0.0][:dimension], atol=1e-3)
    np.testing.assert_allclose(first.friction, 0.7)
    assert first.summary["reconstructed"]["spacing_from"] == "estimate"
    described = json.loads((tmp_path / "back" / "metadata.json").read_text())
    assert described["definition"] == "geoelements"
    assert described["reconstructed"]["from"] == "geoelements"
    assert described["vel_mean"][0] == pytest.approx(0.0025, rel=1e-3)


def test_the_spacing_and_the_angle_that_a_user_gives(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = foreign(tmp_path / "theirs", 2, material=None)
    assert "--friction-deg" in refused(capsys, source, "--from", "geoelements", "--out", tmp_path / "none")
    options = ("--friction-deg", 35, "--spacing", 0.01)
    assert exchange(source, "--from", "geoelements", "--out", tmp_path / "back", *options) == 0
    trajectory = Trajectory.load(tmp_path / "back" / "train" / "00000.npz")
    assert trajectory.scene.domain.cell == 0.02
    assert trajectory.scene.material.friction_deg == 35.0
    both = foreign(tmp_path / "both", 2)
    assert "no --friction-deg" in refused(capsys, both, "--from", "geoelements", "--out", tmp_path / "b", *options)


def test_z_up(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = foreign(tmp_path / "theirs", 3, dx=0.025)
    for up in "yz":
        assert exchange(source, "--from", "geoelements", "--out", tmp_path / up, "--up", up) == 0
    a, b = (Trajectory.load(tmp_path / up / "train" / "00000.npz") for up in "yz")
    np.testing.assert_array_equal(a.positions[..., [0, 2, 1]], b.positions)
    assert b.scene.baffles[0].size == tuple(a.scene.baffles[0].size[axis] for axis in (0, 2, 1))
    flat = foreign(tmp_path / "flat", 2)
    assert "3D" in refused(capsys, flat, "--from", "geoelements", "--out", tmp_path / "f", "--up", "z")


def test_names_that_are_no_file_names(tmp_path: Path) -> None:
    source = toy_dataset(tmp_path / "ours", 2)
    exchange(source, "--to", "geoelements", "--out", tmp_path / "theirs")
    (particles,) = geoelements.read(tmp_path / "theirs" / "test.npz", {"toy-0003"})
    data = np.empty(3, dtype=object)
    for place, part in enumerate((particles.positions, np.where(particles.stationary, 3, 6), particles.friction)):
        data[place] = part
    np.savez(tmp_path / "theirs" / "test.npz", **{"../../results/column": data, "b c": data})
    assert exchange(tmp_path / "theirs", "--from", "geoelements", "--out", tmp_path / "back") == 0
    assert sorted(path.name for path in (tmp_path / "back" / "test").iterdir()) == ["00000.npz", "00001.npz"]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"dim": 4}, "dim: expected 2 or 3"),
        ({"bounds": [[0.0, 1.0]]}, "bounds: expected a lower"),
        ({"dt": None}, "dt: expected"),
        ({"dt": 0.0}, "dt: expected a positive"),
        ({"periodic_boundary_conditions": [True, True, True]}, "expected walls"),
        ({"write_every": 0}, "write_every"),
    ],
)
def test_metadata_that_makes_no_scene(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: dict[str, Any], expected: str
) -> None:
    toy_dataset(tmp_path / "ours", 2)
    exchange(tmp_path / "ours", "--to", "lagrangebench", "--out", tmp_path / "theirs")
    place = tmp_path / "theirs" / "metadata.json"
    write_json(place, {**json.loads(place.read_text()), **change})
    line = refused(capsys, tmp_path / "theirs", "--from", "lagrangebench", "--out", tmp_path / "back")
    assert str(place) in line
    assert expected in line
    assert not (tmp_path / "back").exists()


def test_frames_of_a_solver_that_writes_every_so_often() -> None:
    described = ForeignMetadata(
        bounds=((0.0, 1.0),) * 2, dim=2, dt=0.0004, write_every=100, default_connectivity_radius=1
    )
    assert described.frame_dt == pytest.approx(0.04)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--out", "o"), "one of --to and --from"),
        (("--to", "geoelements", "--from", "geoelements", "--out", "o"), "one of --to and --from"),
        (("--to", "geoelements", "--spacing", "0.1", "--out", "o"), "with --from alone"),
        (("--from", "geoelements", "--spacing", "-1", "--out", "o"), "positive length"),
        (("--from", "geoelements", "--out", "o"), "metadata.json"),
        (("--to", "geoelements", "--out", "o"), "metadata.json"),
        (("--to", "deepmind", "--out", "o"), "deepmind"),
    ],
)
def test_mistakes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], expected: str
) -> None:
    assert expected in refused(capsys, tmp_path, *arguments)
    assert "there is none" in refused(capsys, tmp_path / "absent", "--to", "geoelements", "--out", "o")


def test_a_folder_without_trajectories(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_json(tmp_path / "metadata.json", peer_metadata(2))
    assert "expected trajectories" in refused(capsys, tmp_path, "--from", "geoelements", "--out", tmp_path / "o")
    assert "expected trajectories" in refused(capsys, tmp_path, "--to", "geoelements", "--out", tmp_path / "o")


def test_the_page_names_every_key(tmp_path: Path) -> None:
    page = PAGE.read_text(encoding="utf-8")
    toy_dataset(tmp_path / "ours", 2)
    for layout in LAYOUTS:
        section = page.split(f"\n## {layout}\n")[1].split("\n## ")[0]
        exchange(tmp_path / "ours", "--to", layout, "--out", tmp_path / layout)
        written = json.loads((tmp_path / layout / "metadata.json").read_text())
        assert written.keys() <= set(re.findall(r"`(\w+)`", section))
    for module in (geoelements, lagrangebench):
        section = page.split(f"\n## {module.__name__.split('.')[-1]}\n")[1].split("\n## ")[0]
        for kind in module.ParticleType:
            assert f"{int(kind)} ({kind.name.lower().replace('_', ' ')})" in section
    exchange(tmp_path / "geoelements", "--from", "geoelements", "--out", tmp_path / "back")
    summary = Trajectory.load(tmp_path / "back" / "train" / "toy-0000.npz").summary
    assert set(summary["reconstructed"]) <= set(re.findall(r"`(\w+)`", page))
    assert set(json.loads((tmp_path / "back" / "exchange.json").read_text())) <= set(re.findall(r"`(\w+)`", page))
    for flag in ("--to", "--from", "--out", "--friction-deg", "--spacing", "--up"):
        assert flag in page
    assert conversion.SAFE_NAME.fullmatch("toy-0000")
    assert toy_scene(2, 0).dimension == 2
