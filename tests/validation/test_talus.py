"""`talus`: one name for all commands, whose functions they share; what ships, a line each."""

import subprocess
import sys
from pathlib import Path

import pytest

from datasets.scene.library import SCENES
from inverse.problem import PROBLEMS
from tests.commands import ROOT, found_at
from tests.test_arrows import MAY_IMPORT
from validation import talus
from validation.talus import COMMANDS


def modules() -> set[str]:
    """Every module of ours that runs as `python -m`."""
    files = [path for name in MAY_IMPORT for path in (ROOT / name).rglob("*.py")]
    runs = [path.relative_to(ROOT) for path in files if '__name__ == "__main__"' in path.read_text()]
    return {".".join(path.with_suffix("").parts) for path in runs}


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
    assert {line.split()[1] for line in lines} <= {"2D", "3D"}


def test_help_loads_no_solver() -> None:
    code = (
        "import sys, gns.train, gns.rollout, gns.score; from validation.talus import main; main(['--help']); "
        "print({'taichi', 'torch'} & {*sys.modules})"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "set()"
    assert all(f" {name} " in done.stdout for name in COMMANDS)
