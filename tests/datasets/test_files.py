"""A file appears whole or stays as it was; one process writes into a folder; the memory that is free."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from datasets import memory
from datasets.command_line import run
from datasets.files import PART, replacing, write_json
from datasets.lock import HOLDER, LOCK, locked
from tests.refusals import refused

ROOT = Path(__file__).parents[2]
HOLD = """import sys; from pathlib import Path; from datasets.lock import locked
with locked(Path(sys.argv[1])): print('held', flush=True); sys.stdin.read()"""


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


def test_json_has_no_nan(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    write_json(path, {"loss": [float("nan"), 0.5], "best": (float("inf"), 1)})
    assert json.loads(path.read_text(), parse_constant=pytest.fail) == {"loss": [None, 0.5], "best": [None, 1]}


@contextmanager
def holding(folder: Path) -> Iterator["subprocess.Popen[str]"]:
    """A process that holds `folder` until it is killed."""
    command, pipe = [sys.executable, "-c", HOLD, str(folder)], subprocess.PIPE
    with subprocess.Popen(command, cwd=ROOT, stdin=pipe, stdout=pipe, text=True) as process:
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
        with suppress(KeyboardInterrupt), locked(tmp_path):
            assert f"process {os.getpid()} on " in (tmp_path / HOLDER).read_text()
            assert sorted(path.name for path in tmp_path.iterdir()) == [LOCK, HOLDER]
            (tmp_path / f"{PART}b-x.npz").write_text("half, by a worker that the same signal has ended")
            raise KeyboardInterrupt
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
