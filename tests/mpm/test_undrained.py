"""Saturated material without drainage: the modulus of the water, dilation and contraction at constant volume."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from datasets import Mass, Material, Trajectory
from datasets.scene import water
from datasets.scene.grid_field import Field
from datasets.scene.water import constrained_modulus
from mpm import simulate
from mpm.output.recording import Recording
from tests.mpm.element import follow
from tests.scenes import scene_of

WET = Material(friction_deg=30.0, density=2000.0, saturated=True)

STIFF = dataclasses.replace(WET, young=2e6, cohesion=1.0, tension_cutoff=9.0, dilation_deg=10.0, softening_length=1e9)


def squeezed(rate_x: float, rate_y: float, *, time: float = 2.0e-5) -> tuple[Trajectory, float, float]:
    """A saturated body of hardly any weight in a corner, that begins with v = (rate_x x, rate_y y), after a step.

    Returns its flow, the numerical modulus of the water [Pa] and the time [s]."""
    places = {"origin": (0.0, 0.0), "spacing": (1.2, 1.2), "nodes": (2, 2)}
    x, y = 1.2 * rate_x, 1.2 * rate_y
    values = {"velocity_x": (0.0, 0.0, x, x), "velocity_y": (0.0, y, 0.0, y)}
    fields = tuple(Field(quantity=name, values=given, **places) for name, given in values.items())
    body = Mass(lower=(0.0, 0.0), size=(1.2, 1.2), k0=0.5, initial_pore_pressure_ratio=0.0)
    changes: dict[str, Any] = {"gravity": 1.0e-6, "duration": time, "frame_dt": time, "fields": fields, "jitter": 0.0}
    scene = scene_of(body, size=(1.4, 1.4), particles_per_axis=1, material=STIFF, **changes)
    flow = simulate(scene, record=Recording(fields=True), precision="f64")
    return flow, water.STIFFER * constrained_modulus(scene.material), time


def inside(flow: Trajectory) -> np.ndarray[Any, Any]:
    """Which particles of it are far from walls and surfaces, whose strain of the first step is another, [N]."""
    return np.asarray((np.abs(flow.positions[0] - 0.6) < 0.05).all(axis=1))


@pytest.mark.double
def test_undrained_strain_gives_the_modulus_of_the_water_and_shear_no_pressure() -> None:
    rate = 1.0e-3
    flow, modulus, time = squeezed(0.0, -rate)
    assert flow.pore_pressure[-1, inside(flow)] == pytest.approx(modulus * rate * time, rel=1.0e-6)
    flow, modulus, time = squeezed(rate, -rate)
    assert np.abs(flow.pore_pressure[-1, inside(flow)]).max() < 1.0e-6 * modulus * rate * time


@pytest.mark.double
def test_grains_that_dilate_at_constant_volume_press_on_each_other() -> None:
    """The mean effective stress by the flow of the plane F_13, in several steps, before waves come from the surface."""
    sand, rate, time = STIFF, 1.0e-2, 1.0e-3
    flow, _, _ = squeezed(rate, -rate, time=time)
    phi, psi = math.radians(sand.friction_deg), math.radians(sand.dilation_deg)
    excess = 4.0 * sand.shear_modulus * rate * time - 2.0 * sand.cohesion * math.cos(phi)
    flowed = excess / (4.0 * (sand.shear_modulus + (sand.lame + sand.shear_modulus) * math.sin(phi) * math.sin(psi)))
    expected = 2.0 * math.sin(psi) * (sand.lame + 2.0 / 3.0 * sand.shear_modulus) * flowed
    assert flow.pressure[-1, inside(flow)] == pytest.approx(expected, rel=5.0e-4)
    assert flow.pore_pressure[-1, inside(flow)].max() < 2.0e-3 * expected


@pytest.mark.double
@pytest.mark.parametrize("dilation_deg", [10.0, -10.0])
def test_undrained_shear_moves_along_the_failure_line(dilation_deg: float) -> None:
    """At a constant total stress: water bears what dilation takes from it, till contraction leaves grains nothing."""
    soil = dataclasses.replace(WET, young=2.0e7, dilation_deg=dilation_deg, softening_length=1.0e9)
    sin_phi, sin_psi = 0.5, math.sin(math.radians(dilation_deg))
    shear, bulk = soil.shear_modulus, soil.lame + soil.shear_modulus
    modulus = water.STIFFER * constrained_modulus(soil)
    strain, total, p = 2.0e-3, 1.0e5, 0.0
    stress = -total * np.array([1.0 - sin_phi, 1.0 + sin_phi, 2.0 * soil.poisson, 0.0])
    matrix = np.array([[bulk + modulus, -bulk * sin_psi], [-sin_phi * bulk, shear + bulk * sin_phi * sin_psi]])
    volume, _flowed = np.linalg.solve(matrix, np.array([0.0, shear * strain]))
    for number in range(1, 11):

        def unbalanced(e: float, start: np.ndarray[Any, Any] = stress, held: float = p) -> float:
            xx, yy, *_ = follow(soil, np.diag([e + strain, e - strain])[None], start)[0]
            return float(0.5 * (xx + yy) - held + 2.0 * modulus * e + total)

        e = brentq(unbalanced, -strain, strain, xtol=1.0e-16)
        stress, p = follow(soil, np.diag([e + strain, e - strain])[None], stress)[0], p - 2.0 * modulus * e
        expected = min(-2.0 * modulus * volume * number, total)
        assert p == pytest.approx(expected, rel=1.0e-6)
        least, most = stress[:2]
        assert most - least == pytest.approx(sin_phi * (most + least), abs=1.0e-6 * total)
    assert (p == pytest.approx(total)) == (dilation_deg < 0.0)
