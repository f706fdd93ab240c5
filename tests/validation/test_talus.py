"""`talus`: one name for all commands; what ships, a line each."""

import subprocess
import sys
from pathlib import Path

import pytest

from datasets.scene.library import SCENES
from inverse.problem import PROBLEMS
from tests.commands import ROOT
from validation import talus
from validation.talus import COMMANDS


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
    assert {line.split()[1] for line in lines} <= {"2D", "3D"}


def test_help_loads_no_solver() -> None:
    modules = ", ".join(place.partition(":")[0] for place, _ in COMMANDS.values() if not place.startswith("mpm."))
    code = (
        f"import sys, {modules}; from validation.talus import main; main(['--help']); "
        "print({'taichi', 'torch'} & {*sys.modules})"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "set()"
    assert all(f" {name} " in done.stdout for name in COMMANDS)
