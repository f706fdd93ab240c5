"""A tolerance picks the cheapest resolution that was measured to keep it, and fits it to the box."""

import dataclasses

import numpy as np
import pytest

from datasets import Domain, Mass, Scene, read_scene
from datasets.geometry.placement import connected, corners
from mpm.resolution import (
    MeasuredResolution,
    Resolution,
    characteristic_length,
    fitted_cell,
    read_measured,
    read_tolerance,
    resolved,
)
from tests.refusals import refused
from tests.scenes import scene_of


def scene(*masses: tuple[tuple[float, ...], tuple[float, ...]], size: tuple[float, ...] = (1.0, 1.0)) -> Scene:
    """Masses given as (lower, size) in a box of cells of 0.01 m."""
    return scene_of(*(Mass(lower=lower, size=extent) for lower, extent in masses), size=size, cell=0.01)


COLUMN = scene(((0.0, 0.0), (0.2, 0.4)))


def measured(cells: float, promised: float, cost: float, *, dimension: int = 2, points: int = 2) -> MeasuredResolution:
    what = Resolution(cells=cells, particles_per_axis=points, step_fraction=0.9, precision="f32")
    errors = {"expected": 0.5 * promised, "promised": promised, "thickness": promised}
    return MeasuredResolution(dimension=dimension, resolution=what, particle_steps=1.0e6 * cost, **errors)


@pytest.mark.parametrize(("text", "value"), [("2%", 0.02), (" 2.5 % ", 0.025), ("0.02", 0.02), ("1e-2", 0.01)])
def test_a_tolerance_is_a_percentage_or_a_fraction(text: str, value: float) -> None:
    assert read_tolerance(text) == pytest.approx(value)
    for wrong in ("2", "0", "-1%", "100%", "two", "", "%", "nan", "inf%"):
        assert refused(read_tolerance, wrong, said="expected a percentage such as 2%").key == "--tolerance"


def test_the_cheapest_within_the_tolerance_is_picked() -> None:
    measurements = [
        measured(10, 0.06, 1.0),
        measured(20, 0.03, 8.0),
        measured(40, 0.015, 64.0),
        measured(15, 0.028, 9.0, points=3),
    ]
    assert resolved(COLUMN, 0.05, measurements).cells == 20.0
    assert resolved(COLUMN, 0.029, measurements).scene.particles_per_axis == 3
    assert resolved(COLUMN, 0.015, measurements).cells == 40.0


def test_a_tolerance_below_the_best_is_refused_with_the_best() -> None:
    measurements = [measured(10, 0.06, 1.0), measured(40, 0.021, 64.0), measured(10, 0.001, 1.0, dimension=3)]
    refused(resolved, COLUMN, 0.02, measurements, said="--tolerance: expected at least 2.1% in 2D")


@pytest.mark.parametrize("lengths", [(1.0, 1.0), (1.81, 0.83), (0.96, 0.36)])
@pytest.mark.parametrize("largest", [0.07, 0.01, 0.004])
def test_a_cell_divides_every_side_of_the_box(lengths: tuple[float, ...], largest: float) -> None:
    cell = fitted_cell(Domain(size=lengths, cell=0.01), largest)
    assert cell <= largest * (1.0 + 1e-9)
    # Scenes on other grids are refused.
    dataclasses.replace(
        COLUMN, domain=Domain(size=lengths, cell=cell), masses=(Mass(lower=(0.0, 0.0), size=(0.2, 0.2)),)
    )


def test_masses_that_touch_are_one_body_and_a_side_from_wall_to_wall_does_not_count() -> None:
    layers = scene(*(((0.0, 0.028 * n), (0.35, 0.028)) for n in range(10)))
    assert characteristic_length(layers) == pytest.approx(0.28)
    # The last joins two groups that did not touch before.
    joined = scene(((0.0, 0.0), (0.1, 0.1)), ((0.3, 0.0), (0.1, 0.1)), ((0.1, 0.0), (0.2, 0.1)))
    for masses, count in ((joined.masses, 1), (joined.masses[:2], 2)):
        assert len(np.unique(connected(*corners(masses)))) == count
    thin = scene(((0.0, 0.0, 0.0), (0.4, 0.2, 0.05)), size=(1.0, 1.0, 0.05))
    assert characteristic_length(thin) == pytest.approx(0.2)
    assert characteristic_length(scene(((0.0, 0.0), (1.0, 0.3)))) == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("name", "dimension"), [("column-tall-21", 2), ("layers-10", 2), ("baffles-2", 3), ("baffles-5", 3)]
)
def test_what_ships_resolves_every_shipped_kind_of_scene(name: str, dimension: int) -> None:
    measurements = [measurement for measurement in read_measured() if measurement.dimension == dimension]
    loosest, tightest = (pick(measurement.promised for measurement in measurements) for pick in (max, min))
    loose, tight = (resolved(read_scene(name), tolerance) for tolerance in (loosest, 1.2 * tightest))
    assert loose.scene.dimension == dimension
    assert tight.measured.promised <= 1.2 * tightest
    assert tight.cost > loose.cost
    assert tight.scene.domain.cell < loose.scene.domain.cell
