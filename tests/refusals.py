"""What is refused, in one line."""

from collections.abc import Callable

import pytest

from datasets.errors import InputError


def refused(do: Callable[..., object], *given: object, said: str = "") -> InputError:
    """The mistake that a call finds: one line that says this and what was expected."""
    with pytest.raises(InputError) as caught:
        do(*given)
    line = str(caught.value)
    assert said in line
    assert "expected" in line
    assert "\n" not in line
    return caught.value
