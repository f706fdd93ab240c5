"""A file appears whole or stays as it was; one process writes into a folder; the memory that is free."""

import errno
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock

from datasets import memory
from datasets.command_line import run
from datasets.files import PART, remove_own_parts, replacing, write_json, write_text
from datasets.lock import HOLDER, LOCK, locked
from tests.refusals import refused


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


ROOT = Path(__file__).parents[2]
HOLD = "import sys; from pathlib import Path; from datasets.lock import locked\nwith locked(Path(sys.argv[1])): "


@contextmanager
def holding(folder: Path) -> Iterator["subprocess.Popen[str]"]:
    """A process that holds `folder` until it is killed."""
    code = f"{HOLD}print('held', flush=True); sys.stdin.read()"
    with subprocess.Popen(
        [sys.executable, "-c", code, str(folder)],
        cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def test_the_second_one_is_refused_and_knows_who_is_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def write(*, out: Path) -> None:
        """Write."""
        with locked(out):
            pytest.fail("both are in")

    with holding(tmp_path) as process:
        assert run(write, "write", ["--out", str(tmp_path)]) == 1
        error = capsys.readouterr().err
        assert error.startswith(f"talus: {tmp_path}: process {process.pid} on ")
        assert error.count("\n") == 1
        assert (tmp_path / HOLDER).read_text() in error


def test_the_lock_of_a_dead_process_is_free_and_its_parts_go(tmp_path: Path) -> None:
    with holding(tmp_path) as process:
        (tmp_path / f"{PART}a-x.npz").write_text("half")
        process.send_signal(signal.SIGKILL)
        process.wait()
        assert (tmp_path / HOLDER).exists()
        with locked(tmp_path):
            assert f"process {os.getpid()} on " in (tmp_path / HOLDER).read_text()
            assert sorted(path.name for path in tmp_path.iterdir()) == [LOCK, HOLDER]
    assert list(tmp_path.iterdir()) == []


def test_many_processes_are_in_one_after_another(tmp_path: Path) -> None:
    """Each adds one to a number, again and again where it is refused; the file of the lock comes and goes."""
    (tmp_path / "number").write_text("0")
    code = f"""
import time
from datasets.command_line import WorkFailed
from pathlib import Path
from datasets.lock import locked
done, number = 0, Path({str(tmp_path)!r}) / "number"
while done < 20:
    try:
        with locked(number.parent):
            number.write_text(str(int(number.read_text()) + 1))
            done += 1
    except WorkFailed:
        time.sleep(0.001)
"""
    processes = [subprocess.Popen([sys.executable, "-c", code], cwd=ROOT) for _ in range(3)]
    assert [process.wait(timeout=120.0) for process in processes] == [0, 0, 0]
    assert (tmp_path / "number").read_text() == "60"


def test_a_file_system_without_locks_is_stated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(FileLock, "acquire", refuse)
    with locked(tmp_path):
        assert (tmp_path / HOLDER).exists()
    assert "no locks on this file system" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_no_file_to_write_and_a_file_no_folder(tmp_path: Path) -> None:
    refused(write_json, tmp_path, {}, said="expected the name of a file to write, got a folder")
    (tmp_path / "file").write_text("")
    refused(write_json, tmp_path / "file" / "result.json", {}, said="file: expected a folder to write to")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_the_memory_that_is_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A container has less than its machine; more than is free is refused."""
    (tmp_path / "memory.max").write_text("1000000\n")
    (tmp_path / "memory.current").write_text("400000\n")
    monkeypatch.setattr(memory, "GROUP", tmp_path)
    assert memory.free() == 600_000
    (tmp_path / "memory.max").write_text("max\n")
    assert memory.free() > 600_000
    monkeypatch.setattr(memory, "free", lambda: 2**20)
    memory.require(0.8 * 2**20, "a thing", "less")
    said = "key: expected a thing in the 922 KiB of memory that are free, got 1 MiB: less"
    refused(memory.require, 2**20, "a thing", "less", key="key", said=said)
    refused(memory.require, float("nan"), "a thing", "less")
