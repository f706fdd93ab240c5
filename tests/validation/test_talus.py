"""`talus`: one name for all commands, whose functions they share; what ships, a line each; packages that are hidden."""

import subprocess
import sys
from pathlib import Path

import pytest

from datasets.scene.library import SCENES
from inverse.problem import PROBLEMS
from tests.commands import ROOT, found_at
from validation import talus
from validation.talus import COMMANDS


def modules() -> set[str]:
    """Every module of ours that runs as `python -m`."""
    folders = [ROOT / name for name in ("datasets", "mpm", "gns", "inverse", "validation")]
    files = [
        path for folder in folders for path in folder.rglob("*.py") if '__name__ == "__main__"' in path.read_text()
    ]
    return {".".join(path.relative_to(ROOT).with_suffix("").parts) for path in files}


def test_talus_has_every_command_and_calls_the_same_function() -> None:
    ours = {place: name for name, (place, _) in COMMANDS.items() if name not in ("scenes", "problems", "designs")}
    assert {place.split(":")[0] for place in ours} == modules() - {"validation.talus"}
    for place in ours:
        module, attribute = place.split(":")
        (path,) = ROOT.glob(f"{module.replace('.', '/')}.py")
        called = f'run({attribute}, "python -m {module.removesuffix(".__main__")}"'
        assert called in path.read_text(), place
        assert found_at(place)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("nix",), 'talus: Unknown command "nix"'),
        (("scenes", "more"), "more"),
        (("--nix",), 'talus: Unknown command "--nix"'),
        (("bench", "nix"), "experiments"),
        (("compare", "none", "other"), "none: expected"),
    ],
)
def test_a_mistake_is_one_line(capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], line: str) -> None:
    assert talus.main(arguments) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert line in said


@pytest.mark.parametrize(("name", "folder"), [("scenes", SCENES), ("problems", PROBLEMS), ("designs", talus.DESIGNS)])
def test_what_ships_has_a_line_each(capsys: pytest.CaptureFixture[str], name: str, folder: Path) -> None:
    assert talus.main([name]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == sorted(path.stem for path in folder.glob("*.toml"))
    for line in lines:
        stem, dimension, what = line.split(maxsplit=2)
        assert dimension == ("3D" if any(part in stem for part in ("baffles", "hillside", "valley")) else "2D")
        assert what[0].isupper() or what[0] == "`"
        assert 15 < len(what) < 200


def test_help_loads_no_solver() -> None:
    code = (
        "import sys; from validation.talus import main; main(['--help']); print({'taichi', 'torch'} & {*sys.modules})"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "set()"
    assert all(f" {name} " in done.stdout for name in COMMANDS)


@pytest.mark.parametrize("hidden", ["gns/__init__.py", "inverse.py"])
def test_a_package_that_a_folder_of_the_user_hides_is_said_in_a_line(tmp_path: Path, hidden: str) -> None:
    (tmp_path / hidden).parent.mkdir(exist_ok=True)
    (tmp_path / hidden).touch()
    code = f"import sys; sys.path[:0] = [{str(tmp_path)!r}, {str(ROOT)!r}]; import datasets"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    place = tmp_path / hidden.split("/")[0]
    assert f"{place} hides Talus's package `{place.stem}` here: rename it" in done.stderr
