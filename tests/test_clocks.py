"""Budgets and durations are measured by clocks that do not jump when somebody sets the time."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = ("datasets", "mpm", "gns", "inverse", "validation")
WALL = re.compile(r"\btime\.time(_ns)?\(|^from time import .*\btime\b|\bdatetime\.(now|utcnow|today)\(", re.MULTILINE)
SHOWN = {"datasets/lock.py"}
"""Modules that name a time to people."""


def test_nothing_is_measured_by_the_time_of_day() -> None:
    assert len(WALL.findall("import time\nfrom time import sleep, time\nbegan = time.time()")) == 2
    sources = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")]
    found = {path.relative_to(ROOT).as_posix() for path in sources if WALL.search(path.read_text(encoding="utf-8"))}
    assert found <= SHOWN
