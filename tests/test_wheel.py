"""The wheel holds every module and every file that ships, and nothing else; installed elsewhere it works."""

import subprocess
import sys
import zipfile
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest

import datasets

ROOT = Path(__file__).parents[1]
PACKAGES = ("datasets", "gns", "inverse", "mpm", "validation")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from what git tracks and would track: what lies about in a work tree is no part of it."""
    folder = tmp_path_factory.mktemp("wheel")
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, check=True, capture_output=True, text=True,
    ).stdout.splitlines()  # fmt: skip
    for name in listed:
        if (ROOT / name).exists() and (name.startswith(PACKAGES) or "/" not in name):
            (folder / "source" / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / "source" / name).write_bytes((ROOT / name).read_bytes())
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*command, "--wheel-dir", str(folder), str(folder / "source")], check=True)
    (found,) = folder.glob("talus-*.whl")
    return found


@pytest.mark.slow
def test_the_wheel_holds_what_ships_and_works_elsewhere(wheel: Path, tmp_path: Path) -> None:
    source = wheel.parent / "source"
    paths = [path for name in PACKAGES for path in (source / name).rglob("*") if path.is_file()]
    with zipfile.ZipFile(wheel) as archive:
        found = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert found == {path.relative_to(source).as_posix() for path in paths}
    target = tmp_path / "installed"
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", str(target)]
    subprocess.run([*install, str(wheel)], check=True)
    environment = {"PYTHONPATH": str(target), "HOME": str(tmp_path), "PATH": "/usr/bin:/bin"}
    command = [sys.executable, "-P", str(ROOT / "tests" / "installed.py")]
    ended = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert "2 models" in ended.stdout


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


@pytest.mark.parametrize("package", ["mpm", "gns"])
def test_a_namesake_instead_of_us_is_stated(package: str, tmp_path: Path) -> None:
    (tmp_path / "datasets").mkdir()
    (tmp_path / "datasets" / "__init__.py").write_text("class Dataset: ...\n")
    code = f"import sys; sys.path[:0] = [{str(tmp_path)!r}, {str(ROOT)!r}]; import {package}"
    ended = subprocess.run(
        [sys.executable, "-P", "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 1
    assert (
        "Hugging Face's has the same name: install Talus in an environment of its own" in ended.stderr.splitlines()[-1]
    )
    assert str(tmp_path / "datasets") in ended.stderr.splitlines()[-1]
