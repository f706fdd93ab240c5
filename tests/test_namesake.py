"""Another package of the name `datasets`, beside Talus or in its place, is stated."""

import subprocess
import sys
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest

import datasets

ROOT = Path(__file__).parents[1]


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


def test_a_namesake_instead_of_us_is_stated(tmp_path: Path) -> None:
    (tmp_path / "datasets").mkdir()
    (tmp_path / "datasets" / "__init__.py").write_text("class Dataset: ...\n")
    code = f"import sys; sys.path[:0] = [{str(tmp_path)!r}, {str(ROOT)!r}]; import mpm"
    ended = subprocess.run(
        [sys.executable, "-P", "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 1
    assert (
        "Hugging Face's has the same name: install Talus in an environment of its own" in ended.stderr.splitlines()[-1]
    )
    assert str(tmp_path / "datasets") in ended.stderr.splitlines()[-1]
