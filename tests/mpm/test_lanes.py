"""Vectors of 4 or 8 lanes, as processors without AVX-512 have them, compute the same flow as those of 16."""

import dataclasses

import numpy as np
import pytest

from datasets.material import Material
from datasets.scene import Baffle, Mass
from mpm import WITH_FIELDS, simulate
from mpm.arrays import features as module
from tests.mpm.scenes import box, room

SCENES = {
    "column": box(),
    "cohesive masses that meet a baffle": box(
        Mass(lower=(0.0, 0.0), size=(0.2, 0.2), velocity=(1.0, 0.0)),
        Mass(lower=(0.0, 0.2), size=(0.1, 0.1), material=Material(friction_deg=20.0, cohesion=200.0)),
        baffles=(Baffle(lower=(0.3, 0.0), size=(0.1, 0.1)),),
        damping=0.05,
    ),
    "column in 3D": room(Mass(lower=(0.0, 0.0, 0.2), size=(0.2, 0.2, 0.2))),
}


@pytest.mark.slow
@pytest.mark.parametrize("register", [16, 32])
@pytest.mark.parametrize("name", SCENES)
def test_shorter_vectors_compute_the_same(name: str, register: int, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = dataclasses.replace(SCENES[name], duration=0.05)
    wide = simulate(scene, record=WITH_FIELDS, threads=1)
    monkeypatch.setattr(module, "REGISTER", register)
    narrow = simulate(scene, record=WITH_FIELDS, threads=1)
    # Sums over a block are of other particles: rounding, which grows where grains collide.
    np.testing.assert_allclose(narrow.positions, wide.positions, atol=1e-4 * scene.domain.cell)
    assert narrow.summary["steps"] == wide.summary["steps"]
    assert narrow.summary["front"] == pytest.approx(wide.summary["front"], rel=1e-5)
    assert narrow.summary["energy"]["kinetic"][-1] == pytest.approx(wide.summary["energy"]["kinetic"][-1], rel=1e-4)
