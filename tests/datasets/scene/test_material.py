"""Materials: what may be combined, and the constants that follow."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from datasets.scene.material import TENSION_SHARE, Material
from tests.refusals import refused


def test_a_share_of_the_cohesion_is_the_default_cutoff() -> None:
    assert Material(friction_deg=30.0, cohesion=1.0e3).tension_limit == TENSION_SHARE * 1.0e3 == 3.0
    assert Material(friction_deg=0.0, cohesion=1.0e3).tension_limit == 3.0
    # Of Tresca's clay there is no apex.
    assert Material(friction_deg=0.0, cohesion=2.0e4, tension_cutoff=3.0e4).tension_limit == 3.0e4
    assert Material(friction_deg=30.0).tension_limit == 0.0
    steep = Material(friction_deg=89.9, cohesion=1.0e3)
    assert steep.tension_limit == pytest.approx(1.0e3 / math.tan(math.radians(89.9)))
    assert steep.tension_limit < 3.0


def test_the_default_cutoff_stays_after_softening_below_the_residual_apex() -> None:
    soft = {"friction_deg": 30.0, "cohesion": 1.0e3, "strength_gradient": 500.0, "softening_length": 0.1}
    depth = np.array([0.0, 2.0])
    half = Material(**soft, residual_cohesion=500.0)
    np.testing.assert_array_equal(half.residual_tension_limit_at(depth), half.tension_limit_at(depth))
    assert half.residual.tension_limit == half.tension_limit == 3.0
    nearly_none = Material(**soft, residual_cohesion=1.0)
    apex = np.array([1.0, 2.0]) / math.tan(math.radians(30.0))
    np.testing.assert_allclose(nearly_none.residual_tension_limit_at(depth), apex)
    assert Material(**soft, residual_cohesion=0.0).residual_tension_limit_at(2.0) == 0.0
    assert Material(**soft, residual_tension_cutoff=1.0).residual_tension_limit_at(2.0) == 1.0


def test_the_residual_material() -> None:
    """What is not given stays; what remains of the cohesion is the same share of it at every depth."""
    plain = Material(friction_deg=30.0, cohesion=1.0e3)
    assert plain.residual is plain
    soil = Material(
        friction_deg=40.0,
        dilation_deg=10.0,
        cohesion=4.0e3,
        strength_gradient=1.0e3,
        tension_cutoff=500.0,
        softening_length=0.05,
        residual_friction_deg=30.0,
        residual_cohesion=1.0e3,
    )
    residual = soil.residual
    assert residual == Material(
        friction_deg=30.0, cohesion=1.0e3, strength_gradient=250.0, tension_cutoff=500.0, density=soil.density
    )
    depth = np.array([0.0, 2.0])
    np.testing.assert_allclose(residual.cohesion_at(depth), 0.25 * soil.cohesion_at(depth))
    assert residual.residual is residual
    assert Material(friction_deg=40.0, softening_length=0.1).residual.friction_deg == 40.0


CUT_OFF = {"residual_tension_cutoff": 3.1, "softening_length": 1.0}


@pytest.mark.parametrize(
    ("key", "wrong"),
    [
        ("angle", {"angle": "table"}),
        ("friction_deg: expected an angle above 0 degrees where there is no", {"friction_deg": 0.0, "cohesion": 0.0}),
        ("friction_deg: expected an angle in [0, 90)", {"friction_deg": 90.0}),
        ("dilation_deg", {"friction_deg": 0.0, "dilation_deg": 1.0}),
        ("friction_deg", {"angle": "slope", "friction_deg": 45.0}),
        ("residual_friction_deg", {"residual_friction_deg": 31.0, "softening_length": 1.0}),
        ("residual_friction_deg", {"residual_friction_deg": 0.0, "residual_cohesion": 0.0, "softening_length": 1.0}),
        ("residual_tension_cutoff: expected a value in [0, tension_cutoff], at most 3", CUT_OFF),
        ("residual_cohesion", {"residual_cohesion": 10.0}),
        ("friction_limit_deg", {"friction_limit_deg": 29.0, "grain_diameter": 1e-3}),
        ("friction_limit_deg", {"friction_limit_deg": 45.0, "grain_diameter": 1e-3, "angle": "slope"}),
        ("grain_diameter", {"friction_limit_deg": 40.0}),
        ("grain_density", {"friction_limit_deg": 40.0, "grain_diameter": 1e-3, "grain_density": 0.0}),
        ("inertial_number", {"friction_limit_deg": 40.0, "grain_diameter": 1e-3, "inertial_number": 0.0}),
    ],
)
def test_what_cannot_be_is_named(key: str, wrong: dict[str, Any]) -> None:
    refused(Material, **{"friction_deg": 30.0, "cohesion": 1000.0, **wrong}, said=f"material.{key}")


def test_a_slopes_angle_is_daviss() -> None:
    """tan(angle) = sin phi cos psi / (1 - sin phi sin psi); 25.5 degrees of a table are 28.5 of phi."""
    assert Material(friction_deg=25.5, angle="slope").phi_deg == pytest.approx(28.49, abs=0.01)
    dense = Material(friction_deg=38.0, dilation_deg=12.0, angle="slope")
    phi, psi = math.radians(dense.phi_deg), math.radians(12.0)
    davis = math.sin(phi) * math.cos(psi) / (1.0 - math.sin(phi) * math.sin(psi))
    assert math.degrees(math.atan(davis)) == pytest.approx(38.0, abs=1e-9)
    assert (dense.slope_deg, dense.friction) == (pytest.approx(38.0), pytest.approx(math.tan(phi)))
    soft = dataclasses.replace(dense, softening_length=0.01, residual_friction_deg=30.0)
    assert soft.residual.phi_deg == pytest.approx(math.degrees(math.asin(math.tan(math.radians(30.0)))))
    assert dataclasses.replace(soft, residual_friction_deg=None).residual.phi_deg == pytest.approx(dense.phi_deg)
