"""Robust noise: the block of `test_outlier`, one front of eight off by ten deviations, beside the exact posterior."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from inverse import Parameter, TargetSettings
from inverse.answer import Verdict
from inverse.observations import FrontSettings
from inverse.observations.errors import Student
from inverse.residuals import residuals
from inverse.saving import save
from inverse.target import read_target
from tests.refusals import refused
from tests.validation.loop.test_outlier import (
    BOUNDS,
    FRICTION,
    NAMES,
    NOISE,
    SPEED,
    TIMES,
    apart,
    grid,
    moved,
    problem_of,
    quantiles,
    slide,
    solved,
)

DOF = 4.0


@pytest.mark.parametrize("unknowns", [1, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.parametrize("off", [-0.05, 0.05])
def test_an_outlier_of_robust_noise_moves_nothing(tmp_path: Path, unknowns: int, off: float) -> None:
    truth = np.array([SPEED, FRICTION][:unknowns])
    values = 0.3 + moved(TIMES, np.array(SPEED), np.array(FRICTION)) + off * (TIMES == 0.30)
    problem = problem_of(tmp_path, values, NAMES[:unknowns])
    seen = replace(problem.observations[0], noise=Student(dof=DOF, deviation=NOISE))
    assert isinstance(seen, FrontSettings)
    problem = replace(problem, observations=(seen,))
    result = solved(problem, tmp_path)
    assert result.verdict is Verdict.CONFIRMED
    assert result.answers[0].holds(truth).all()
    axes, fronts = grid(unknowns)
    students = -0.5 * (DOF + 1.0) * np.log1p(((fronts - values) / NOISE) ** 2 / DOF).sum(axis=-1)
    assert apart(result, quantiles(axes, students)) < 0.2


def test_a_report_lists_every_number_names_outliers_and_says_which_data_matter(tmp_path: Path) -> None:
    """Fronts that tell the speed, and one that tells it ten times as badly: the first matter, it does not."""
    values = 0.3 + moved(TIMES, np.array(SPEED), np.array(FRICTION)) + 0.05 * (TIMES == 0.30)
    problem = problem_of(tmp_path, values, NAMES[:1])
    seen = replace(problem.observations[0], noise=Student(dof=DOF, deviation=NOISE))
    poor = FrontSettings(name="glance", times=(0.5,), values=(float(values[-2]),), noise=10.0 * NOISE)
    problem = replace(problem, observations=(seen, poor))
    result = solved(problem, tmp_path)
    save(result, tmp_path / "out")
    text = (tmp_path / "out" / "report.md").read_text()
    assert "front at time 0.3 s (+" in text
    assert text.count("| front  ") == 8 + 2  # of comparison and data that matter
    assert (tmp_path / "out" / "fit.png").stat().st_size > 10_000
    fronts, _ = residuals(result)
    assert fronts.standardised[4] == pytest.approx(10.0, rel=0.1)
    assert np.abs(np.delete(fronts.standardised, 4)).max() < 1.0
    assert np.all(fronts.lower < 0.3 + moved(TIMES, np.array(SPEED), np.array(FRICTION)))
    widths = {name: by_unknown[NAMES[0]] for name, by_unknown in result.without.items()}
    assert widths["glance"] == pytest.approx(widths["none"], rel=0.15)
    assert widths["front"] > 5.0 * widths["none"]
    # Of fronts that all move by the time t or more with the speed, the exact half-width of one number at 0.5 s.
    speeds = np.linspace(*BOUNDS[NAMES[0]], 4001)
    off = (0.3 + moved(np.array(0.5), speeds, np.array(FRICTION)) - values[-2]) / (10.0 * NOISE)
    ((low,), _, (high,)) = quantiles([speeds], -0.5 * off[:, None] ** 2)
    assert widths["front"] == pytest.approx(0.5 * (high - low), rel=0.2)


@pytest.mark.parametrize("late", [0.04, -0.035])
def test_a_clock_that_starts_late_is_an_unknown(tmp_path: Path, late: float) -> None:
    """Speed and clock of the block by its fronts over time, beside the exact posterior over both."""
    values = 0.3 + moved(np.maximum(TIMES + late, 0.0), np.array(SPEED), np.array(FRICTION))
    problem = problem_of(tmp_path, values, NAMES[:1])
    clock = Parameter(name="time_offset", initial=0.0, lower=-0.1, upper=0.1)
    problem = replace(problem, parameters=(*problem.parameters, clock))
    result = solved(problem, tmp_path)
    assert result.verdict is Verdict.CONFIRMED
    assert result.answers[0].holds(np.array([SPEED, late])).all()
    shares = (np.arange(600) + 0.5) / 600
    speed, offset = 0.5 + 1.7 * shares, -0.1 + 0.2 * shares
    times = np.maximum(TIMES + offset[:, None], 0.0)
    squares = (((0.3 + moved(times, speed[:, None, None], np.array(FRICTION)) - values) / NOISE) ** 2).sum(axis=-1)
    assert apart(result, quantiles((speed, offset), -0.5 * squares)) < 0.25


def test_a_twin_has_the_clock_of_its_truth_and_a_deposit_has_none(tmp_path: Path) -> None:
    problem = problem_of(tmp_path, TIMES, NAMES[:1])
    clock = Parameter(name="time_offset", initial=0.0, lower=-0.1, upper=0.1)
    twin = replace(
        problem,
        parameters=(*problem.parameters, clock),
        observations=(FrontSettings(times=tuple(TIMES)),),
        target=TargetSettings(twin=True, truth={"time_offset": 0.04}),
    )
    target = read_target(twin, lambda asked: slide([asked])[0])
    assert target.truth == {NAMES[0]: SPEED, "time_offset": 0.04}
    expected = 0.3 + moved(TIMES + 0.04, np.array(SPEED), np.array(FRICTION))
    np.testing.assert_allclose(target.values, expected, atol=1e-5)
    refused(lambda: replace(twin, observations=(FrontSettings(),)), said="an observation over time")
