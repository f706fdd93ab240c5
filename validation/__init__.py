"""Validation: the loop in which the MPM confirms or refuses an inversion, experiments, and benchmarks.

from inverse import plot
from validation import solve

result = solve("friction-tall-42", "out/loop")
print(result.verdict, result.unknowns, result.interval)
plot(result).savefig("found.png")
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

import mpm  # noqa: F401  (which knows whether the package datasets is Talus's)

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


def __getattr__(name: str) -> Any:
    """Import on first use: benchmarks import this package too, and torch and matplotlib take seconds."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
