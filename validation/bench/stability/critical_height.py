"""The height at which a vertical cut fails, by bisection, over the critical height of theory.

The soil's cohesion is changed and the scene kept, because the number gamma H / c alone decides. A cut has failed if
more than FAILED of it moved by a cell or more by the end: the wedge behind a cut as wide as it is high holds a quarter
of it, and what only falls off the face is less.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

from datasets.scene import Scene
from mpm import Recording, simulate
from mpm.exact_solutions import critical_height, stability_number
from validation.bench.stability.expectations import FAILED, moved_share

WITHIN = 1.025
"""How close the bounds of the bracket lie, one over the other."""
BETWEEN = (0.4, 1.6)
"""Heights over the critical one between which the bisection begins."""
CUTS = ("cut-critical-holds", "undrained-cut-holds")
"""Rows whose scene is bracketed for the page."""


@dataclass(frozen=True, kw_only=True)
class Bracket:
    """Heights over the critical one: the highest cut that held, the lowest that failed; nan where none did."""

    friction_deg: float
    tension: float
    """Tension limit over cohesion [-]."""
    holds: float
    fails: float
    runs: int


def fails(scene: Scene) -> bool:
    """Whether the cut of a scene has failed at its end."""
    ends = Recording(frames=scene.frames)
    return moved_share(simulate(scene, precision="f64", threads=1, record=ends)) >= FAILED


def at_ratio(scene: Scene, ratio: float) -> Scene:
    """The scene with such a cohesion that its height is `ratio` of the critical one, N c / gamma tan(45 + phi / 2)."""
    cohesion = scene.material.cohesion * scene.masses[0].size[1] / (critical_height(scene) * ratio)
    return dataclasses.replace(scene, material=dataclasses.replace(scene.material, cohesion=cohesion))


def bracket(scene: Scene, failed: Callable[[Scene], bool] = fails) -> Bracket:
    """Bisection in the logarithm of the height, from BETWEEN to WITHIN; both ends are tried first."""
    low, high = BETWEEN
    material = scene.material
    tension = material.tension_limit / material.cohesion
    found = Bracket(friction_deg=material.friction_deg, tension=tension, holds=low, fails=high, runs=2)
    if failed(at_ratio(scene, low)):
        return dataclasses.replace(found, holds=math.nan, fails=low, runs=1)
    if not failed(at_ratio(scene, high)):
        return dataclasses.replace(found, holds=high, fails=math.nan)
    while found.fails > WITHIN * found.holds:
        middle = math.sqrt(found.holds * found.fails)
        end = "fails" if failed(at_ratio(scene, middle)) else "holds"
        found = dataclasses.replace(found, runs=found.runs + 1, **{end: middle})
    return found


def bracket_row(found: Bracket) -> dict[str, object]:
    """A row of the page's table: measured and in theory, gamma H / c [-]."""
    number = stability_number(found.friction_deg, 0.0)
    return {
        "phi [°]": found.friction_deg,
        "holds [H / H critical]": found.holds,
        "fails [H / H critical]": found.fails,
        "gamma H / c": f"{found.holds * number:.2f} to {found.fails * number:.2f}",
        "in theory, without tension": number,
        f"with {found.tension:g} c": stability_number(found.friction_deg, found.tension),
        "runs": found.runs,
    }
