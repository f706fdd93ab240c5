"""The loop and the coverage by workers of a Dask scheduler: the same results as here."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from datasets.command_line import run
from tests.breaking import PROBLEM, SCENE, answer
from validation.loop.__main__ import main

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """Address of a scheduler with two workers on this machine."""
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster:
        yield cluster.scheduler_address


def test_the_loop_finds_the_same(scheduler: str, tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(SCENE)
    (tmp_path / "problem.toml").write_text(PROBLEM)
    problem = str(tmp_path / "problem.toml")
    for name, flags in (("here", []), ("there", ["--scheduler", scheduler])):
        assert run(main, "loop", [problem, "--out", str(tmp_path / name), *flags]) in (0, 1)
    assert answer(tmp_path / "there") == answer(tmp_path / "here")
    assert json.loads((tmp_path / "there" / "result.json").read_text())["mpm_runs"]
