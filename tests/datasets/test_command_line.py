"""Exit statuses: 0 done, 1 the work failed, 2 the input is wrong, 130 and 143 interrupted; mistakes in one line."""

import errno
import signal
from pathlib import Path

import pytest

from datasets.command_line import WorkFailed, run
from datasets.errors import InputError


def command(scene: str, *, out: Path, count: int = 1) -> int | None:
    """Do what `scene` says."""
    match scene:
        case "wrong":
            raise InputError("expected better", where="scene.toml", key="masses[0]")
        case "failing":
            raise WorkFailed("the points left the domain")
        case "interrupted":
            raise KeyboardInterrupt
        case "terminated":
            signal.raise_signal(signal.SIGTERM)
        case "full":
            raise OSError(errno.ENOSPC, "No space left on device", "out/a.npz")
        case "status":
            return 1
    return None


@pytest.mark.parametrize(
    ("arguments", "status", "line"),
    [
        (["good", "--out", "x"], 0, ""),
        (["status", "--out", "x"], 1, ""),
        (["failing", "--out", "x"], 1, "talus: the points left the domain\n"),
        (["wrong", "--out", "x"], 2, "talus: scene.toml: masses[0]: expected better\n"),
        (["interrupted", "--out", "x"], 130, "talus: interrupted; what was finished is kept\n"),
        (["terminated", "--out", "x"], 143, "talus: interrupted; what was finished is kept\n"),
        (["full", "--out", "x"], 1, "talus: out/a.npz: No space left on device; what was finished is kept\n"),
        (["good"], 2, "--out"),
        (["good", "--out", "x", "--cuont", "3"], 2, "--count"),
        (["good", "--out", "x", "--count", "few"], 2, "few"),
    ],
)
def test_exit_status(arguments: list[str], status: int, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(command, "do", arguments) == status
    error = capsys.readouterr().err
    assert line in error
    assert error.count("\n") == (1 if line else 0)


@pytest.mark.parametrize("mistake", [ZeroDivisionError(), FileNotFoundError(errno.ENOENT, "No such file", "a.npz")])
def test_a_mistake_of_ours_keeps_its_traceback(mistake: Exception) -> None:
    def broken() -> None:
        """Fail."""
        raise mistake

    with pytest.raises(type(mistake)):
        run(broken, "do", [])


def test_sigterm_is_the_callers_again_afterwards() -> None:
    before = signal.getsignal(signal.SIGTERM)
    assert run(command, "do", ["good", "--out", "x"]) == 0
    assert signal.getsignal(signal.SIGTERM) == before
