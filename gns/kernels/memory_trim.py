"""Memory that was freed, given back: between states that stay, glibc keeps what the steps' activations took."""

import ctypes
from collections.abc import Callable
from typing import ParamSpec, TypeVar

TRIM_EVERY = 16
"""Calls between two trims.

A gradient of 1,000 points through 100 steps peaks at 333 MB without, at 171 MB in as much time with them, and at 122 MB
in a seventh more time with one at every fourth call.
"""

Given = ParamSpec("Given")
Result = TypeVar("Result")


def trimming(step: Callable[Given, Result]) -> Callable[Given, Result]:
    """`step`, which gives back what the process has freed every so many calls."""
    try:
        trim = ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):
        # Another C library, which may not need it.
        return step
    calls = 0

    def called(*arguments: Given.args, **named: Given.kwargs) -> Result:
        nonlocal calls
        calls += 1
        if calls % TRIM_EVERY == 0:
            trim(0)
        return step(*arguments, **named)

    return called
