"""Model discrepancy: no factor for a fit that noise and scatter explain, for a worse one its ratio."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inverse.result import Verdict
from inverse.settings import TargetSettings
from tests.validation.loop.flows import SHAPE, length, wedge
from validation.loop.discrepancy import compare


def drawn(stream: np.random.Generator, *, noise: float, scatter: float, true: float, shared: float = 0.0) -> Any:
    """A straight line of two unknowns through 30 numbers with noise that is `true` / `noise` times the stated one."""
    x = np.linspace(-1.0, 1.0, 30)
    design = np.stack([np.ones(30), x], axis=1)

    def flow() -> np.ndarray:
        return scatter * (np.sqrt(1.0 - shared) * stream.normal(size=30) + np.sqrt(shared) * stream.normal())

    seen = flow() + true * stream.normal(size=30)
    fitted, *_ = np.linalg.lstsq(design, seen, rcond=None)
    ensemble = np.stack([flow() for _ in range(16)])
    return compare(seen - design @ fitted, np.full(30, noise), ensemble, 2, runs=10**6)


@pytest.mark.parametrize("shared", [0.0, 0.8])
def test_a_fit_as_good_as_it_should_be_is_seldom_widened(shared: float) -> None:
    stream = np.random.default_rng(1)
    factors = [drawn(stream, noise=1.0, scatter=0.5, true=1.0, shared=shared).factor for _ in range(300)]
    assert np.mean(np.array(factors) > 1.0) < 0.12


def test_understated_noise_is_found_out_and_by_how_much() -> None:
    stream = np.random.default_rng(2)
    factors = [drawn(stream, noise=1.0, scatter=0.2, true=3.0).factor for _ in range(200)]
    assert np.mean(factors) == pytest.approx(3.0, rel=0.1)
    assert min(factors) > 1.5


def test_one_number_for_one_parameter_leaves_none_over() -> None:
    assert compare(np.zeros(1), np.ones(1), np.zeros((4, 1)), 1, runs=1) is None


@pytest.mark.parametrize("rough", [0.0, 0.12])
def test_a_rough_profile_has_an_answer_with_a_wider_half_width(tmp_path: Path, rough: float) -> None:
    """Heights that scatter by four times the stated 3 %: an answer, not `unreachable`."""
    rng = np.random.default_rng(5)
    x = np.linspace(0.0, length(24.0), 25)
    # Of the wedge's particles: the height of a quantile SHAPE is 2 A / L (1 - x / L), here with A = 0.06 m^2.
    assert SHAPE[300] == pytest.approx(1.0 - np.sqrt(0.5), abs=0.001)
    height = 2.0 * 0.06 / x[-1] * (1.0 - x / x[-1]) * (1.0 + np.hypot(rough, 0.03) * rng.standard_normal(25))
    rows = "".join(f"{a:.6g},{b:.6g}\n" for a, b in zip(x, height, strict=True))
    (tmp_path / "seen.csv").write_text("x,height\n" + rows)
    target = TargetSettings(csv="seen.csv", noise="3%")
    case = wedge(tmp_path, kind="profile", target=target, scatter=0.002)
    result = case.solve(tmp_path / "out")
    assert result.verdict in (Verdict.CONFIRMED, Verdict.UNCONFIRMED)
    assert result.certainty is not None
    assert abs(result.unknowns["friction_deg"] - 24.0) <= result.certainty["friction_deg"]
    fit = result.outcome.discrepancy
    assert fit is not None
    # The rows' own scatter is counted before the model is compared with them.
    assert 1.0 <= fit.factor < 1.6
    if rough:
        assert 1.5 < case.target.roughness < 5.0
        assert result.certainty["friction_deg"] > 0.5
    else:
        assert case.target.roughness == 1.0
