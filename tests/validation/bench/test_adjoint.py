"""`python -m validation.bench adjoint`: Jacobians of small flows agree, sizes are compared, a page is written."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from datasets.library import read_scene
from datasets.particles import particle_count
from mpm.adjoint.checks import lone_particle_step
from validation.bench.__main__ import main
from validation.bench.adjoint.agreement import agreement, coarse, cosine, flows, slopes
from validation.bench.adjoint.bench import agreement_texts, growth_row, growth_text, kept
from validation.bench.adjoint.growth import CASES, QUICK, Usage, usage


def test_a_cosine_is_of_directions() -> None:
    a = np.array([[1.0, 2.0], [3.0, 4.0]])
    assert cosine(a, 3.0 * a) == pytest.approx(1.0)
    assert cosine(a, -a) == pytest.approx(-1.0)
    assert cosine(a, np.array([[2.0, -1.0], [4.0, -3.0]])) == pytest.approx(0.0)


def test_shares_are_of_the_particles_in_the_order_of_x() -> None:
    observe = flows(2, 2, quick=True)[0].observe()
    positions = np.array([[3.0, 0.0], [1.0, 5.0], [2.0, 1.0], [7.0, 0.0]])
    np.testing.assert_allclose(observe(torch.from_numpy(positions)).numpy(), [1.5, 5.0])
    own = slopes(positions, observe)
    np.testing.assert_allclose(own[0], [[0.0, 0.0], [0.5, 0.0], [0.5, 0.0], [0.0, 0.0]])
    np.testing.assert_allclose(own.sum(axis=(1, 2)), 1.0)


def test_every_flow_has_its_parameters() -> None:
    found = flows(16, 10, quick=False)
    assert {each.unit for each in found} == {"m/s", "deg", "m"}
    assert {each.scene.dimension for each in found} == {2, 3}
    assert [len(each.names) for each in found] == [10, 10, 10, 10, 2]
    assert len(found[2].scene.masses) == 100
    assert found[4].scene.step_fraction < lone_particle_step(found[4].scene.material, 3)


@pytest.mark.slow
def test_both_jacobians_agree_on_a_short_flow() -> None:
    """A quarter of a second of the coarse layers: the mean x of halves of the sand over ten velocities."""
    flow = flows(2, 2, quick=True)[1]
    rows = agreement(
        dataclasses.replace(flow, scene=dataclasses.replace(coarse(read_scene("layers-10")), duration=0.25))
    )
    assert [row["step"] for row in rows] == ["0.15 m/s", "0.015 m/s"]
    for row in rows:
        assert row["cut"] == 0.0
        assert float(row["cosine"]) > 0.98
        assert row["length"] == pytest.approx(1.0, rel=0.1)


def test_sizes_grow_as_they_say() -> None:
    assert [particle_count(case.scene) for case in CASES] == [3_200, 12_800, 12_800, 100_128]
    assert CASES[2].scene.frames == 2 * CASES[1].scene.frames - 1


@pytest.mark.slow
def test_memory_and_steps_of_a_short_run() -> None:
    short, longer = (usage(case) for case in QUICK)
    assert longer.steps == pytest.approx(2 * short.steps, rel=0.02)
    assert short.particles == longer.particles == 800
    # Checkpoints and one segment's states grow with the root of the steps.
    assert short.tape < longer.tape < 1.7 * short.tape


def case(particles: int, steps: int, seconds: float) -> Usage:
    return Usage(particles=particles, steps=steps, seconds=seconds, tape=2**20, extra=2**21, whole=2**29)


def test_growth_follows_the_numbers() -> None:
    text = growth_text([case(1_000, 100, 1.0), case(10_000, 400, 80.0)])
    assert "1,000 particles and 100 steps take 2 MiB (the whole process 512) and 1 s" in text
    assert "10,000 particles and 400 steps take 2 MiB" in text
    assert text.endswith("10000 to 20000 ns for each particle and step.")
    assert growth_row(case(1_000, 100, 1.0))["bytes per particle and root of steps"] == "210"


def test_what_agrees_is_counted() -> None:
    rows = [
        {"Jacobian": "a", "step": "1 m", "cosine": 0.999, "length": 1.01},
        {"Jacobian": "b", "step": "1 m", "cosine": 0.97, "length": 1.0},
        {"Jacobian": "c", "step": "2 m", "cosine": 0.995, "length": 1.06},
    ]
    first, second = agreement_texts(rows)
    assert "1 of 3 comparisons have a cosine of at least 0.99" in first
    assert "the least cosine is 0.9700, b, 1 m" in first
    assert "b, 1 m: 0.9700, 1.000; c, 2 m: 0.9950, 1.060" in second
    assert len(agreement_texts(rows[:1])) == 1


def test_what_was_done_is_kept(tmp_path: Path) -> None:
    done: list[int] = []

    def work() -> dict[str, Any]:
        done.append(1)
        return {"a": 1.5}

    assert kept(tmp_path / "a.json", work) == kept(tmp_path / "a.json", work) == {"a": 1.5}
    assert len(done) == 1


@pytest.mark.slow
def test_the_page(tmp_path: Path) -> None:
    assert main(["adjoint", "--out", str(tmp_path), "--quick"]) == 0
    text = (tmp_path / "adjoint.md").read_text(encoding="utf-8")
    assert text.startswith("# The MPM's own adjoint\n\n- A gradient costs ")
    assert "| ten velocities, without damping |" in text
