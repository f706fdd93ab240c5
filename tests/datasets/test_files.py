"""A file appears whole or stays as it was."""

import errno
import json
import os
import tempfile
from pathlib import Path
from typing import Any

import pytest

from datasets.files import PART, remove_own_parts, replacing, write_json, write_text


def test_a_failing_block_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "result.txt"
    path.write_text("old")

    def interrupted() -> None:
        with replacing(path) as part:
            part.write_text("half of the n")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_the_bytes_are_on_the_disk_before_the_name_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine may die at any moment: the file is flushed, then moved, then its name is."""
    path, order = tmp_path / "result.txt", []
    sync, move = os.fsync, Path.replace
    monkeypatch.setattr(
        os, "fsync", lambda handle: (order.append(Path(f"/proc/self/fd/{handle}").resolve()), sync(handle))
    )
    monkeypatch.setattr(Path, "replace", lambda part, to: (order.append("move"), move(part, to))[1])
    write_text(path, "new")
    part, moved, folder = order
    assert part.name.startswith(PART)
    assert (moved, folder) == ("move", tmp_path)


def test_a_process_that_is_ended_removes_what_it_was_writing_and_no_other_s(tmp_path: Path) -> None:
    other = tmp_path / f"{PART}other.txt"
    other.write_text("half")

    def write() -> None:
        with replacing(tmp_path / "a.txt") as part:
            part.write_text("half")
            remove_own_parts()
            assert list(tmp_path.iterdir()) == [other]

    with pytest.raises(FileNotFoundError):
        write()
    assert list(tmp_path.iterdir()) == [other]


@pytest.mark.parametrize("number", [1, 2, 3])
def test_a_full_disk_leaves_the_old_file_and_names_it(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the call `number` of those that may find the disk full: to make the part, to flush it, to flush the folder."""
    path, calls = tmp_path / "result.txt", []
    path.write_text("old")

    def full(function: Any) -> Any:
        def call(*given: Any, **flags: Any) -> Any:
            calls.append(None)
            if len(calls) == number:
                raise OSError(errno.ENOSPC, "No space left on device")
            return function(*given, **flags)

        return call

    monkeypatch.setattr(tempfile, "mkstemp", full(tempfile.mkstemp))
    monkeypatch.setattr(os, "fsync", full(os.fsync))
    with pytest.raises(OSError, match="No space left") as caught:
        write_text(path, "new")
    assert caught.value.filename == str(path)
    # Once it has been moved the name is the new file's.
    assert path.read_text() == ("new" if number == 3 else "old")
    assert list(tmp_path.iterdir()) == [path]


def test_json_has_no_nan(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    write_json(path, {"loss": [float("nan"), 0.5], "best": (float("inf"), 1)})
    assert json.loads(path.read_text(), parse_constant=pytest.fail) == {"loss": [None, 0.5], "best": [None, 1]}
