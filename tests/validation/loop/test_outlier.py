"""A block that slides by its exact solution, one front misread: wider by Birge's ratio, the outlier named."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datasets.measures import front
from datasets.scene import Mass, Scene
from datasets.trajectory import Trajectory
from inverse.found import Verdict
from inverse.parameters import Parameter
from inverse.problem import Problem
from inverse.settings import ObservationSettings, TargetSettings
from inverse.target import read_target
from mpm import ALL, Recording
from tests.flows import flow_of
from tests.scenes import scene_of
from validation.loop.solve import run
from validation.loop.task import Task

TIMES = np.array([0.06, 0.12, 0.18, 0.24, 0.30, 0.40, 0.60, 1.00])
NOISE, FRICTION, SPEED = 0.005, 0.4, 1.5
NAME = "masses[0].velocity_x"


def moved(time: np.ndarray, speed: float) -> np.ndarray:
    """Distance [m] at times [s]."""
    sliding = np.minimum(time, speed / (FRICTION * 9.81))
    return speed * sliding - 0.5 * FRICTION * 9.81 * sliding**2


def slide(scenes: Sequence[Scene], /, *, record: Recording = ALL) -> list[Trajectory]:
    block = np.stack([np.linspace(0.1, 0.3, 400), np.full(400, 0.05)], axis=1)
    block[:, 0] += 0.3 - front(block)
    time, flows = np.linspace(0.0, 1.2, 61), []
    for scene in scenes:
        assert scene.masses[0].velocity is not None
        positions = [block + np.array([x, 0.0]) for x in moved(time, scene.masses[0].velocity[0])]
        flows.append(flow_of(scene, positions, time=time, summary={}))
    return flows


@pytest.mark.parametrize("off", [0.03, 0.06, 0.15])
def test_an_outlier_widens_the_interval_by_birge_s_ratio_and_is_named(tmp_path: Path, off: float) -> None:
    body = Mass(lower=(0.1, 0.0), size=(0.2, 0.1), velocity=(SPEED, 0.0))
    scene = replace(scene_of(body, size=(2.0, 0.2), cell=0.02), duration=1.2, frame_dt=0.02, floor_friction=FRICTION)
    values = 0.3 + moved(TIMES, SPEED) + off * (TIMES == 0.30)
    seen = ObservationSettings(kind="front", times=tuple(TIMES), values=tuple(values.tolist()), noise=NOISE)
    problem = Problem(
        name="block",
        folder=tmp_path,
        scene=scene,
        parameters=(Parameter(name=NAME, initial=1.0, lower=0.5, upper=2.2),),
        observations=(seen,),
        target=TargetSettings(),
    )
    target = read_target(problem, lambda asked: slide([asked])[0])
    found = run(Task(problem=problem, target=target, folder=tmp_path / "mpm", simulate=slide))
    fit, speeds = found.answers[0].fit, np.linspace(0.5, 2.2, 20001)
    squares = np.array([np.sum((0.3 + moved(TIMES, each) - values) ** 2) for each in speeds]) / NOISE**2
    birge = np.sqrt(squares.min() / (len(TIMES) - 1))
    weights = np.exp(-0.5 * (squares - squares.min()) / birge**2)
    low, middle, high = np.interp((0.025, 0.5, 0.975), np.cumsum(weights) / weights.sum(), speeds)
    assert fit is not None
    assert found.verdict is Verdict.UNCONFIRMED
    assert fit.factor == pytest.approx(birge, rel=0.1)
    assert found.certainty[NAME] == pytest.approx(0.5 * (high - low), rel=0.2)
    assert found.unknowns[NAME] == pytest.approx(middle, abs=0.2 * (high - low))
    assert found.interval[NAME][0] < SPEED < found.interval[NAME][1]
    assert list(fit.outliers) == [4]
