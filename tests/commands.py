"""Commands and blocks of code as the pages print them, and how to try a command without doing its work."""

import ast
import functools
import importlib.util
import inspect
import re
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from datasets import command_line
from validation.bench import __main__ as benches

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
DOCS = ROOT / "docs"
MEASURED = re.compile(r"\]\((\w[\w-]*\.md)\)")
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
COMMAND = re.compile(r"python -m ((?:datasets|mpm|gns|inverse|validation)[\w.]*)([^\n`]*)")


def measured_pages() -> set[Path]:
    """Pages that a command writes: those that `docs/measured.md` links to."""
    return {DOCS / name for name in MEASURED.findall((DOCS / "measured.md").read_text())}


def written_pages() -> list[Path]:
    """README and the pages of `docs` that are written by hand."""
    return [README, *sorted(set(DOCS.rglob("*.md")) - measured_pages())]


def blocks(page: Path, language: str) -> list[str]:
    """The fenced blocks of a page in `language`, in their order."""
    return [text for name, text in BLOCK.findall(page.read_text()) if name == language]


def commands(page: Path) -> Iterator[tuple[str, list[str]]]:
    """Module and arguments of every command on a page; without those that only name a module or stand for many."""
    text = re.sub(r"\\\n\s*", " ", page.read_text())
    for module, rest in COMMAND.findall(text):
        arguments = shlex.split(rest.replace("[", "").replace("]", ""), comments=True)
        if arguments and "..." not in rest and arguments[0] != "NAME":
            yield module, arguments


def command_of(module: str) -> Callable[..., Any]:
    """The function that `python -m module` hands to `datasets.command_line.run`."""
    spec = importlib.util.find_spec(module)
    assert spec is not None, module
    home = importlib.import_module(f"{module}.__main__" if spec.submodule_search_locations else module)
    calls = [node for node in ast.walk(ast.parse(inspect.getsource(home))) if isinstance(node, ast.Call)]
    name = repr(f"python -m {module}")
    (function,) = [ast.unparse(call.args[0]) for call in calls if name in map(ast.unparse, call.args)]
    return getattr(home, function)


def status(module: str, arguments: list[str], *, works: bool = True) -> int:
    """The exit status of a command; its arguments are read and converted, but no more, unless it `works`.

    `--out` is added where prose leaves it out.
    """
    if module == "validation.bench":
        if arguments[0].startswith("-"):
            return benches.main(arguments)
        command = benches.command_of(benches.bench_of(arguments[0]))
        arguments = arguments[1:]
    else:
        command = command_of(module)
    if "out" in inspect.signature(command).parameters and not {"--out", "--help"} & set(arguments):
        arguments = [*arguments, "--out", "DIR"]

    @functools.wraps(command)
    def tried(*_: Any, **__: Any) -> None:
        """Does nothing."""

    return command_line.run(command if works else tried, f"python -m {module}", arguments)
