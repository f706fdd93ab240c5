"""What every flow keeps: each check passes on sand at rest, and finds what is wrong where something is."""

import copy
import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from datasets.material import Material
from datasets.scene import Baffle, Domain, Mass
from datasets.trajectory import Trajectory
from mpm import exact_solutions
from tests.validation.bench.sand_at_rest import BAFFLE, BED, FRAMES, at_rest, scene_of
from validation.bench.stability import invariants
from validation.bench.stability.finding import Finding

Check = Callable[[Trajectory], Finding | None]


def found(check: Check, flow: Trajectory) -> Finding:
    finding = check(flow)
    assert finding is not None
    return finding


def with_energy(flow: Trajectory, kind: str, series: list[float]) -> Trajectory:
    summary = copy.deepcopy(flow.summary)
    summary["energy"][kind] = series
    return dataclasses.replace(flow, summary=summary)


def moved(flow: Trajectory, frame: int, particle: int, position: tuple[float, ...]) -> Trajectory:
    positions = flow.positions.copy()
    positions[frame, particle] = position
    return dataclasses.replace(flow, positions=positions)


def test_sand_at_rest_passes() -> None:
    for scene in (scene_of(), scene_of(baffles=(BAFFLE,)), scene_of(gravity=0.0)):
        for check in invariants.INVARIANTS:
            finding = check(at_rest(scene))
            assert finding is None or finding.ok, finding


@pytest.mark.parametrize("field", ["positions", "velocities", "pressure", "plastic_strain", "solid_impulse"])
def test_a_single_nan_is_found(field: str) -> None:
    flow = at_rest(scene_of(baffles=(BAFFLE,)))
    array = getattr(flow, field).copy()
    array[2, 0] = np.nan
    assert not found(invariants.finite, dataclasses.replace(flow, **{field: array})).ok


def test_an_infinite_energy_is_found() -> None:
    flow = with_energy(at_rest(), "elastic", [0.0, 0.0, np.inf, 0.0, 0.0])
    assert found(invariants.finite, flow).value == 1


@pytest.mark.parametrize("position", [(-1e-4, 0.1), (0.8001, 0.1), (0.4, -1e-4), (0.4, 0.41)])
def test_a_particle_outside_the_box_in_one_frame_is_found(position: tuple[float, float]) -> None:
    finding = found(invariants.inside_box, moved(at_rest(), 2, 7, position))
    assert not finding.ok
    assert finding.value >= 0.0049


def test_a_particle_on_a_wall_is_inside() -> None:
    assert found(invariants.inside_box, moved(at_rest(), 2, 7, (0.8, 0.0))).ok


@pytest.mark.parametrize(("position", "cells"), [((0.55, 0.19), 0.5), ((0.501, 0.1), 0.05), ((0.55, 0.0), 2.5)])
def test_a_particle_inside_a_baffle_is_found_also_on_the_face_that_it_stands_on(
    position: tuple[float, float], cells: float
) -> None:
    finding = found(invariants.outside_baffles, moved(at_rest(scene_of(baffles=(BAFFLE,))), 3, 0, position))
    assert not finding.ok
    assert finding.value == pytest.approx(cells, rel=1e-3)


@pytest.mark.parametrize("position", [(0.5, 0.1), (0.55, 0.2), (0.6, 0.0)])
def test_a_particle_on_a_face_is_outside(position: tuple[float, float]) -> None:
    assert found(invariants.outside_baffles, moved(at_rest(scene_of(baffles=(BAFFLE,))), 3, 0, position)).ok


def test_a_particle_under_a_baffle_that_hangs_is_outside() -> None:
    hanging = Baffle(lower=(0.5, 0.1), size=(0.1, 0.1))
    assert found(invariants.outside_baffles, moved(at_rest(scene_of(baffles=(hanging,))), 3, 0, (0.55, 0.05))).ok


def test_without_baffles_there_is_nothing_to_be_inside_of() -> None:
    assert invariants.outside_baffles(at_rest()) is None


def test_a_lost_particle_and_a_particle_too_many_are_found() -> None:
    flow = at_rest()
    for points in (slice(1, None), [0, *range(flow.positions.shape[1])]):
        assert found(invariants.mass, dataclasses.replace(flow, positions=flow.positions[:, points])).value > 1e-3


def test_a_particle_in_no_box_is_found() -> None:
    assert not found(invariants.mass, moved(at_rest(), 0, 0, (0.6, 0.1))).ok


def test_a_mass_whose_particles_went_to_its_neighbour_is_found() -> None:
    halves = (Mass(lower=(0.0, 0.0), size=(0.2, 0.2)), Mass(lower=(0.2, 0.0), size=(0.2, 0.2)))
    assert found(invariants.mass, at_rest(scene_of(*halves))).ok
    assert not found(invariants.mass, moved(at_rest(scene_of(*halves)), 0, 0, (0.21, 0.101))).ok


def test_momentum_from_nowhere_is_found() -> None:
    flow = at_rest()
    assert flow.velocities is not None
    velocities = flow.velocities.copy()
    velocities[3, :, 0] = 1.0e-3
    finding = found(invariants.momentum, dataclasses.replace(flow, velocities=velocities))
    assert finding.value == pytest.approx(1e-3 / (9.81 * 0.3), rel=1e-3)
    assert not finding.ok


@pytest.mark.parametrize("factor", [0.99, 1.01])
def test_a_floor_that_takes_another_weight_is_found(factor: float) -> None:
    flow = at_rest()
    impulse = (factor * np.array(flow.summary["wall_impulse"])).tolist()
    finding = found(invariants.momentum, dataclasses.replace(flow, summary=flow.summary | {"wall_impulse": impulse}))
    assert finding.value == pytest.approx(0.01)


def test_what_a_baffle_takes_is_counted() -> None:
    flow = at_rest(scene_of(Mass(lower=(0.0, 0.0), size=(0.4, 0.2), velocity=(2.0, 0.0)), baffles=(BAFFLE,)))
    velocities = np.zeros_like(flow.positions)
    velocities[:2, :, 0] = 2.0
    stopped = dataclasses.replace(flow, velocities=velocities)
    assert found(invariants.momentum, stopped).value > 0.1
    impulse = np.zeros((FRAMES, 1, 2))
    impulse[2:, 0, 0] = 2.0 * invariants.particle_masses(flow).sum()
    assert found(invariants.momentum, dataclasses.replace(stopped, solid_impulse=impulse)).ok


def test_momentum_weighs_every_material_by_its_density() -> None:
    light, heavy = BED, Mass(lower=(0.4, 0.0), size=(0.2, 0.2), material=Material(friction_deg=30.0, density=3600.0))
    flow = at_rest(scene_of(light, heavy))
    assert invariants.particle_masses(flow).sum() == pytest.approx(1800.0 * 0.08 + 3600.0 * 0.04)
    assert found(invariants.momentum, flow).ok


def test_a_damped_flow_has_no_balance_of_momentum() -> None:
    assert invariants.momentum(at_rest(scene_of(damping=0.1))) is None


def test_single_precision_has_a_wider_bound() -> None:
    double = at_rest()
    single = dataclasses.replace(double, summary=double.summary | {"precision": "f32"})
    assert found(invariants.momentum, single).maximum > found(invariants.momentum, double).maximum


@pytest.mark.parametrize("kind", ["kinetic", "potential", "elastic"])
def test_a_rise_of_any_energy_is_found(kind: str) -> None:
    flow = at_rest()
    initial = exact_solutions.total_energy(flow)[0]
    series = list(flow.summary["energy"][kind])
    series[3] += 3.0e-4 * initial
    assert not found(invariants.energy, with_energy(flow, kind, series)).ok


def test_many_small_rises_are_found() -> None:
    flow = at_rest()
    initial = exact_solutions.total_energy(flow)[0]
    rising = with_energy(flow, "elastic", [0.0, *(1.0 + 1.0e-4 * initial * k for k in range(FRAMES - 1))])
    steps = np.diff(exact_solutions.total_energy(rising)[1:]) / initial
    assert steps.max() < invariants.ENERGY
    assert found(invariants.energy, rising).value == pytest.approx(3.0e-4, rel=1e-3)


def test_energy_counts_from_the_lowest_corner_of_a_tilted_box() -> None:
    """Potential energy is negative downhill: without a lowest corner the bound would be of any sign."""
    flow = at_rest(scene_of(slope_deg=60.0))
    assert flow.summary["energy"]["potential"][0] < 0.0
    initial = exact_solutions.total_energy(flow)[0]
    weight = invariants.particle_masses(flow).sum() * 9.81
    scale = initial + weight * 0.8 * np.sin(np.radians(60.0))
    series = [0.0, 0.0, 0.0, 0.01 * scale, 0.0]
    assert found(invariants.energy, with_energy(flow, "elastic", series)).value == pytest.approx(0.01)


def test_the_checks_work_in_three_dimensions() -> None:
    room = Domain(size=(0.4, 0.2, 0.2), cell=0.02)
    scene = scene_of(
        Mass(lower=(0.0, 0.0, 0.0), size=(0.1, 0.1, 0.1)),
        domain=room,
        baffles=(Baffle(lower=(0.2, 0.0, 0.0), size=(0.1, 0.1, 0.2)),),
    )
    flow = at_rest(scene)
    assert all(finding.ok for check in invariants.INVARIANTS if (finding := check(flow)) is not None)
    # A baffle from wall to wall is left over its top and at its two faces only.
    assert found(invariants.outside_baffles, moved(flow, 1, 0, (0.25, 0.09, 0.0))).value == pytest.approx(0.5, rel=1e-3)


@pytest.mark.parametrize(("value", "ok"), [(0.5, True), (1.5, False), (-0.5, False), (float("nan"), False)])
def test_a_finding_passes_within_its_range_only(value: float, ok: bool) -> None:
    assert Finding(check="x", value=value, minimum=0.0, maximum=1.0).ok is ok
