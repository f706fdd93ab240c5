"""Which of many choices are worth their price."""

from collections.abc import Callable, Sequence
from typing import TypeVar

T = TypeVar("T")


def front(choices: Sequence[T], cost: Callable[[T], float], error: Callable[[T], float]) -> list[T]:
    """The choices that no other beats in both cost and error, the cheapest first; of equals the first."""
    kept: list[T] = []
    for choice in sorted(choices, key=lambda each: (cost(each), error(each))):
        if not kept or error(choice) < error(kept[-1]):
            kept.append(choice)
    return kept
