"""Fronts, heights and profiles of deposits that are known."""

import numpy as np
import pytest
from numpy.typing import NDArray

from datasets import Mass, Trajectory
from datasets.scene.particles import initial_particles
from tests.refusals import refused
from tests.scenes import flow_of, scene_of
from validation.experiments.experiment import Measured, Quantity, edge, quantity

BLOCK = scene_of(Mass(lower=(0.0, 0.0), size=(0.4, 0.1)), size=(1.0, 0.2), cell=0.01, jitter=0.0)
AT_START = initial_particles(BLOCK).positions


def flow(*positions: NDArray[np.floating]) -> Trajectory:
    """A trajectory of BLOCK with these frames, a second from one to the next."""
    return flow_of(BLOCK, positions, time=np.arange(len(positions), dtype=np.float64))


def number(kind: Quantity, **other: object) -> Measured:
    """A measured number of a kind."""
    return Measured(quantity=kind, value=0.1, spread=0.01, status="read", source="", **other)


def test_height_of_the_surface_and_front_by_share_and_by_thickness() -> None:
    assert quantity(number(Quantity.HEIGHT, within=0.05), flow(AT_START)) == pytest.approx(0.1)
    assert quantity(number(Quantity.FRONT), flow(AT_START)) == pytest.approx(0.4, abs=0.006)
    thin = quantity(number(Quantity.FRONT, thicker_than=0.05), flow(AT_START))
    assert thin == pytest.approx(0.4, abs=0.006)


def test_edge_is_linear_between_stations_and_ends_with_the_deposit() -> None:
    stations = np.array([0.0, 0.1, 0.2, 0.3, 0.4])
    assert edge(stations, np.array([0.3, 0.3, 0.1, 0.0, 0.0]), 0.05) == pytest.approx(0.25)
    # A crumb beyond a gap does not belong to the deposit.
    assert edge(stations, np.array([0.3, 0.3, 0.1, 0.0, 0.2]), 0.05) == pytest.approx(0.25)
    assert edge(stations, np.array([0.3, 0.3, 0.3, 0.3, 0.3]), 0.05) == 0.4
    assert edge(stations, np.array([0.0, 0.0, 0.01, 0.0, 0.0]), 0.05) == pytest.approx(0.2)


def test_radius_is_about_the_vertical_axis() -> None:
    angles = np.linspace(0.0, np.pi / 2.0, 1001)
    circle = np.stack([0.3 * np.cos(angles), np.zeros(1001), 0.3 * np.sin(angles)], axis=1)
    assert quantity(number(Quantity.RADIUS), flow(circle)) == pytest.approx(0.3)
    # From 0.3 to 0.6 m within a second; one radius of two is 50 mm off.
    measured = number(Quantity.RADII, times=(0.5, 1.0), radii=(0.4, 0.6))
    assert quantity(measured, flow(circle, 2.0 * circle)) == pytest.approx(0.05 / np.sqrt(2.0))


def test_profile_is_held_against_the_rows() -> None:
    measured = number(Quantity.PROFILE, x=(0.1, 0.2, 0.3, 0.6), heights=(0.1, 0.12, 0.1, 0.0))
    # One row of four is 20 mm off.
    assert quantity(measured, flow(AT_START)) == pytest.approx(0.01, rel=1e-3)


@pytest.mark.parametrize(("x", "heights"), [((0.1,), (0.1,)), ((0.1, 0.2), (0.1,)), ((0.2, 0.1), (0.1, 0.1))])
def test_a_wrong_profile_is_refused(x: tuple[float, ...], heights: tuple[float, ...]) -> None:
    refused(number, Quantity.PROFILE, x=x, heights=heights)
