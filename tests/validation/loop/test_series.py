"""A series of deposits: each in its place, the runs of the MPM known to all, and wrong files named before any work."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datasets.files import write_json
from inverse.adaptation import PROBLEM, identity
from inverse.problem import Problem
from mpm import LAST
from tests.refusals import refused
from tests.validation.loop.flows import FakeMpm, wedge
from validation.loop.series import solve_series

TRUTHS = {"first": 17.0, "second": 29.0, "third": 44.0}


@pytest.fixture
def mpm() -> FakeMpm:
    return FakeMpm(scatter=0.002)


@pytest.fixture
def problem(tmp_path: Path) -> Problem:
    """The friction angle of a wedge by its front, without a surrogate."""
    return wedge(tmp_path).problem


@pytest.fixture
def targets(problem: Problem, mpm: FakeMpm, tmp_path: Path) -> Path:
    """A folder of deposits at known angles."""
    for number, (name, angle) in enumerate(TRUTHS.items()):
        mpm.run(problem.scene_at(np.array([angle]), 900 + number)).save(tmp_path / "deposits" / f"{name}.npz")
    mpm.scenes.clear()
    return tmp_path / "deposits"


@pytest.fixture
def adapted(problem: Problem, tmp_path: Path) -> Path:
    """A folder with the runs of an adaptation, 48 over the range of angles."""
    folder = tmp_path / "run"
    for number, angle in enumerate(np.linspace(12.2, 51.8, 48)):
        scene = replace(problem.scene_at(np.array([angle]), 2000 + number), frame_dt=0.02)
        FakeMpm(scatter=0.002)([scene], record=LAST)[0].save(folder / "data" / "deposits" / f"{number:04d}.npz")
    write_json(folder / PROBLEM, identity(problem))
    return folder


def test_deposits_share_runs(problem: Problem, targets: Path, adapted: Path, mpm: FakeMpm, tmp_path: Path) -> None:
    out = tmp_path / "series"
    rows = solve_series(problem, targets, out, model=adapted, simulate=mpm)
    assert [row["deposit"] for row in rows] == list(TRUTHS)
    for row, truth in zip(rows, TRUTHS.values(), strict=True):
        low, high = row["friction_deg from"], row["friction_deg to"]
        assert low < row["friction_deg"] < high
        assert abs(row["friction_deg"] - truth) < high - low < 6.0
        assert row["verdict"] == "confirmed"
    assert len(mpm.scenes) == sum(row["MPM runs"] for row in rows) <= 3 * len(rows)
    assert len({scene.seed for scene in mpm.scenes}) == len(mpm.scenes)
    with (out / "series.csv").open() as file:
        assert [row["deposit"] for row in csv.DictReader(file)] == list(TRUTHS)
    # What is there is not done again.
    mpm.scenes.clear()
    (out / "third" / "result.json").unlink()
    assert solve_series(problem, targets, out, model=adapted, simulate=mpm)[:2] == rows[:2]
    assert not mpm.scenes
    # What has changed is.
    mpm.run(problem.scene_at(np.array([40.0]), 950)).save(targets / "second.npz")
    first, second, _ = solve_series(problem, targets, out, model=adapted, simulate=mpm)
    assert (first, mpm.scenes != []) == (rows[0], True)
    assert second["friction_deg from"] < 40.0 < second["friction_deg to"]


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("fourth.npz", "none", "fourth.npz: expected a whole NPZ"),
        ("fourth.csv", "x,height\n0,1\n", "fourth.csv: expected a header with the columns `time`, `front`"),
        ("first.csv", "time,front\n0,1\n", "first.npz: expected a name of its own, it is that of first.csv"),
    ],
)
def test_a_wrong_file_is_named_before_any_work(
    name: str, text: str, expected: str, problem: Problem, targets: Path, mpm: FakeMpm, tmp_path: Path
) -> None:
    (targets / name).write_text(text)
    refused(solve_series, problem, targets, tmp_path / "series", simulate=mpm, said=expected)
    assert not mpm.scenes


def test_profiles_in_csv(targets: Path, mpm: FakeMpm, tmp_path: Path) -> None:
    problem = wedge(tmp_path, kind="profile", truth=24.0, noise=0.005).problem
    x = np.linspace(0.0, 1.2, 61)
    heights = 0.2 * np.maximum(1.0 - x / 0.6, 0.0)
    folder = tmp_path / "profiles"
    folder.mkdir()
    np.savetxt(folder / "bed.csv", np.stack([x, heights], axis=1), delimiter=",", header="x,height", comments="")
    (row,) = solve_series(problem, folder, tmp_path / "series", simulate=mpm)
    assert row["deposit"] == "bed"
    assert row["MPM runs"] > 3
    (folder / "short.csv").write_text("x,depth\n0,1\n1,0\n")
    refused(solve_series, problem, folder, tmp_path / "series", simulate=mpm, said="short.csv: expected")
