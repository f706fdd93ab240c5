"""The height at which a vertical cut fails, by bisection, over the critical height of theory.

`python -m validation.bench.stability.critical_height SCENE`: the soil's cohesion is changed and the scene kept, because the
number gamma H / c alone decides. A cut has failed if more than FAILED of it moved by a cell or more by the end: the
wedge behind a cut as wide as it is high holds a quarter of it, and what only falls off the face is less.
"""

import dataclasses
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass

from datasets.command_line import run
from datasets.library import read_scene
from datasets.scene import Scene
from mpm import simulate
from validation.bench.stability.case import SCENES
from validation.bench.stability.expectations import FAILED, critical_height, moved_share

WITHIN = 1.025
"""How close the bounds of the bracket lie, one over the other."""
BETWEEN = (0.4, 1.6)
"""Heights over the critical one between which the bisection begins."""
CRITICAL = ("cut-critical-holds", "undrained-cut-holds")
"""Rows whose scene is bracketed for the page."""
SCENE = str(SCENES / "cut-critical-holds.toml")


@dataclass(frozen=True, kw_only=True)
class Bracket:
    """Heights over the critical one: the highest cut that held, the lowest that failed; nan where none did."""

    friction_deg: float
    tension: float = 0.0
    """Tension limit over cohesion [-]."""
    holds: float
    fails: float
    runs: int

    @property
    def sentence(self) -> str:
        """What was found, for the page."""
        number = 2.0 * math.tan(math.radians(45.0 + 0.5 * self.friction_deg))
        return (
            f"phi = {self.friction_deg:g}°: a cut of {self.holds:.2f} of the critical height holds, one of "
            f"{self.fails:.2f} fails ({self.runs} runs); gamma H / c between {self.holds * number:.2f} and "
            f"{self.fails * number:.2f}, in theory {number:.2f} without tension and "
            f"{number_with_tension(self.friction_deg, self.tension):.2f} with {self.tension:g} c."
        )


def number_with_tension(friction_deg: float, tension: float) -> float:
    """Gamma H / c of a slice beside the face that is held over its crack by `tension`, over c [-]; 2 t without it.

    With t = tan(45 + phi / 2) the root h of h = 2 t + t sqrt(2 T h / c) - t^2 T / c (`datasets.material`).
    """
    t = math.tan(math.radians(45.0 + 0.5 * friction_deg))
    half = 0.5 * t * math.sqrt(2.0 * tension)
    return (half + math.sqrt(half**2 + 2.0 * t - t**2 * tension)) ** 2


def fails(scene: Scene) -> bool:
    """Whether the cut of a scene has failed at its end."""
    return moved_share(simulate(scene, precision="f64", threads=1)) >= FAILED


def at_ratio(scene: Scene, ratio: float) -> Scene:
    """The scene with such a cohesion that its height is `ratio` of the critical one, N c / gamma tan(45 + phi / 2)."""
    cohesion = scene.material.cohesion * scene.masses[0].size[1] / (critical_height(scene) * ratio)
    return dataclasses.replace(scene, material=dataclasses.replace(scene.material, cohesion=cohesion))


def bracket(scene: Scene, judge: Callable[[Scene], bool] = fails) -> Bracket:
    """Bisection in the logarithm of the height, from BETWEEN to WITHIN; both ends are tried first."""
    low, high = BETWEEN
    material = scene.material
    tension = material.tension_limit / material.cohesion
    found = Bracket(friction_deg=material.friction_deg, tension=tension, holds=low, fails=high, runs=2)
    if judge(at_ratio(scene, low)):
        return dataclasses.replace(found, holds=math.nan, fails=low, runs=1)
    if not judge(at_ratio(scene, high)):
        return dataclasses.replace(found, holds=high, fails=math.nan)
    while found.fails > WITHIN * found.holds:
        middle = math.sqrt(found.holds * found.fails)
        failed = judge(at_ratio(scene, middle))
        found = dataclasses.replace(found, runs=found.runs + 1, **{"fails" if failed else "holds": middle})
    return found


def command(scene: str = SCENE) -> None:
    """Bracket the critical height of a vertical cut.

    Parameters
    ----------
    scene
        Scene file of a cut; its cohesion is changed.
    """
    given = read_scene(scene)
    print(bracket(given).sentence)


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.bench.stability.critical_height"))
