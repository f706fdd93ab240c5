"""Commands and blocks of code as the pages print them, and how to try a command without doing its work."""

import functools
import inspect
import re
import shlex
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from datasets import command_line
from validation.talus import COMMANDS

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


def command_of(module: str, name: str = "") -> Callable[..., Any]:
    """The function that `python -m module` runs, with a further name that of a page of `validation.bench`."""
    (place,) = [place for place, _ in COMMANDS.values() if place.split(":")[0].removesuffix(".__main__") == module]
    return resolve_name(resolve_name(place)[name][0] if name else place)


def status(module: str, arguments: list[str], *, works: bool = True) -> int:
    """The exit status of a command; its arguments are read and converted, but no more, unless it `works`.

    `--out` is added where prose leaves it out.
    """
    page = module == "validation.bench" and not arguments[0].startswith("-")
    command, arguments = command_of(module, arguments[0] if page else ""), arguments[page:]
    needs = not isinstance(command, Mapping) and "out" in inspect.signature(command).parameters
    if needs and not {"--out", "--help"} & set(arguments):
        arguments = [*arguments, "--out", "DIR"]
    if works or isinstance(command, Mapping):
        return command_line.run(command, f"python -m {module}", arguments)

    @functools.wraps(command)
    def tried(*_: Any, **__: Any) -> None:
        """Does nothing."""

    return command_line.run(tried, f"python -m {module}", arguments)
