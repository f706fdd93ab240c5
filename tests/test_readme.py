"""What the README tells a newcomer to type is there."""

import importlib.util
import re
from pathlib import Path

import pytest

from datasets.library import SCENES
from inverse.problem import PROBLEMS

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
COMMANDS = re.findall(r"`python -m ([^\s`]+) ?([^`]*)`", README)


def test_there_are_commands() -> None:
    assert len(COMMANDS) >= 8


@pytest.mark.parametrize(("module", "arguments"), COMMANDS)
def test_a_command_exists_with_its_flags(module: str, arguments: str) -> None:
    spec = importlib.util.find_spec(module)
    assert spec is not None
    if spec.submodule_search_locations:
        spec = importlib.util.find_spec(f"{module}.__main__")
    assert spec is not None
    assert spec.origin is not None
    source = Path(spec.origin).read_text()
    assert f'"python -m {module}"' in source
    for flag in re.findall(r"--([a-z-]+)", arguments):
        assert re.search(rf"\b{flag.replace('-', '_')}: ", source), flag
    for scene in re.findall(r"\bcolumn-\S+", arguments):
        assert (SCENES / f"{scene}.toml").exists()
    for problem in re.findall(r"\bfriction-\S+", arguments):
        assert (PROBLEMS / f"{problem}.toml").exists()


@pytest.mark.parametrize("target", re.findall(r"\bmake ([a-z-]+)", README))
def test_a_make_target_exists(target: str) -> None:
    assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.MULTILINE)


@pytest.mark.parametrize("link", re.findall(r"\]\(([^)#:]+)\)", README))
def test_a_linked_file_exists(link: str) -> None:
    assert (ROOT / link).exists()
