"""Materials: what may be combined, and the constants that follow."""

import math

import numpy as np
import pytest

from datasets.errors import InputError
from datasets.material import TENSION_SHARE, Material


def test_tresca_requires_a_cohesion_and_has_no_apex() -> None:
    clay = Material(friction_deg=0.0, cohesion=2.0e4, tension_cutoff=3.0e4)
    assert clay.friction == 0.0
    assert clay.tension_limit == 3.0e4
    with pytest.raises(
        InputError, match=r"material\.friction_deg: expected an angle above 0 degrees where there is no"
    ):
        Material(friction_deg=0.0)
    with pytest.raises(InputError, match=r"material\.friction_deg.*\[0, 90\)"):
        Material(friction_deg=90.0)
    with pytest.raises(InputError, match=r"material\.dilation_deg"):
        Material(friction_deg=0.0, cohesion=1.0, dilation_deg=1.0)


def test_a_share_of_the_cohesion_is_the_default_cutoff() -> None:
    assert Material(friction_deg=30.0, cohesion=1.0e3).tension_limit == TENSION_SHARE * 1.0e3 == 3.0
    assert Material(friction_deg=0.0, cohesion=1.0e3).tension_limit == 3.0
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
    with pytest.raises(InputError, match=r"material\.residual_tension_cutoff: .*at most 3"):
        Material(**soft, residual_tension_cutoff=3.1)


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


@pytest.mark.parametrize(
    ("wrong", "key"),
    [
        ({"residual_friction_deg": 31.0, "softening_length": 1.0}, "residual_friction_deg"),
        ({"residual_tension_cutoff": 3.1, "softening_length": 1.0}, "residual_tension_cutoff"),
        ({"residual_cohesion": 10.0}, "residual_cohesion"),
        (
            {"residual_friction_deg": 0.0, "residual_cohesion": 0.0, "softening_length": 1.0},
            "residual_friction_deg",
        ),
    ],
)
def test_what_cannot_be_is_named(wrong: dict[str, float], key: str) -> None:
    with pytest.raises(InputError, match=rf"material\.{key}"):
        Material(friction_deg=30.0, cohesion=1000.0, **wrong)


@pytest.mark.parametrize("dilation_deg", [0.0, 8.0])
def test_an_angle_of_a_slope_and_of_a_triaxial_test_mean_each_other(dilation_deg: float) -> None:
    measured = Material(friction_deg=25.5, angle="slope", dilation_deg=dilation_deg)
    phi = Material(friction_deg=measured.phi_deg, dilation_deg=dilation_deg)
    assert (measured.slope_deg, phi.slope_deg) == (pytest.approx(25.5), pytest.approx(25.5))
    if not dilation_deg:
        assert measured.phi_deg == pytest.approx(28.49, abs=0.01)  # sin phi = tan 25.5 degrees
