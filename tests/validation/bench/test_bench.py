"""The dispatcher: names, a list, one line for a wrong name."""

import importlib
import inspect

import pytest

from datasets.command_line import run
from validation.bench.__main__ import BENCHES, command


def test_every_name_has_a_module_that_can_be_run() -> None:
    for bench in BENCHES.values():
        parameters = inspect.signature(importlib.import_module(bench.module).bench).parameters
        assert next(iter(parameters)) == "out"
        assert {"quick", "keep"} <= parameters.keys()


def test_names_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(command, "bench", ["--list"]) == 0
    assert "experiments: " in capsys.readouterr().out


@pytest.mark.parametrize("arguments", [[], ["experiment"]])
def test_a_wrong_name_takes_one_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(command, "bench", arguments) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "experiments" in error
