"""The memory that is free, and what is refused for want of it."""

from pathlib import Path

import pytest

from datasets import memory
from datasets.errors import InputError


def test_a_container_has_less(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "memory.max").write_text("1000000\n")
    (tmp_path / "memory.current").write_text("400000\n")
    monkeypatch.setattr(memory, "GROUP", tmp_path)
    assert memory.free() == 600_000
    (tmp_path / "memory.max").write_text("max\n")
    assert memory.free() > 600_000


def test_more_than_is_free_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "free", lambda: 2**20)
    memory.require(0.8 * 2**20, "a thing", "less")
    with pytest.raises(
        InputError, match="key: expected a thing in the 922 KiB of memory that are free, got 1 MiB: less"
    ):
        memory.require(2**20, "a thing", "less", key="key")
    with pytest.raises(InputError):
        memory.require(float("nan"), "a thing", "less")
