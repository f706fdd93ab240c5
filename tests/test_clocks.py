"""Budgets and durations are measured by clocks that do not jump when somebody sets the time."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("datasets", "mpm", "gns", "inverse", "validation")
WALL = {"time.time", "time.time_ns", "datetime.now", "datetime.utcnow", "datetime.datetime.now", "datetime.today"}
SHOWN = {"datasets/lock.py"}
"""Modules that name a time to people."""


def wall_clocks(text: str) -> Iterator[str]:
    """Calls that ask for the time of day, with their lines."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Call) and ast.unparse(node.func) in WALL:
            yield f"{node.lineno}: {ast.unparse(node)}"
        if (
            isinstance(node, ast.ImportFrom)
            and node.module == "time"
            and any(each.name == "time" for each in node.names)
        ):
            yield f"{node.lineno}: {ast.unparse(node)}"


@pytest.mark.parametrize("folder", FOLDERS)
def test_nothing_is_measured_by_the_time_of_day(folder: str) -> None:
    found = {
        path.relative_to(ROOT).as_posix(): lines
        for path in (ROOT / folder).rglob("*.py")
        if (lines := list(wall_clocks(path.read_text(encoding="utf-8"))))
    }
    assert found.keys() <= SHOWN


def test_the_time_of_day_is_seen() -> None:
    assert len(list(wall_clocks("import time\nfrom time import time\nbegan = time.time()"))) == 2
