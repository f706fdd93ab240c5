"""Robust noise: the block of `test_outlier`, one front of eight off by ten deviations, beside the exact posterior."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datasets.scene.grid_field import Floats
from inverse.answer import Verdict
from inverse.observations import FrontSettings
from inverse.observations.errors import Student
from inverse.target import read_target
from tests.validation.loop.test_outlier import BOUNDS, FRICTION, NAMES, NOISE, SPEED, TIMES, moved, problem_of, slide
from validation.loop.solve import run
from validation.loop.task import Task

DOF = 4.0


def exact(values: Floats, unknowns: int) -> Floats:
    """The 2.5 %, 50 % and 97.5 % quantiles under Student's t, by a grid over the box, shape [3, U]."""
    shares = (np.arange(600) + 0.5) / 600
    speed, friction = (low + (high - low) * shares for low, high in BOUNDS.values())
    friction = friction if unknowns == 2 else np.array([FRICTION])
    off = (0.3 + moved(TIMES, speed[:, None, None], friction[:, None]) - values) / NOISE
    density = -0.5 * (DOF + 1.0) * np.log1p(off**2 / DOF).sum(axis=-1)
    weights = np.exp(density - density.max())
    both = [(weights.sum(axis=1), speed), (weights.sum(axis=0), friction)][:unknowns]
    return np.stack([np.interp((0.025, 0.5, 0.975), np.cumsum(own) / own.sum(), axis) for own, axis in both], axis=1)


@pytest.mark.parametrize("unknowns", [1, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.parametrize("off", [-0.05, 0.05])
def test_an_outlier_of_robust_noise_moves_nothing(tmp_path: Path, unknowns: int, off: float) -> None:
    truth = np.array([SPEED, FRICTION][:unknowns])
    values = 0.3 + moved(TIMES, np.array(SPEED), np.array(FRICTION)) + off * (TIMES == 0.30)
    problem = problem_of(tmp_path, values, NAMES[:unknowns])
    seen = replace(problem.observations[0], noise=Student(dof=DOF, deviation=NOISE))
    assert isinstance(seen, FrontSettings)
    problem = replace(problem, observations=(seen,))
    target = read_target(problem, lambda asked: slide([asked])[0])
    found = run(Task(problem=problem, target=target, folder=tmp_path / "mpm", simulate=slide))
    assert found.verdict is Verdict.CONFIRMED
    assert found.answers[0].holds(truth).all()
    shown, quantiles = (
        np.stack([found.answers[0].interval[0], found.answer, found.answers[0].interval[1]]),
        exact(values, unknowns),
    )
    off_exact = (shown - quantiles) / (quantiles[2] - quantiles[0])
    assert np.abs(off_exact).max() < 0.2
