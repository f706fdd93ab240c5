"""Validation: the loop in which the MPM confirms or refuses an inversion; experiments; benchmarks.

from inverse import plot
from validation import solve

result = solve("friction-tall-42", "out/loop")
print(result.verdict, result.unknowns, result.interval)
plot(result).savefig("found.png")
"""

from typing import TYPE_CHECKING

import mpm  # noqa: F401  (which knows whether the package datasets is Talus's)
from datasets import lazily

if TYPE_CHECKING:
    from inverse.result import Result
    from validation.design.solve import find_design
    from validation.forecast.solve import forecast_scene
    from validation.loop.series import solve_series
    from validation.loop.solve import solve

_MODULES = {
    "Result": "inverse.result",
    "find_design": "validation.design.solve",
    "forecast_scene": "validation.forecast.solve",
    "solve": "validation.loop.solve",
    "solve_series": "validation.loop.series",
}

__all__ = ["Result", "find_design", "forecast_scene", "solve", "solve_series"]

__getattr__, __dir__ = lazily("validation", _MODULES)
