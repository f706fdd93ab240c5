"""`python -m validation.bench faults`: what is found is counted, what is wrong shows, and nothing is measured twice."""

from pathlib import Path

import pytest

from datasets.command_line import WorkFailed
from validation.bench.__main__ import main
from validation.bench.faults.bench import Found, Worker, page
from validation.bench.faults.breaking import Full, Killed, members, mounted, unfinished, used
from validation.bench.faults.commands import timeless

GOOD = Killed(moment=0.5, working=True, orphans=0, last_s=0.1, left=0, same=True)
BAD = Killed(moment=0.7, working=True, orphans=2, last_s=5.0, left=1, same=False)
LATE = Killed(moment=0.9, working=False, orphans=0, last_s=0.0, left=0, same=True)
FULL = Full(size=1000, full=True, stated=True, left=0, same=True)
LARGE_ENOUGH = Full(size=9000, full=False, stated=False, left=0, same=True)
SILENT = Full(size=2000, full=True, stated=False, left=1, same=False)


def test_the_page_counts_what_was_lost() -> None:
    found = Found(
        title="`it`",
        killed=[GOOD, BAD, LATE],
        full=[FULL, LARGE_ENOUGH, SILENT],
        workers=[Worker(moment=0.5, same=True)],
    )
    conclusion = page([found], quick=False).conclusion
    assert "2 kills (SIGKILL) of 1 commands in the middle of their work: 1 had the same results" in conclusion
    assert "Processes left 5 s after a kill: 2; the last one of all ended 5.00 s after it." in conclusion
    assert "Unfinished files or locks left: 2." in conclusion
    assert "2 full disks: 1 were stated in one line with exit status 1, 1 had the same results" in conclusion
    assert "1 kills of a scheduler's worker: 1 runs" in conclusion


def test_what_is_left_behind_is_seen(tmp_path: Path) -> None:
    for name in ("a.npz", ".part-a-x.npz", "deep/.part-b.json", ".talus-lock", ".talus-lock.json", ".hidden"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("x")
    assert len(unfinished(tmp_path)) == 4
    assert used(tmp_path) == 6 * 4096
    assert members(-1) == []


def test_seconds_are_no_part_of_a_result() -> None:
    result = {"runs": [{"seconds": 1.0, "share_s": 2.0, "front": 3.0}], "mpm_seconds": 1.0, "misfit": 2.0}
    assert timeless(result) == {"runs": [{"front": 3.0}], "misfit": 2.0}


def test_a_disk_that_may_not_be_mounted_is_a_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(WorkFailed, match="mount"), mounted(tmp_path / "disk", 4096):
        pass


@pytest.mark.parametrize("flags", [["--only", "nothing"], ["--moments", "0"], ["--disks", "0"]])
def test_wrong_flags_are_one_line(flags: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["faults", "--out", str(tmp_path), *flags]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.slow
def test_a_kill_of_a_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["faults", "--out", str(tmp_path), "--keep", str(tmp_path / "keep"), "--quick"]
    assert main(arguments) == 0
    said = capsys.readouterr().out
    assert "1 kills (SIGKILL) of 1 commands in the middle of their work: 1 had the same results" in said
    assert "Processes left 5 s after a kill: 0;" in said
