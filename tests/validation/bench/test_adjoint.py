"""`python -m validation.bench adjoint`: Jacobians of a small flow agree, a page is written."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from datasets.library import read_scene
from validation.bench.__main__ import main
from validation.bench.adjoint.bench import COARSE, by_adjoint, by_differences, cosine, pushed


def test_a_cosine_is_of_directions() -> None:
    a = np.array([[1.0, 2.0], [3.0, 4.0]])
    assert cosine(a, 3.0 * a) == pytest.approx(1.0)
    assert cosine(a, -a) == pytest.approx(-1.0)
    assert cosine(a, np.array([[2.0, -1.0], [4.0, -3.0]])) == pytest.approx(0.0)


def test_one_mass_alone_is_pushed() -> None:
    scene = read_scene("layers-10")
    speeds = [mass.velocity[0] for mass in pushed(scene, 3, 0.1).masses if mass.velocity]
    before = [mass.velocity[0] for mass in scene.masses if mass.velocity]
    np.testing.assert_allclose(np.array(speeds) - before, np.where(np.arange(10) == 3, 0.1, 0.0), atol=1e-12)


@pytest.mark.slow
def test_both_jacobians_agree_on_a_short_flow() -> None:
    """A quarter of a second of the coarse layers: the mean x of halves of the sand over ten velocities."""
    scene = read_scene("layers-10")
    domain = dataclasses.replace(scene.domain, cell=COARSE)
    scene = dataclasses.replace(scene, domain=domain, damping=0.0, duration=0.25)
    ours, cut = by_adjoint(scene, 2)
    theirs = by_differences(scene, 2)
    assert ours.shape == theirs.shape == (2, 10)
    assert cut == 0.0
    assert cosine(ours, theirs) > 0.98
    assert np.linalg.norm(ours) == pytest.approx(np.linalg.norm(theirs), rel=0.1)


@pytest.mark.slow
def test_the_page(tmp_path: Path) -> None:
    assert main(["adjoint", "--out", str(tmp_path), "--quick"]) == 0
    text = (tmp_path / "adjoint.md").read_text(encoding="utf-8")
    assert text.startswith("# The MPM's own adjoint\n\n- A gradient costs ")
    assert "| without damping |" in text
