"""The page of speeds on made-up figures, and what is timed."""

from pathlib import Path

import numpy as np
import pytest

from datasets.particles import particle_count
from validation.bench.speed import CASES, Price, column, draw, enlarged, mean_x, modes, page
from validation.report.measuring import spread

RATES = {
    (case, mode): spread([10.0 * rank, 12.0 * rank])
    for rank, case in enumerate(CASES, start=1)
    for mode in (("f32", 2), ("f64", 2))
}
PRICES = [
    Price(particles=3200, steps=4400, run=1.0, gradient=5.0, memory=2**20),
    Price(particles=12800, steps=4400, run=4.0, gradient=22.0, memory=2**24),
]


def test_the_page_says_what_was_measured(tmp_path: Path) -> None:
    text = page(RATES, PRICES, [{"model": "`flow2d`", "nodes": "500", "µs per node": "148"}], command="it")
    assert "In 2D the MPM makes 22 to 55 million particle-steps a second, at 3,200 to " in text.conclusion
    assert "5.0 to 5.5 runs, for any number of unknowns, and at most 16 MiB (12,800" in text.conclusion
    assert "takes 148 µs for each node" in text.conclusion
    assert "GeoTaichi" in str(text)
    draw(tmp_path / "speed.png", RATES, PRICES)
    assert (tmp_path / "speed.png").stat().st_size > 10_000


def test_columns_have_the_particles_that_the_cases_state() -> None:
    assert [case.particles for case in CASES if case.dimension == 2] == [3200, 3200, 25088, 100352, 1002528]
    assert particle_count(enlarged(2.0, 0.1)) == 4 * particle_count(enlarged(1.0, 0.1)) == 12800
    assert modes(CASES[0]) == [("f32", 1), ("f64", 1)]
    assert column(3, 32, 10).frames == 11


def test_the_objective_of_the_priced_gradient_has_its_derivative() -> None:
    positions = np.random.default_rng(0).random((1, 5, 2))
    value, slope, _ = mean_x(positions, positions)
    moved = positions.copy()
    moved[0, 3, 0] += 1e-6
    assert (mean_x(moved, moved)[0] - value) / 1e-6 == pytest.approx(slope[0, 3, 0])
