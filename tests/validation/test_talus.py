"""`talus`: one name for the commands, with their exit statuses; what ships, a line each; packages that are hidden."""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from datasets.library import SCENES
from inverse.problem import PROBLEMS
from tests.commands import ROOT
from validation import talus


def talus_with(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int | str | None:
    """The exit status of `talus` with these arguments."""
    monkeypatch.setattr(sys, "argv", ["talus", *arguments])
    try:
        return talus.main()
    except SystemExit as ended:
        return ended.code


def test_every_command_is_a_module_that_is_run(monkeypatch: pytest.MonkeyPatch) -> None:
    ran = []
    monkeypatch.setattr(talus.runpy, "run_module", lambda name, **_: ran.append((name, sys.argv[1:])))
    for name, (module, _) in talus.MODULES.items():
        assert find_spec(module) is not None
        assert talus_with(monkeypatch, name, "--out", "x") == 0
        assert ran.pop() == (module, ["--out", "x"])


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("nix",), "talus: nix: expected one of run,"),
        (("scenes", "more"), "talus: scenes more: expected"),
        (("--nix",), "talus: --nix: expected"),
    ],
)
def test_a_mistake_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], line: str
) -> None:
    assert talus_with(monkeypatch, *arguments) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert line in said


def test_the_exit_status_is_that_of_the_module() -> None:
    command = [sys.executable, "-m", "validation.talus", "compare", "none", "other"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    (said,) = done.stderr.splitlines()
    assert "none: expected" in said


@pytest.mark.parametrize(("name", "folder"), [("scenes", SCENES), ("problems", PROBLEMS), ("designs", talus.DESIGNS)])
def test_what_ships_has_a_line_each(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str, folder: Path
) -> None:
    assert talus_with(monkeypatch, name) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == sorted(path.stem for path in folder.glob("*.toml"))
    for line in lines:
        stem, dimension, what = line.split(maxsplit=2)
        assert dimension == ("3D" if any(part in stem for part in ("baffles", "hillside", "valley")) else "2D")
        assert what[0].isupper() or what[0] == "`"
        assert 15 < len(what) < 200


def test_help_loads_no_solver() -> None:
    code = "import sys; from validation.talus import usage; usage(); print(*{'taichi', 'torch'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


@pytest.mark.parametrize("hidden", ["gns/__init__.py", "inverse.py"])
def test_a_package_that_a_folder_of_the_user_hides_is_said_in_a_line(tmp_path: Path, hidden: str) -> None:
    (tmp_path / hidden).parent.mkdir(exist_ok=True)
    (tmp_path / hidden).touch()
    code = f"import sys; sys.path[:0] = [{str(tmp_path)!r}, {str(ROOT)!r}]; import datasets"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    place = tmp_path / hidden.split("/")[0]
    assert f"{place} hides Talus's package `{place.stem}` here: rename it" in done.stderr
