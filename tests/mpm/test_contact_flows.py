"""Contact of whole flows: an incline by two descriptions is one, a bed presses on a wall wherever its face lies."""

import math
from dataclasses import replace

import numpy as np
import pytest

from datasets.scene import Baffle, Domain, Mass, Scene, Solid
from datasets.scene.material import Material
from mpm import LAST, simulate_many
from tests.scenes import scene_of

SLOPE = math.radians(20.0)
CELL = 0.02
SAND = Material(friction_deg=30.0, density=1500.0, young=1.0e6, poisson=0.3)


def level(along: float, above: float) -> tuple[float, float]:
    """Coordinates in the level box [m] of a position along and above the incline [m]."""
    return (
        0.1 + along * math.cos(SLOPE) + above * math.sin(SLOPE),
        1.0 - along * math.sin(SLOPE) + above * math.cos(SLOPE),
    )


def on_incline(seed: int) -> tuple[Scene, Scene]:
    """The same sand runs down the floor of a tilted box, and down a polyline in a level one."""
    tilted = scene_of(
        Mass(lower=(0.2, 0.0), size=(0.3, 0.2)),
        size=(2.4, 0.5),
        cell=CELL,
        material=SAND,
        floor_friction=0.45,
        slope_deg=math.degrees(SLOPE),
        duration=0.8,
        frame_dt=0.01,
        step_fraction=0.9,
        seed=seed,
    )
    # A micrometre above the line, so that rounding leaves no corner below it.
    corners = tuple(level(x, y + 1.0e-6) for x, y in ((0.2, 0.0), (0.5, 0.0), (0.5, 0.2), (0.2, 0.2)))
    start = level(0.0, 0.0)[1]
    ends = ((0.0, start + 0.1 * math.tan(SLOPE)), (2.4, start - 2.3 * math.tan(SLOPE)))
    sloping = replace(
        tilted,
        domain=Domain(size=(2.4, 1.4), cell=CELL),
        masses=(Mass(kind="polygon", vertices=corners),),
        solids=(Solid(kind="terrain", points=ends, friction=0.45),),
        slope_deg=0.0,
        floor_friction=0.0,
    )
    return tilted, sloping


@pytest.mark.slow
def test_sand_runs_as_far_down_a_polyline_as_down_the_floor_of_a_tilted_box() -> None:
    downhill = np.array([math.cos(SLOPE), -math.sin(SLOPE)])
    pairs = [on_incline(seed) for seed in range(4)]
    tilted = [flow.positions[-1, :, 0] for flow in simulate_many([one for one, _ in pairs], record=LAST)]
    sloping = [
        (flow.positions[-1] - np.array(level(0.0, 0.0))) @ downhill
        for flow in simulate_many([other for _, other in pairs], record=LAST)
    ]
    # Without the last twentieth, which single particles make.
    far = [np.mean([np.quantile(x, 0.95) for x in some]) for some in (tilted, sloping)]
    assert far[1] == pytest.approx(far[0], rel=0.015)


@pytest.mark.slow
@pytest.mark.parametrize(("corrected", "spread"), [(False, 0.015), (None, 0.035)])
def test_a_bed_presses_on_a_smooth_baffle_alike_wherever_its_face_cuts_the_cells(
    corrected: bool | None, spread: float
) -> None:
    """356 to 358 N/m by contact alone, 359 to 368 with the gaps that are remembered by default."""

    def bed(offset: float) -> Scene:
        length = 0.4 + offset * CELL
        return scene_of(
            Mass(lower=(0.0, 0.0), size=(length, 0.3)),
            size=(1.0, 0.6),
            cell=CELL,
            baffles=(Baffle(lower=(length, 0.0), size=(0.2, 0.5)),),
            damping=0.05,
            step_fraction=0.9,
            frame_dt=0.01,
            volume_correction=corrected,
        )

    impulses = [flow.solid_impulse for flow in simulate_many([bed(0.1 * tenth) for tenth in range(10)])]
    found = [float(each[-1, 0, 0] - each[-31, 0, 0]) / 0.3 for each in impulses if each is not None]
    assert max(found) == pytest.approx(min(found), rel=spread)
    # At least as much as the confined elastic bed, nu / (1 - nu) of its weight; yielding adds to it.
    nu = 0.3
    elastic = 0.5 * nu / (1.0 - nu) * 1800.0 * 9.81 * 0.3**2
    assert min(found) == pytest.approx(elastic, rel=0.15)
