"""The models that ship beside the MPM: front, mean height and thickness of the deposits of two scenes each.

`shipped.json` has the MPM's deposits, each found by

    figures(mpm.simulate(name, record=mpm.LAST), column)

of this file, on the cells of the scene, in single precision.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gns
from datasets import Trajectory, read_scene
from datasets.flow import measures
from gns import card
from gns.library import shipped

MPM: dict[str, dict[str, Any]] = json.loads((Path(__file__).parent / "shipped.json").read_text())
BANDS = 2.0
"""Fronts lie within so many of the 95 % bands of the model's card: the MPM that it learned from has finer cells."""
HEIGHT, THICKNESS = 0.1, {2: 0.1, 3: 0.25}
"""Largest error of the mean height over the MPM's, and of the thickness (rms) over its largest, by dimension [-]."""


def figures(flow: Trajectory, column: float) -> dict[str, Any]:
    """Ends [m], mean height [m] and thickness in columns of the plan [m] of a deposit; column: their width [m]."""
    scene, volumes = flow.scene, flow.volumes
    raised = measures.above(flow.positions[-1], measures.ground_of(scene))
    spacing = measures.particle_spacing(volumes, scene.dimension)
    thickness = measures.thickness(raised, spacing, column, scene.domain.size[::2])
    return {
        "ends": measures.ends(raised, volumes),
        "height": measures.mean_height(raised, volumes),
        "column": column,
        "thickness": thickness.round(4).tolist(),
    }


@pytest.mark.parametrize("name", MPM)
def test_a_shipped_model_is_as_near_to_the_mpm_as_its_card_says(name: str) -> None:
    scene, expected = read_scene(name), MPM[name]
    known = card.read(shipped(scene.dimension))
    band = known.calibration(scene)
    found = figures(gns.simulate(scene), expected["column"])
    rear, front = expected["ends"]
    assert found["ends"][1] == pytest.approx(front, abs=BANDS * band.front["0.95"] * (front - rear))
    assert found["height"] == pytest.approx(expected["height"], rel=HEIGHT)
    thickness = np.array(expected["thickness"])
    apart = measures.thickness_apart(thickness, np.array(found["thickness"]))
    assert apart < THICKNESS[scene.dimension] * thickness.max()
