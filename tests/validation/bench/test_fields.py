"""`python -m validation.bench fields`: a page from kept twins, whose sentences are those of their numbers."""

import json
from pathlib import Path
from typing import Any

import pytest

from inverse.fields.problem import read_problem
from validation.bench.__main__ import main
from validation.bench.fields.bench import FIRST, PROBLEMS, coarse, held, identified, picture

NAMES = {"slope-friction": ("friction_deg",), "slide-velocity": ("velocity_x", "velocity_y")}


def row(problem: str, name: str, draw: int | None, **changes: Any) -> dict[str, Any]:
    """A twin that is kept."""
    errors = {"prior": 4.0, "posterior": 3.0, "prior_identified": 5.0, "identified": 2.0}
    numbers = {
        "problem": problem,
        "draw": draw,
        "name": name,
        "unit": "deg",
        "values": 200,
        "identified": 50,
        "box": [[0.1, 0.3], [0.0, 0.2]],
        "error": errors,
        "deviation": {"prior": 5.0, "posterior": 4.0, "identified": 2.5},
        "covered": 0.9,
        "removed": [0.01, 0.8],
        "numbers": 63,
        "informative": 6,
        "distance": 0.7,
        "tolerance": 1.6,
        "verdict": "confirmed",
        "promised": 0.1,
        "seconds": 60.0,
        "processor_s": 80.0,
        "runs": 100,
        "reverses": 160,
        "combinations": 12,
        "seeds": 4,
    }
    return numbers | changes


def test_a_page_from_kept_twins(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for problem in PROBLEMS:
        for draw in (None, FIRST, FIRST + 1):
            rows = [row(problem, name, draw) for name in NAMES[problem]]
            (tmp_path / f"{problem}-{'own' if draw is None else draw}.json").write_text(json.dumps(rows))
    assert main(["fields", "--out", str(tmp_path), "--keep", str(tmp_path), "--draws", "2"]) == 0
    text = (tmp_path / "fields.md").read_text()
    assert capsys.readouterr().out.splitlines()[0] == text.splitlines()[2]
    assert "4 twins: 90 % of the true values" in text
    assert "in 4 of 4." in text
    assert "friction_deg is identified at 25 % of its values, there off by 2 deg (prior 5)" in text
    assert picture("slide-velocity", "velocity_y") in text
    assert "1600" in text


def test_the_share_within_the_bands_is_that_of_all_values() -> None:
    some = [row("slope-friction", "friction_deg", 1, covered=1.0, values=300)]
    others = [row("slope-friction", "friction_deg", 2, covered=0.6, values=100, verdict="unconfirmed")]
    (text,) = held(some + others)
    assert "2 twins: 90 %" in text
    assert "in 1 of 2." in text
    assert held([]) == []


def test_a_field_that_is_not_identified_is_said_to_be_so() -> None:
    errors = {"prior": 0.1, "posterior": 0.2, "prior_identified": None, "identified": None}
    text = identified(row("slide-velocity", "velocity_y", None, identified=0, box=None, error=errors))
    assert "not identified" in text
    worse = {"prior": 5.0, "posterior": 4.0, "prior_identified": 8.0, "identified": 1.0}
    # Of 200 squares 50 are identified.
    assert "elsewhere it is 4.58, above the 3.46 of" in identified(
        row("slope-friction", "friction_deg", None, error=worse)
    )


@pytest.mark.parametrize("name", PROBLEMS)
def test_the_coarse_problems_are_smaller(name: str) -> None:
    problem = read_problem(name)
    small = coarse(problem)
    assert small.scene.domain.cell > problem.scene.domain.cell
    assert small.scene.frames < problem.scene.frames
    assert small.search.seeds == 1
