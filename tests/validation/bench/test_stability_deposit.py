"""Deposits: each check passes on a pile as it should be, and finds one that is not."""

import copy
import dataclasses
import math

import numpy as np
import pytest

from datasets.material import Material
from datasets.scene import Baffle, Domain, Mass
from datasets.trajectory import Trajectory
from tests.validation.bench.sand_at_rest import BED, SAND, at_rest, scene_of, shaped
from validation.bench.stability import deposit

FINE = Domain(size=(1.2, 0.6), cell=0.02)


def wedge(slope_deg: float, friction_deg: float = 30.0, **changes: object) -> Trajectory:
    """A pile at the left wall at a constant slope, with the bed's area."""
    tan = math.tan(math.radians(slope_deg))
    top = math.sqrt(2.0 * 0.4 * 0.2 * tan)
    material = dataclasses.replace(SAND, friction_deg=friction_deg)
    return shaped(lambda x: max(0.0, top - x * tan), scene_of(domain=FINE, material=material, **changes))


def test_a_moving_pile_is_not_at_rest() -> None:
    flow = at_rest()
    assert deposit.rest(flow).ok
    summary = copy.deepcopy(flow.summary)
    summary["energy"]["kinetic"][-1] = 2.0e-3
    assert not deposit.rest(dataclasses.replace(flow, summary=summary)).ok


@pytest.mark.parametrize("slope_deg", [10.0, 20.0, 30.0, 45.0])
def test_a_slope_is_measured_as_well_as_the_margin_says(slope_deg: float) -> None:
    assert deposit.steepest(wedge(slope_deg)) == pytest.approx(slope_deg, abs=2.6)


@pytest.mark.parametrize(("slope_deg", "ok"), [(28.0, True), (30.0, True), (38.0, False), (45.0, False)])
def test_a_slope_may_not_exceed_the_angle_of_friction(slope_deg: float, ok: bool) -> None:
    assert deposit.repose(wedge(slope_deg)).ok is ok


def test_the_strongest_material_of_a_scene_sets_the_slope() -> None:
    strong = Mass(lower=(1.0, 0.0), size=(0.1, 0.1), material=Material(friction_deg=45.0))
    assert not deposit.repose(wedge(40.0)).ok
    assert deposit.repose(at_rest(scene_of(BED, strong, domain=FINE))).maximum == 45.0 + deposit.REPOSE_MARGIN_DEG


def test_a_step_at_a_baffle_is_no_slope() -> None:
    """Sand behind a baffle stands as high as it; the surface ends there."""
    flat = Mass(lower=(0.0, 0.0), size=(0.5, 0.2))
    free = at_rest(scene_of(flat, domain=FINE))
    held = at_rest(scene_of(flat, domain=FINE, baffles=(Baffle(lower=(0.5, 0.0), size=(0.1, 0.2)),)))
    assert deposit.steepest(free) > 40.0
    assert deposit.steepest(held) < 1.0


@pytest.mark.parametrize("along", [0, 2])
def test_a_slope_in_three_dimensions(along: int) -> None:
    """A lattice of points under the plane y = 0.2 - x / 2, along x or z."""
    room = Domain(size=(0.4, 0.3, 0.4), cell=0.02)
    flow = at_rest(scene_of(Mass(lower=(0.0, 0.0, 0.0), size=(0.4, 0.2, 0.4)), domain=room))
    positions = flow.positions.copy()
    positions[-1, :, 1] *= 1.0 - positions[-1, :, along] / 0.4
    sloped = dataclasses.replace(flow, positions=positions)
    assert deposit.steepest(sloped) == pytest.approx(math.degrees(math.atan(0.5)), abs=1.5)


@pytest.mark.parametrize(("growth", "ok"), [(1.0, True), (1.03, True), (1.1, False), (1.7, False), (0.9, False)])
def test_a_change_of_volume_is_found(growth: float, ok: bool) -> None:
    """A bed that fills the box from wall to wall and has grown in height."""
    flow = at_rest(scene_of(Mass(lower=(0.0, 0.0), size=(0.8, 0.2))))
    positions = flow.positions.copy()
    positions[-1, :, 1] *= growth
    finding = deposit.volume(dataclasses.replace(flow, positions=positions))
    assert finding is not None
    assert finding.ok is ok
    assert finding.value == pytest.approx(growth - 1.0, abs=0.06)


def test_a_bed_that_hangs_above_the_floor_has_grown() -> None:
    flow = at_rest(scene_of(Mass(lower=(0.0, 0.0), size=(0.8, 0.2))))
    positions = flow.positions.copy()
    positions[-1, :, 1] += 0.08
    finding = deposit.volume(dataclasses.replace(flow, positions=positions))
    assert finding is not None
    assert finding.value > 0.2


def test_the_volume_of_a_pile_is_that_of_its_core() -> None:
    finding = deposit.volume(wedge(25.0))
    assert finding is not None
    assert finding.value == pytest.approx(0.0, abs=0.03)


def test_a_thin_layer_has_no_core() -> None:
    assert deposit.volume(at_rest(scene_of(Mass(lower=(0.0, 0.0), size=(0.8, 0.06))))) is None


def test_volume_in_three_dimensions() -> None:
    room = Domain(size=(0.4, 0.3, 0.4), cell=0.02)
    flow = at_rest(scene_of(Mass(lower=(0.0, 0.0, 0.0), size=(0.4, 0.2, 0.4)), domain=room))
    positions = flow.positions.copy()
    positions[-1, :, 1] *= 1.25
    before, after = deposit.volume(flow), deposit.volume(dataclasses.replace(flow, positions=positions))
    assert before is not None
    assert after is not None
    assert before.value == pytest.approx(0.0, abs=1e-9)
    assert after.value == pytest.approx(0.25, abs=0.05)


@pytest.mark.parametrize(("shift", "ok"), [(0.0, True), (0.0016, True), (0.0024, False)])
def test_fronts_apart_are_found(shift: float, ok: bool) -> None:
    single = at_rest()
    positions = single.positions + np.array([shift, 0.0], np.float32)
    assert (
        deposit.agreement(single, dataclasses.replace(single, positions=positions), within=deposit.AGREEMENT).ok is ok
    )
