"""Another package of the name of one of ours, beside Talus or in its place, is stated in a line."""

import subprocess
import sys
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest

import datasets
from tests.commands import ROOT


def test_a_namesake_beside_us_is_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    class Theirs:
        version = "4.0.0"

    def nothing(_: str) -> Theirs:
        raise PackageNotFoundError

    monkeypatch.setattr(datasets, "distribution", nothing)
    datasets._warn_of_namesake()
    monkeypatch.setattr(datasets, "distribution", lambda _: Theirs())
    with pytest.warns(UserWarning, match=r"^Hugging Face's datasets 4\.0\.0 is installed beside Talus"):
        datasets._warn_of_namesake()


@pytest.mark.parametrize(
    ("hidden", "module", "said"),
    [
        ("datasets/__init__.py", "mpm", "has the same name: install Talus in an environment of its own"),
        ("gns/__init__.py", "datasets", "hides Talus's package `gns` here: rename it"),
        ("inverse.py", "datasets", "hides Talus's package `inverse` here: rename it"),
    ],
)
def test_a_namesake_instead_of_ours_is_stated(tmp_path: Path, hidden: str, module: str, said: str) -> None:
    (tmp_path / hidden).parent.mkdir(exist_ok=True)
    (tmp_path / hidden).touch()
    code = f"import sys; sys.path[:0] = [{str(tmp_path)!r}, {str(ROOT)!r}]; import {module}"
    command = [sys.executable, "-P", "-c", code]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.returncode == (1 if module == "mpm" else 0)
    assert said in ended.stderr
    assert str(tmp_path / hidden.split("/")[0]) in ended.stderr
