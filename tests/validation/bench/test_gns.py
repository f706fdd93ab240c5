"""`python -m validation.bench gns`: errors of known deposits, a page whose words are its numbers."""

import math
from dataclasses import replace

import numpy as np
import pytest

from datasets import Mass, Scene, Trajectory
from datasets.flow.measures import Deposit, Errors
from datasets.scene.particles import initial_particles, released_volume
from tests.scenes import flow_of, scene_of
from validation.bench.accuracy.bench import deposit_of
from validation.bench.gns import AGAIN, MOUNDS, Compared, ModelErrors, conclusion, creep, kind_rows, mound

BLOCK = scene_of(Mass(lower=(0.1, 0.0), size=(0.2, 0.2)), size=(1.0, 0.4), duration=1.0, frame_dt=0.1)


def stretched(scene: Scene, by: float) -> Trajectory:
    """A block whose particles move away from its rear, evenly over the time, until it is `by` times as long."""
    particles = initial_particles(scene)
    time = np.arange(scene.frames) * scene.frame_dt
    factor = 1.0 + (by - 1.0) * time / time[-1]
    positions = np.repeat(particles.positions[None], len(time), axis=0)
    positions[..., 0] = 0.1 + factor[:, None] * (positions[..., 0] - 0.1)
    return flow_of(scene, positions, summary={"wall_s": 1.0})


def errors_beside(truth: Deposit, by: float) -> Errors:
    flow = stretched(BLOCK, by)
    return truth.errors(flow.positions[-1], flow.volumes)


def test_errors_of_deposits_of_known_length() -> None:
    truth = deposit_of(stretched(BLOCK, 2.0))
    assert truth.side == 1
    assert truth.extent == pytest.approx(0.4, rel=0.03)
    errors = errors_beside(truth, 2.5)
    assert errors.front == pytest.approx(0.25, rel=0.02)
    # Equal shares at q of the block lie 0.1 q apart: rms 0.1 / sqrt(3) of an extent of 0.4.
    assert errors.profile == pytest.approx(0.25 / math.sqrt(3.0), rel=0.03)
    assert (errors.height, errors.overlap) == pytest.approx((0.0, 0.8), abs=0.03)
    assert errors_beside(truth, 2.0) == Errors(front=0.0, profile=0.0, height=0.0, thickness=0.0, overlap=1.0)
    assert not truth.at_wall
    assert deposit_of(stretched(BLOCK, 4.5)).at_wall


def test_a_mound_that_creeps_is_measured_from_its_start_on() -> None:
    assert creep(stretched(BLOCK, 2.0)) == pytest.approx(200.0, rel=0.03)
    for friction_deg, slope_deg in MOUNDS:
        assert math.degrees(math.atan(0.5)) + slope_deg < friction_deg
        assert released_volume(mound(friction_deg, slope_deg, 0)) == pytest.approx(0.08)
    speeds = {(45.0, 12.0): {"MPM": -0.1, "tiny": 90.0}, (35.0, 0.0): {"MPM": 0.05, "tiny": -0.2}}
    assert "by 0.2 to 90 mm/s; with the MPM by at most 0.1 mm/s" in conclusion([model()], speeds)[-1]


def model() -> ModelErrors:
    """Two scenes of one model, the second at the wall, beside an MPM on three grids."""

    def off(front: float) -> Errors:
        return Errors(front=front, profile=0.01, height=-0.2, thickness=0.1, overlap=0.9)

    by = {f"MPM, {cells} cells across": off(0.4 / cells) for cells in (20, 10, 5)}
    seconds = dict(zip(by, (1.0, 0.25, 0.0625), strict=True))
    by |= {"tiny": off(-0.05), AGAIN: off(0.005)}
    seconds |= {"tiny": 0.5, AGAIN: 2.0}
    first = Compared(kind="column", extent=0.4, free=True, by=by, seconds=seconds, band=(0.01, 0.02))
    second = replace(first, free=False, by=first.by | {"tiny": off(0.05)}, band=None)
    return ModelErrors(name="tiny", family="flow2d", compared=[first, second])


def test_the_price_is_that_of_the_cheapest_mpm_with_no_larger_error() -> None:
    _, price, bands = conclusion([model()], {})
    assert "0.5 s and 0.25 s (flow2d)" in price
    assert "1 of 1 fronts" in bands
    finer = [replace(scene, by=scene.by | {"tiny": scene.by[AGAIN]}) for scene in model().compared]
    assert "no coarse run" in conclusion([replace(model(), compared=finer)], {})[1]
    assert model().points["tiny"] == (0.5, pytest.approx(0.05))


def test_the_page_has_every_error_of_each_kind() -> None:
    column, every, again = kind_rows(model())
    assert (column["scenes, free"], column["front"]) == ("2, 1", "5.0 % (-5.0)")
    assert column["mean height"] == "20.0 % (-20.0)"
    assert (every["overlap in plan"], every["creep"], again["front"]) == ("90.0 % (90.0)", "-", "0.5 % (+0.5)")
