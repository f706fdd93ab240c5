"""Errors in spreads, angles from fronts, and a page whose words follow the numbers."""

import math
from pathlib import Path

import pytest

from validation.bench.experiments import compute, crossing, page
from validation.experiments.experiment import read_experiments

from .conftest import deposits


def test_forward_and_backward_of_a_formula(shelf: Path) -> None:
    findings = compute(read_experiments(shelf), deposits)
    (score,) = findings.scores
    assert score.angle.name == "avalanche"
    assert (score.coarse, score.fine) == pytest.approx((0.98 * 0.5, 0.5), abs=1e-6)
    assert score.error == pytest.approx(-4.0, abs=1e-3)
    assert not score.agrees
    (other,) = findings.others
    assert other.error == pytest.approx((0.98 * 0.55 - 0.52) / 0.005, abs=1e-3)
    (found,) = findings.inferred
    # 20 mm further than at 25 degrees: 2 degrees less, by the slope of the coarse cells; 5 mm are half a degree.
    assert found.deg == pytest.approx(25.0 - 0.02 / 0.0098, abs=1e-3)
    assert found.half_width_deg == pytest.approx(0.005 / 0.0098, rel=1e-3)
    assert found.coarse_deg == pytest.approx(25.0 - (0.52 / 0.98 - 0.5) / 0.01, abs=1e-3)
    assert found.difference_deg == pytest.approx(-2.04, abs=0.01)
    assert not found.agrees


@pytest.mark.parametrize("target", [0.36, 0.45, 0.6])
def test_the_angle_of_a_front_lies_between_runs(target: float) -> None:
    fronts = {angle: 12.5 / angle for angle in (20.0, 24.0, 28.0, 32.0, 36.0)}
    angle, slope = crossing(fronts, target)
    assert angle == pytest.approx(12.5 / target, abs=0.3)
    assert slope == pytest.approx(-(target**2) / 12.5, rel=0.2)


def test_a_front_that_no_angle_gives_has_a_slope_alone() -> None:
    fronts = {20.0: 0.6, 28.0: 0.5, 36.0: 0.45}
    assert math.isnan(crossing(fronts, 0.7)[0])
    assert crossing(fronts, 0.7)[1] == pytest.approx(-0.0125)
    assert crossing(fronts, 0.3)[1] == pytest.approx(-0.00625)
    # Runs close to each other: the slope is that of the whole.
    assert crossing({20.0: 0.6, 20.5: 0.599, 28.0: 0.5}, 0.5995)[1] == pytest.approx(-0.0125)


def test_the_page_follows_the_numbers(shelf: Path) -> None:
    text = page(compute(read_experiments(shelf), deposits))
    assert "0 of 1 lengths are within 2 times their spread; rms 4.0 spreads, at most -4.0 (wedge" in text.conclusion
    assert "Fronts come 3.8 % too short" in text.conclusion
    assert "-2.0° from the measured one" in text.conclusion
    assert "the avalanche angle leaves 6.0 spreads rms, the repose angle 3.8, on" in text.conclusion
    assert "- wedge, wedge, front: The wedge is imaginary." in str(text)
    assert "- Not stated: everything; nothing: a test." in str(text)
