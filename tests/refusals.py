"""What is refused, in one line."""

from collections.abc import Callable
from typing import Any

import pytest

from datasets import InputError, command_line


def refused(do: Callable[..., object], *given: object, said: str = "", **named: object) -> InputError:
    """The mistake that a call finds: one line that says this and what was expected."""
    with pytest.raises(InputError) as caught:
        do(*given, **named)
    line = str(caught.value)
    assert said in line
    assert "expected" in line
    assert "\n" not in line
    return caught.value


def refused_by(capsys: pytest.CaptureFixture[str], command: Callable[..., Any], *arguments: object) -> str:
    """What a command says of wrong input, in one line, before it ends with status 2."""
    capsys.readouterr()
    assert command_line.run(command, "command", list(map(str, arguments))) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("talus: ")]
    return line
