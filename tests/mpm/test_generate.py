"""`python -m mpm.generate`: the same files whatever the jobs, resumable, and nothing of another dataset overwritten."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datasets import Mass, Scene, Trajectory
from datasets.definitions.definition import Definition, Split, Storage
from datasets.errors import WorkFailed
from mpm.generate import command, generate, thinned, trajectory_path
from tests.breaking import dataset_files
from tests.pool import pool
from tests.refusals import refused, refused_by
from tests.scenes import box


def draw(stream: np.random.Generator, index: int) -> Scene:
    """A small falling block on a coarse grid, for four frames."""
    x, y = stream.uniform(0.2, 0.6, 2).tolist()
    block = Mass(lower=(x, y), size=(0.2, 0.2), velocity=(1.0, 0.0))
    return box(block, cell=0.05, duration=0.01, frame_dt=0.0025, seed=index)


SPLITS = Split.TRAIN, Split.VALID, Split.TEST, Split.TRAIN
TINY = Definition(name="tiny", size=4, split=lambda index: SPLITS[index], draw=draw)

FILES = ["test/tiny-0002.npz", "train/tiny-0000.npz", "train/tiny-0003.npz", "valid/tiny-0001.npz"]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The whole tiny dataset, made by this process."""
    out = tmp_path_factory.mktemp("dataset")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mpm.generate.pool", pool)
        generate(TINY, out, seed=7, count=None, jobs=1)
    return out


def test_what_is_left_behind(dataset: Path) -> None:
    assert sorted(dataset_files(dataset)) == sorted(["metadata.json", *FILES])
    for entry in TINY.entries(seed=7):
        trajectory = Trajectory.load(trajectory_path(entry, dataset))
        assert trajectory.scene == entry.scene
        assert trajectory.positions.shape == (5, 64, 2)
        assert not {"wall_s", "compile_s"} & trajectory.summary.keys()
    metadata = json.loads((dataset / "metadata.json").read_text())
    assert metadata["splits"] == {"train": 2, "valid": 1, "test": 1}
    assert metadata["sequence_length"] == 5
    # Thrown at 1 m/s along x: 2.5 mm a frame.
    assert metadata["vel_mean"][0] == pytest.approx(0.0025, rel=0.05)


def test_two_jobs_give_the_same_bytes_as_this_process(dataset: Path, tmp_path: Path) -> None:
    generate(TINY, tmp_path, seed=7, count=None, jobs=2)
    assert dataset_files(tmp_path) == dataset_files(dataset)


STORAGE = Storage(cell=0.05, kept=1)


@pytest.mark.slow
def test_what_is_stored_of_finer_truth_is_the_same_for_any_jobs(dataset: Path, tmp_path: Path) -> None:
    definition = replace(TINY, storage=STORAGE)
    for jobs in (1, 2):
        generate(definition, tmp_path / str(jobs), seed=7, count=None, jobs=jobs)
    assert dataset_files(tmp_path / "1") == dataset_files(tmp_path / "2")
    for entry in definition.entries(seed=7):
        stored, whole = (Trajectory.load(trajectory_path(entry, folder)) for folder in (tmp_path / "1", dataset))
        expected = thinned(whole, STORAGE)
        assert 0 < stored.positions.shape[1] < 64
        for key in ("positions", "velocity0", "friction", "volume", "mass"):
            np.testing.assert_array_equal(getattr(stored, key), getattr(expected, key))


def test_a_scheduler_that_does_not_answer_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("mpm.cluster.CONNECT", 0.5)
    nowhere = {"seed": 7, "count": None, "jobs": 1, "scheduler": "tcp://127.0.0.1:1"}
    refused(generate, TINY, tmp_path, **nowhere, said="expected the address of a Dask scheduler")


@pytest.fixture
def at_once(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulations that take no time: copies of the trajectories of the whole dataset."""
    files = {entry.scene: trajectory_path(entry, dataset) for entry in TINY.entries(seed=7)}

    def copied(scene: Scene, path: Path, storage: Storage | None) -> None:
        Trajectory.load(files[scene]).save(path)

    monkeypatch.setattr("mpm.generate.pool", pool)
    monkeypatch.setattr("mpm.generate.simulate_one", copied)


@pytest.mark.usefixtures("at_once")
def test_a_broken_run_is_finished_and_what_stands_is_kept(dataset: Path, tmp_path: Path) -> None:
    shutil.copytree(dataset / "train", tmp_path / "train")
    # What a killed process leaves of a file it was writing.
    (tmp_path / "train" / ".part-tiny-0000-x.npz").write_bytes(b"half")
    before = (tmp_path / FILES[1]).stat().st_mtime_ns
    generate(TINY, tmp_path, seed=7, count=None, jobs=1)
    assert dataset_files(tmp_path) == dataset_files(dataset)
    assert (tmp_path / FILES[1]).stat().st_mtime_ns == before


def test_another_dataset_in_the_folder_is_refused(dataset: Path) -> None:
    """Another seed, and fewer than there are."""
    before = dataset_files(dataset)
    for seed, count, named in ((8, None, "train/tiny-0000.npz"), (7, 2, "train/tiny-0003.npz")):
        assert refused(generate, TINY, dataset, seed=seed, count=count, jobs=1).where == str(dataset / named)
    assert dataset_files(dataset) == before


@pytest.mark.usefixtures("at_once")
def test_a_failing_scene_is_named_and_does_not_stop_the_others(dataset: Path, tmp_path: Path) -> None:
    # A file where a folder belongs: the second scene cannot be saved.
    (tmp_path / "valid").write_text("")
    with pytest.raises(WorkFailed, match=r"1 of 4 trajectories failed, first tiny-0001 \(InputError: "):
        generate(TINY, tmp_path, seed=7, count=None, jobs=1)
    for name in FILES[:3]:
        assert (tmp_path / name).read_bytes() == (dataset / name).read_bytes()
    assert not (tmp_path / "metadata.json").exists()


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["flow3d"], "one of flow2d, columns2d, obstacle3d, baffles3d, terrain3d, cohesive3d, paper2d, paper3d"),
        (["absent.toml"], "absent.toml: expected a TOML file"),
        (["flow2d", "--jobs", "2", "--scheduler", "tcp://localhost:1"], "expected none with --scheduler"),
        (["paper3d", "--count", "1001"], "1 to 1000"),
        (["flow2d", "--seed", "-1"], "seed"),
        (["flow2d", "--jobs", "0"], "at least 1 job"),
        (["flow2d", "--jobs", "1000000000000"], "at most 1000 jobs"),
        (["flow2d", "--cuont", "3"], "--count"),
    ],
)
def test_wrong_input_is_one_line_and_status_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], line: str
) -> None:
    assert line in refused_by(capsys, command, *arguments, "--out", tmp_path)
    assert list(tmp_path.iterdir()) == []
