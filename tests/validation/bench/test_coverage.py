"""`python -m validation.bench coverage`: twins are solved once, counted right, and uneven ranks are named."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.pool import pool
from tests.validation.loop.flows import FakeMpm, wedge
from validation.bench import coverage
from validation.bench.__main__ import main
from validation.bench.coverage import Family, Twin, drawn, held, ranks, row, solve_twin, uniformity

FAMILY = Family(title="Wedges", problem="wedge", noise=0.01)


@pytest.fixture
def mpm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FakeMpm:
    case = wedge(tmp_path, scatter=0.002)
    monkeypatch.setattr(coverage, "read_problem", lambda name: case.problem)
    monkeypatch.setattr(coverage, "simulate_many", lambda scenes, *, threads, **options: case.mpm(scenes, **options))
    return case.mpm


def test_truths_are_drawn_from_the_prior(mpm: FakeMpm) -> None:
    drawn_twins = [drawn(FAMILY, number) for number in range(200)]
    truths = [problem.target.truth["friction_deg"] for problem in drawn_twins]
    assert min(truths) < 14.0
    assert max(truths) > 50.0
    assert np.mean(truths) == pytest.approx(32.0, abs=2.5)
    assert drawn_twins[3].observations[0].noise == 0.01
    assert len({seed for problem in drawn_twins for seed in (problem.scene.seed, problem.target.seed)}) == 400


def test_where_a_twin_has_its_truth(mpm: FakeMpm) -> None:
    solved = solve_twin(FAMILY, 0)
    assert 0.0 <= solved.denser <= 1.0
    assert 0.0 <= solved.below["friction_deg"] <= 1.0
    assert solved.inside in (0, 1)
    made = len(mpm.scenes)
    assert made > 5
    again = solve_twin(FAMILY, 0)
    assert replace(again, seconds=solved.seconds) == solved
    assert len(mpm.scenes) == 2 * made


def twin(denser: float, below: float) -> Twin:
    values: dict[str, Any] = {"seed": 1, "inside": 1, "answers": 1, "verdict": "confirmed", "runs": 20, "seconds": 5.0}
    return Twin(denser=denser, below={"friction_deg": below}, **values)


def test_even_ranks_pass_and_uneven_ones_are_named() -> None:
    even = [twin((number + 0.5) / 40.0, (number + 0.5) / 40.0) for number in range(40)]
    narrow = [twin(0.7 + 0.3 * solved.denser, float(solved.below["friction_deg"] > 0.5)) for solved in even]
    assert held(even, 0.95) == pytest.approx(0.95)
    assert min(uniformity(even), ranks(even)) > 0.9
    assert max(uniformity(narrow), ranks(narrow)) < 1e-4
    assert "50% / 80% / 95%" in row(FAMILY, even).values()


def test_the_command(mpm: FakeMpm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(coverage, "pool", pool)
    arguments = ["coverage", "--out", str(tmp_path), "--keep", str(tmp_path / "keep"), "--only", "front"]
    assert main([*arguments, "--twins", "2"]) == 0
    assert len(list((tmp_path / "keep" / "front").glob("*.json"))) == 2
    made = len(mpm.scenes)
    assert main([*arguments, "--twins", "2"]) == 0
    assert len(mpm.scenes) == made
    for wrong in (["--only", "nothing"], ["--twins", "0"], ["--jobs", "0"]):
        assert main(["coverage", "--out", str(tmp_path), *wrong]) == 2
