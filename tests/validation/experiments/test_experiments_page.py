"""Errors in spreads, angles that are found, and a page whose words follow the numbers."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from datasets.errors import InputError
from validation.bench.experiments import bench
from validation.bench.experiments.angle import BOUNDS_DEG, CLOSE, AngleSearch, search_all
from validation.bench.experiments.bench import write
from validation.bench.experiments.computed import compute, extents_over_time
from validation.bench.experiments.scores import error, rms
from validation.experiments.experiment import Status, TimeSeries, read_experiments

from .conftest import deposits, front_of


def search_for(target: float, known: dict[float, float] | None = None) -> AngleSearch:
    """A search of 5 mm spread."""
    return AngleSearch(target=target, spread=0.005, known=dict(known or {}))


def extents(asked: Sequence[tuple[str, float]]) -> list[float]:
    """Fronts of a curved law: 1 / angle [deg] times 12.5 m."""
    return [12.5 / angle for _, angle in asked]


def test_scores_are_in_spreads(shelf: Path) -> None:
    (shipped,) = read_experiments(shelf)
    measured = shipped.experiment.cases[0].measured[0]
    assert error(0.53, measured) == pytest.approx(2.0)
    assert error(0.515, measured) == pytest.approx(-1.0)
    assert rms([3.0, -4.0]) == pytest.approx(math.sqrt(12.5))
    assert math.isnan(rms([]))


def test_forward_and_backward_of_a_formula(shelf: Path) -> None:
    findings = compute(read_experiments(shelf), deposits)
    (score,) = findings.scores
    assert score.angle.name == "avalanche"
    assert (score.coarse, score.fine) == pytest.approx((0.98 * 0.5, 0.5), abs=1e-6)
    assert score.error == pytest.approx(-4.0, abs=1e-3)
    assert not score.agrees
    (other,) = findings.others
    assert other.error == pytest.approx(6.0, abs=1e-3)
    (angle,) = findings.angles
    # 20 mm further than at 25 degrees: 2 degrees less; 5 mm of spread are half a degree.
    assert angle.fine.deg == pytest.approx(23.0, abs=0.06)
    assert angle.fine.half_width_deg == pytest.approx(0.5, rel=1e-3)
    assert angle.coarse.deg == pytest.approx(25.0 - (0.52 / 0.98 - 0.5) / 0.01, abs=0.06)
    assert angle.difference_deg == pytest.approx(-2.0, abs=0.06)
    assert not angle.agrees


@pytest.mark.parametrize("target", [0.35, 0.5, 0.6, 0.8])
def test_searches_end_at_the_target(target: float) -> None:
    for known in ({}, {25.0: 0.5}, {20.0: 0.625, 25.0: 0.5}):
        search = search_for(target, known)
        search_all({"one": search}, extents, 8)
        found = search.inferred()
        assert abs(found.miss) <= CLOSE
        assert found.deg == pytest.approx(12.5 / target, abs=0.1)
        # The slope of the law, from runs a few degrees apart.
        assert found.half_width_deg == pytest.approx(0.005 * found.deg**2 / 12.5, rel=0.45)


def test_a_target_that_no_angle_gives_is_reported() -> None:
    for target in (5.0, 0.01):
        search = search_for(target)
        search_all({"one": search}, extents, 20)
        assert search.exhausted
        assert math.isnan(search.inferred().deg)
        assert set(search.known) & set(BOUNDS_DEG)


def test_a_front_that_does_not_fall_gives_no_width() -> None:
    search = search_for(0.5, {20.0: 0.5, 25.0: 0.5})
    assert search.inferred().half_width_deg == math.inf


def test_the_page_follows_the_numbers(shelf: Path, tmp_path: Path) -> None:
    write(tmp_path / "page.md", compute(read_experiments(shelf), deposits), quick=False)
    text = (tmp_path / "page.md").read_text()
    assert "0 of 1 measured numbers are within 2 times their spread" in text
    assert "rms 4.0 spreads, at most -4.0 (wedge, wedge, front)" in text
    assert "**Fronts** come 3.8 % too short" in text
    assert "-2.0° from the measured one" in text
    assert "the avalanche angle leaves 4.0 spreads rms, the repose angle 6.0: the avalanche angle is the one" in text
    assert "- wedge, wedge, front, -4.0 spreads: The wedge is imaginary." in text
    assert "| everything   | nothing  | a test   |" in text


def test_the_page_follows_other_numbers(shelf: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = shelf / "wedge" / "experiment.toml"
    path.write_text(path.read_text().replace("value = 0.52", f"value = {front_of(25.0)}"))
    monkeypatch.setattr(bench, "deposits_of", lambda _, scenes: deposits(scenes))
    monkeypatch.setattr(bench, "QUICK_FACTOR", 1.0)
    conclusion = bench.bench(tmp_path, quick=True, keep=tmp_path, experiments=shelf)
    assert "1 of 1 measured numbers are within" in conclusion
    text = (tmp_path / "experiments.md").read_text()
    assert "Every number is within 2 spreads." in text
    assert "The wedge is imaginary" not in text
    assert "--quick" in text
    assert (tmp_path / "experiments.png").stat().st_size > 1000


def test_extents_over_time_begin_where_the_series_begins() -> None:
    series = TimeSeries(
        times=(0.0, 0.1, 0.3),
        values=(0.12, 0.2, 0.3),
        spreads=(0.01, 0.01, 0.01),
        spread_from="",
        status=Status.READ,
        source="",
    )
    # 0.1 m at first, 1 m/s, at 0.12 m after 0.02 s; at rest at 0.3 m; the last frame scatters back.
    time = np.array([0.0, 0.1, 0.2, 0.3, 0.4])
    assert extents_over_time(time, [0.1, 0.2, 0.3, 0.3, 0.29], series) == pytest.approx((0.12, 0.22, 0.3))


@pytest.mark.parametrize(
    ("times", "values"), [((0.0, 0.2, 0.1), (0.1, 0.2, 0.3)), ((0.1, 0.2), (0.1, 0.2)), ((0.0, 0.1), (0.1,))]
)
def test_a_wrong_series_is_refused(times: tuple[float, ...], values: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="times"):
        TimeSeries(
            times=times, values=values, spreads=(0.1,) * len(values), spread_from="", status=Status.READ, source=""
        )
