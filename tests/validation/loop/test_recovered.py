"""Two baffles and three layers of small scenes, found by the MPM itself."""

from typing import Any

import pytest

from datasets import Baffle, Mass, Material, Scene
from inverse import Parameter, Problem, Result, TargetSettings
from inverse.answer import Verdict
from inverse.observations import DepositSettings, ObservationSettings, ProfileSettings
from inverse.settings import Surrogate
from tests.scenes import scene_of
from validation.loop.solve import solve

pytestmark = pytest.mark.slow

BOX: dict[str, Any] = {"size": (1.0, 0.3), "material": Material(friction_deg=30.0, young=5.0e5), "floor_friction": 0.4}


def recovered(
    scene: Scene, middles: dict[str, float], width: float, seen: ObservationSettings, truth: dict[str, float]
) -> Result:
    """What the loop finds of a twin experiment; middles: of the bounds, which are so far apart."""
    problem = Problem(
        name="small",
        scene=scene,
        parameters=tuple(
            Parameter(name=name, initial=middle, lower=middle - 0.5 * width, upper=middle + 0.5 * width)
            for name, middle in middles.items()
        ),
        observations=(seen,),
        target=TargetSettings(twin=True, truth=truth),
        surrogate=Surrogate.NONE,
    )
    result = solve(problem)
    assert result.verdict is Verdict.CONFIRMED
    for name, value in truth.items():
        assert abs(result.unknowns[name] - value) < 2.0 * result.certainty[name], name
    return result


def test_three_layers_have_their_velocities() -> None:
    truth = {f"masses[{row}].velocity_x": 0.9 - 0.3 * row for row in range(3)}
    masses = [Mass(lower=(0.0, 0.06 * row), size=(0.3, 0.06), velocity=(0.0, 0.0)) for row in range(3)]
    scene = scene_of(*masses, duration=0.2, step_fraction=0.9, **BOX)
    result = recovered(scene, dict.fromkeys(truth, 0.5), 2.0, DepositSettings(), truth)
    assert max(result.certainty.values()) < 0.2


def test_two_baffles_have_their_places() -> None:
    body = Mass(lower=(0.0, 0.0), size=(0.2, 0.2), velocity=(2.0, 0.0))
    baffles = tuple(Baffle(lower=(x, 0.0), size=(0.04, 0.05)) for x in (0.36, 0.66))
    truth = {"baffles[0].x": 0.42, "baffles[1].x": 0.68}
    scene = scene_of(body, baffles=baffles, duration=0.6, step_fraction=0.9, **BOX)
    result = recovered(scene, {"baffles[0].x": 0.38, "baffles[1].x": 0.68}, 0.16, ProfileSettings(), truth)
    assert max(result.certainty.values()) < 0.04
