"""A block that slides by its exact solution, one front misread: wider by Birge's ratio; robust noise leaves it out."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from datasets import Mass, Scene, Trajectory
from datasets.flow.measures import front
from datasets.scene.grid_field import Floats
from inverse import Parameter, Problem, Result, TargetSettings
from inverse.answer import Verdict
from inverse.forward import Simulate
from inverse.observations import FrontSettings, PassedSettings
from inverse.observations.errors import Student
from inverse.report import summary
from inverse.residuals import other_units, outlying, residuals
from inverse.saving import save
from inverse.target import read_target
from mpm import ALL, Recording
from tests.refusals import refused
from tests.scenes import flow_of, scene_of
from validation.loop.solve import run
from validation.loop.task import Task

TIMES = np.array([0.06, 0.12, 0.18, 0.24, 0.30, 0.40, 0.60, 1.00])
NOISE, FRICTION, SPEED = 0.005, 0.4, 1.5
DOF = 4.0  # of Student's noise
NAMES = ("masses[0].velocity_x", "floor_friction")
BOUNDS = {NAMES[0]: (0.5, 2.2), NAMES[1]: (0.2, 0.7)}


def moved(time: Floats, speed: Floats, friction: Floats) -> Floats:
    """Distance [m] at times [s]: v0 t - mu g t^2 / 2 until it stops."""
    sliding = np.minimum(time, speed / (friction * 9.81))
    return np.asarray(speed * sliding - 0.5 * friction * 9.81 * sliding**2)


LATE = 0.3 + moved(np.maximum(TIMES - 0.035, 0.0), np.array(SPEED), np.array(FRICTION))
RIGHT = 0.3 + moved(TIMES, np.array(SPEED), np.array(FRICTION))


def slide(scenes: Sequence[Scene], /, *, record: Recording = ALL, cells: float = 0.0) -> list[Trajectory]:
    """The block of each scene; cells: by how many its cells hold it back in the end."""
    block = np.stack([np.linspace(0.1, 0.3, 400), np.full(400, 0.05)], axis=1)
    block[:, 0] += 0.3 - front(block)
    time, flows = np.linspace(0.0, 1.2, 61), []
    for scene in scenes:
        speed, friction = np.array(scene.masses[0].velocity[0]), np.array(scene.floor_friction)
        shift = moved(time, speed, friction) - cells * scene.domain.cell * (1.0 - np.exp(-time / 0.2))
        positions = [block + np.array([x, 0.0]) for x in shift]
        flows.append(flow_of(scene, positions, time=time, summary={}))
    return flows


def problem_of(folder: Path, values: Floats, names: Sequence[str], noise: float = NOISE) -> Problem:
    body = Mass(lower=(0.1, 0.0), size=(0.2, 0.1), velocity=(SPEED, 0.0))
    scene = replace(scene_of(body, size=(2.0, 0.2), cell=0.02), duration=1.2, frame_dt=0.02, floor_friction=FRICTION)
    seen = FrontSettings(times=tuple(TIMES), values=tuple(values.tolist()), noise=noise)
    bounds = {name: dict(zip(("lower", "upper"), BOUNDS[name], strict=True)) for name in names}
    return Problem(
        name="block",
        folder=folder,
        scene=scene,
        parameters=tuple(Parameter(name=name, initial=sum(BOUNDS[name]) / 2.0, **bounds[name]) for name in names),
        observations=(seen,),
        target=TargetSettings(),
    )


def solved(problem: Problem, folder: Path, mpm: Simulate = slide) -> Result:
    """What the loop finds."""
    target = read_target(problem, lambda scene: mpm([scene])[0])
    return run(Task(problem=problem, target=target, folder=folder / "mpm", simulate=mpm))


def grid(unknowns: int) -> tuple[list[Floats], Floats]:
    """Speeds and, of two unknowns, frictions over the box; fronts there [m], shape [., ., M]."""
    shares = (np.arange(600) + 0.5) / 600
    axes = [low + (high - low) * shares for low, high in BOUNDS.values()][:unknowns]
    speed, friction = axes if unknowns == 2 else (axes[0], np.array([FRICTION]))
    return axes, 0.3 + moved(TIMES, speed[:, None, None], friction[:, None])


def quantiles(axes: Sequence[Floats], log_density: Floats) -> Floats:
    """The 2.5 %, 50 % and 97.5 % quantiles of each unknown by a density over a grid, shape [3, U]."""
    weights, columns = np.exp(log_density - log_density.max()), []
    for marginal, axis in zip((weights.sum(axis=1), weights.sum(axis=0)), axes, strict=False):
        columns.append(np.interp((0.025, 0.5, 0.975), np.cumsum(marginal) / marginal.sum(), axis))
    return np.stack(columns, axis=1)


def apart(result: Result, exact: Floats) -> float:
    """The largest error of an end of an interval or a median, over the width of the exact interval."""
    low, high = result.answers[0].interval
    return float(np.abs((np.stack([low, result.answer, high]) - exact) / (exact[2] - exact[0])).max())


SLOW = [pytest.param(*each, marks=pytest.mark.slow) for each in ((0.03, 1), (0.05, 2), (0.15, 2))]


@pytest.mark.parametrize(("off", "unknowns"), [*SLOW, (0.15, 1)])
def test_an_outlier_widens_the_interval_by_birge_s_ratio(tmp_path: Path, off: float, unknowns: int) -> None:
    """With two unknowns and + 150 mm the least squares are at (1.705, 0.481), the median at (1.729, 0.500)."""
    values = RIGHT + off * (TIMES == 0.30)
    result = solved(problem_of(tmp_path, values, NAMES[:unknowns]), tmp_path)
    fit, (axes, fronts) = result.answers[0].fit, grid(unknowns)
    squares = ((fronts - values) ** 2).sum(axis=-1) / NOISE**2
    birge = np.sqrt(squares.min() / (len(TIMES) - unknowns))
    assert result.verdict is Verdict.UNCONFIRMED
    assert fit.applied == pytest.approx(birge, rel=0.05)
    assert apart(result, quantiles(axes, -0.5 * squares / birge**2)) < 0.07
    assert result.answers[0].holds(np.array([SPEED, FRICTION][:unknowns])).all()
    assert list(fit.outliers) == [4]
    assert fit.outliers[4] > 4.0  # observed beyond what the others predict
    assert "front at time 0.3 s (+" in summary(result)
    assert not outlying(residuals(result), 1).startswith("No number")


def test_what_is_shown_at_the_answer_is_a_flow_there(tmp_path: Path) -> None:
    """Not the mean of the checks, which lie a little beside it."""
    result = solved(problem_of(tmp_path, RIGHT + 0.15 * (TIMES == 0.30), NAMES[:1]), tmp_path)
    there = 0.3 + moved(TIMES, result.answer[0], np.array(FRICTION))
    np.testing.assert_allclose(result.predicted, there, atol=0.01 * NOISE)
    off = replace(result.answers[0], parameters=result.answer + 2.0 * result.answers[0].half_widths)
    far = replace(result, answers=(off,))
    assert result.answers[0].near
    assert "masses[0].velocity_x" in far.remarks[0]


def test_an_observation_in_another_unit_is_asked_for(tmp_path: Path) -> None:
    result = solved(problem_of(tmp_path, RIGHT, NAMES[:1]), tmp_path)
    assert other_units(result) == []
    kilometres = replace(result, target=replace(result.target, values=1e-3 * result.target.values))
    assert other_units(kilometres) == ["check the unit of front: it is 0.001 times that of the MPM runs"]
    scene = result.problem.scene
    zero = replace(result, target=replace(result.target, values=0.0 * result.target.values))
    runs = [replace(run, numbers=0.0 * run.numbers) for run in result.mpm_runs]
    share = replace(kilometres, target=replace(kilometres.target, observation=PassedSettings(line=0.4).operator(scene)))
    for other in (zero, replace(result, mpm_runs=runs), share):
        assert other_units(other) == []


def test_of_two_numbers_that_contradict_each_other_none_is_named(tmp_path: Path) -> None:
    ends = tuple(FrontSettings(name=name, value=end, noise=NOISE) for name, end in (("a", RIGHT[-1]), ("b", 0.6857)))
    problem = replace(problem_of(tmp_path, RIGHT, NAMES[:1]), observations=ends)
    result = solved(problem, tmp_path, partial(slide, cells=0.5))
    answer = result.answers[0]
    assert answer.fit.outliers == {}
    assert answer.fit.applied > 5.0
    assert result.without["none"][NAMES[0]] == pytest.approx(0.5 * float(np.diff(answer.interval[:, 0])[0]), rel=0.1)
    assert outlying(residuals(result)).startswith("No number is off")


def test_what_no_run_changes_says_nothing(tmp_path: Path) -> None:
    """No block gets as far as the line: alone that leaves the prior, beside a front it takes nothing away."""
    problem = problem_of(tmp_path, RIGHT, NAMES[:1])
    beyond = PassedSettings(value=0.0, line=1.8, noise=0.01)
    front = FrontSettings(value=RIGHT[-1], noise=NOISE)
    both = solved(replace(problem, observations=(front, beyond)), tmp_path / "both")
    assert both.verdict is Verdict.CONFIRMED
    assert both.answer[0] == pytest.approx(SPEED, abs=0.02)
    alone = solved(replace(problem, observations=(beyond,)), tmp_path / "alone")
    assert np.sqrt(alone.posterior.samples.covariance[0, 0]) == pytest.approx(12.0**-0.5, rel=0.05)
    assert both.without["front"][NAMES[0]] > 0.9 * 0.475 * (BOUNDS[NAMES[0]][1] - BOUNDS[NAMES[0]][0])


@pytest.mark.parametrize(
    ("times", "known"), [(TIMES[::-1], False), ((*TIMES[:-1][::-1], 1.19), True), ((0.06,), False)]
)
def test_the_front_of_the_deposit_is_that_of_the_end(tmp_path: Path, times: Sequence[float], known: bool) -> None:
    values = 0.3 + moved(np.array(times), np.array(SPEED), np.array(FRICTION))
    seen = FrontSettings(times=tuple(times), values=tuple(values.tolist()), noise=NOISE)
    problem = replace(problem_of(tmp_path, RIGHT, NAMES[:1]), observations=(seen,))
    for asked in (problem, replace(problem, observations=(seen, PassedSettings(value=0.0, line=1.8, noise=0.01)))):
        front_of_deposit = read_target(asked, lambda scene: slide([scene])[0]).front
        assert front_of_deposit == pytest.approx(values.max()) if known else np.isnan(front_of_deposit)


@pytest.mark.parametrize(("values", "fits"), [(RIGHT, True), (LATE, False)])
def test_errors_of_the_cells_hide_no_late_clock(tmp_path: Path, values: Floats, fits: bool) -> None:
    """Cells err by more than four times the noise, but smoothly: a clock 35 ms late is a misfit all the same."""
    result = solved(problem_of(tmp_path, values, NAMES[:1]), tmp_path, partial(slide, cells=1.5))
    fit = result.answers[0].fit
    assert fit.cells > 4.0 * fit.noise
    assert list(fit.outliers) == []
    assert fit.inside
    assert (fit.probability > 0.5) is fits
    assert (fit.applied == 1.0) is fits
    assert result.answers[0].holds(np.array([SPEED])).all()
    # The cell at which their errors are equal: the cells' falls with the cell, the work of a run as its cube in 2D.
    share = fit.cells / fit.noise
    assert f"on cells of {0.02 / share:.2g} m ({share**3:.2g} times the work" in summary(result)


@pytest.mark.parametrize(
    ("unknowns", "off"), [(1, -0.05), *(pytest.param(2, off, marks=pytest.mark.slow) for off in (-0.05, 0.05))]
)
def test_an_outlier_of_robust_noise_moves_nothing(tmp_path: Path, unknowns: int, off: float) -> None:
    truth, values = np.array([SPEED, FRICTION][:unknowns]), RIGHT + off * (TIMES == 0.30)
    problem = problem_of(tmp_path, values, NAMES[:unknowns])
    seen = replace(problem.observations[0], noise=Student(dof=DOF, deviation=NOISE))
    problem = replace(problem, observations=(seen,))
    result = solved(problem, tmp_path)
    assert result.verdict is Verdict.CONFIRMED
    assert result.answers[0].holds(truth).all()
    axes, fronts = grid(unknowns)
    students = -0.5 * (DOF + 1.0) * np.log1p(((fronts - values) / NOISE) ** 2 / DOF).sum(axis=-1)
    assert apart(result, quantiles(axes, students)) < 0.2


def test_a_report_lists_every_number_names_outliers_and_says_which_data_matter(tmp_path: Path) -> None:
    """Fronts that tell the speed, and one that tells it ten times as badly: the first matter, it does not."""
    values = RIGHT + 0.05 * (TIMES == 0.30)
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
    assert np.all(fronts.lower < RIGHT)
    widths = {name: by_unknown[NAMES[0]] for name, by_unknown in result.without.items()}
    assert widths["glance"] == pytest.approx(widths["none"], rel=0.15)
    assert widths["front"] > 5.0 * widths["none"]
    # Of fronts that all move by the time t or more with the speed, the exact half-width of one number at 0.5 s.
    speeds = np.linspace(*BOUNDS[NAMES[0]], 4001)
    off = (0.3 + moved(np.array(0.5), speeds, np.array(FRICTION)) - values[-2]) / (10.0 * NOISE)
    ((low,), _, (high,)) = quantiles([speeds], -0.5 * off[:, None] ** 2)
    assert widths["front"] == pytest.approx(0.5 * (high - low), rel=0.2)


def test_a_clock_that_starts_late_is_an_unknown(tmp_path: Path) -> None:
    """Speed and clock of the block by its fronts over time, beside the exact posterior over both."""
    problem = problem_of(tmp_path, LATE, NAMES[:1])
    clock = Parameter(name="time_offset", initial=0.0, lower=-0.1, upper=0.1)
    problem = replace(problem, parameters=(*problem.parameters, clock))
    result = solved(problem, tmp_path)
    assert result.verdict is Verdict.CONFIRMED
    assert result.answers[0].holds(np.array([SPEED, -0.035])).all()
    shares = (np.arange(600) + 0.5) / 600
    speed, offset = 0.5 + 1.7 * shares, -0.1 + 0.2 * shares
    times = np.maximum(TIMES + offset[:, None], 0.0)
    squares = (((0.3 + moved(times, speed[:, None, None], np.array(FRICTION)) - LATE) / NOISE) ** 2).sum(axis=-1)
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
