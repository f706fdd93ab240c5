"""Validation: the loop in which the MPM confirms or refuses an inversion, experiments, and benchmarks.

from validation import solve

result = solve("friction-tall-42", "out/loop")
print(result.verdict, result.unknowns, result.certainty)
result.plot().savefig("found.png")
"""

from typing import TYPE_CHECKING, Any

import mpm  # noqa: F401  (which knows whether the package datasets is Talus's)

if TYPE_CHECKING:
    from inverse.result import Result
    from validation.loop.series import solve_series
    from validation.loop.solve import solve

__all__ = ["Result", "solve", "solve_series"]


def __getattr__(name: str) -> Any:
    # Benchmarks import this package too; torch and matplotlib take seconds.
    if name == "solve":
        from validation.loop.solve import solve

        return solve
    if name == "solve_series":
        from validation.loop.series import solve_series

        return solve_series
    if name == "Result":
        from inverse.result import Result

        return Result
    raise AttributeError(name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
