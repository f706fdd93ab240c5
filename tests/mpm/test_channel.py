"""Side walls of a channel in 2D: a block between them, and sand as it flows between walls in 3D."""

import dataclasses
import math
from functools import partial

import pytest

from datasets import Channel, Mass, Material
from mpm import LAST, simulate
from tests.refusals import refused
from tests.scenes import box
from validation.bench.stability.exact_solutions import SlidingBlock, centre_displacement

BLOCK = Material(friction_deg=45.0, cohesion=1.0e9, tension_cutoff=1.0e9, poisson=0.3, young=1.0e7)
"""Too strong to yield: an elastic solid."""


@pytest.mark.parametrize(("friction_deg", "floor"), [(0.0, 0.1), (20.0, 0.1), (20.0, 0.0), (60.0, 0.1)])
def test_a_block_slides_between_walls(friction_deg: float, floor: float) -> None:
    """a = g sin - mu_f g cos - (2 mu_w / W) nu g cos h / 2, at least 0: -sigma_zz is nu times the weight above."""
    body, channel = Mass(lower=(0.1, 0.0), size=(0.3, 0.2)), Channel(width=0.08, friction_deg=friction_deg)
    incline = {"slope_deg": 20.0, "floor_friction": floor, "duration": 0.3, "jitter": 0.0}
    scene = box(body, material=BLOCK, channel=channel, **incline)
    slid = centre_displacement(simulate(scene))[-1, 0]
    assert slid == pytest.approx(SlidingBlock.of_scene(scene).displacement(0.3), abs=0.01 * 0.5 * 9.81 * 0.3**2)


@pytest.mark.slow
def test_sand_in_a_channel_flows_as_between_walls_in_three_dimensions() -> None:
    """The front of a column in a channel six cells wide, within 3 % of that in 3D; without walls it goes further."""
    width, sand, angle = 0.12, Material(friction_deg=30.0, young=1.0e6), 15.0
    flow = partial(box, floor_friction=0.5, duration=0.5, material=sand)
    flat = flow(Mass(lower=(0.0, 0.0), size=(0.2, 0.3)), size=(1.2, 0.4))
    body, side = Mass(lower=(0.0, 0.0, 0.0), size=(0.2, 0.3, width)), math.tan(math.radians(angle))
    deep = flow(body, size=(1.2, 0.4, width), wall_friction=side)
    walled = dataclasses.replace(flat, channel=Channel(width=width, friction_deg=angle))
    fronts = [float(simulate(scene, record=LAST).summary["front"]) for scene in (flat, walled, deep)]
    assert fronts[1] == pytest.approx(fronts[2], rel=0.03)
    assert fronts[0] > 1.06 * fronts[2]


@pytest.mark.parametrize(
    ("key", "channel", "size"),
    [
        ("channel", {"width": 0.1, "friction_deg": 20.0}, (1.0, 1.0, 1.0)),
        ("width", {"width": 0.0, "friction_deg": 20.0}, (1.0, 1.0)),
        ("friction_deg", {"width": 0.1, "friction_deg": 90.0}, (1.0, 1.0)),
    ],
)
def test_what_is_no_channel_is_refused(key: str, channel: dict[str, float], size: tuple[float, ...]) -> None:
    mass = Mass(lower=(0.0,) * len(size), size=(0.2,) * len(size))
    assert refused(lambda: box(mass, size=size, channel=Channel(**channel))).key == key
