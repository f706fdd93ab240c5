"""The arrows between the folders, held on every module: who may import whom, what nobody may, how long a file is."""

import ast
import subprocess
import sys
from collections.abc import Iterator, Mapping, Set
from pathlib import Path

import networkx
import pytest

ROOT = Path(__file__).parents[1]

MAY_IMPORT = {
    "datasets": set[str](),
    "mpm": {"datasets"},
    "gns": {"datasets"},
    "inverse": {"datasets", "mpm", "gns"},
    "validation": {"datasets", "mpm", "gns", "inverse"},
}
BANNED = {"datasets": {"taichi", "torch"}, "mpm": {"torch"}, "gns": {"taichi"}}
PICKLERS = {"dill", "cloudpickle", "joblib", "shelve", "marshal"}
PICKLE_ERRORS = {"PickleError", "UnpicklingError"}
"""The part of `pickle` that one may name: what torch raises for a file that is none of its own."""
RESTRICTED = {"datasets/exchange/geoelements.py": {"Unpickler", "allow_pickle=True"}}
"""The module that may name more: an unpickler that can make arrays alone, and what writes pickled sets."""
UNSAFE = {"allow_pickle=True", "weights_only=False"}
"""Arguments that would let a file run code; both are off by default."""
LONGEST = 400

MODULES = sorted(path for folder in MAY_IMPORT for path in (ROOT / folder).rglob("*.py"))


def imports(tree: ast.AST) -> Iterator[tuple[int, str, list[str]]]:
    """Line, module and names taken from it of every absolute import: at the top, late, for types alone, by a call."""
    for node in ast.walk(tree):
        match node:
            case ast.Import(names=names):
                yield from ((node.lineno, alias.name, []) for alias in names)
            case ast.ImportFrom(module=str(module), names=names, level=0):
                yield node.lineno, module, [alias.name for alias in names]
            case ast.Call(func=function, args=[ast.Constant(value=str(module)), *_]) if ast.unparse(function).endswith(
                ("import_module", "__import__")
            ):
                yield node.lineno, module, []


def breaches(text: str, folder: str, restricted: Set[str] = frozenset()) -> list[str]:
    """What a module of `folder` does against the design, one line each."""
    tree = ast.parse(text)
    banned = (MAY_IMPORT.keys() - MAY_IMPORT[folder] - {folder}) | BANNED.get(folder, set()) | PICKLERS
    lines = [f"{line}: imports {module}" for line, module, _ in imports(tree) if module.split(".")[0] in banned]
    for node in ast.walk(tree):
        match node:
            case ast.Attribute(value=ast.Name(id="pickle"), attr=name) if name not in PICKLE_ERRORS | restricted:
                lines.append(f"{node.lineno}: uses pickle.{name}")
            case ast.ImportFrom(module="pickle", names=names) if {alias.name for alias in names} - PICKLE_ERRORS:
                lines.append(f"{node.lineno}: imports from pickle")
        if isinstance(node, ast.keyword) and f"{node.arg}={ast.unparse(node.value)}" in UNSAFE - restricted:
            lines.append(f"{node.value.lineno}: loads anything")
    if text.count("\n") > LONGEST:
        lines.append(f"{text.count(chr(10))} lines; {LONGEST} are the most")
    return lines


def test_the_arrows() -> None:
    paths = {path.relative_to(ROOT).as_posix(): path for path in MODULES}
    seen = {
        name: breaches(path.read_text(), name.split("/")[0], RESTRICTED.get(name, frozenset()))
        for name, path in paths.items()
    }
    assert {name: lines for name, lines in seen.items() if lines} == {}
    for folder, text in (
        ("datasets", "def late():\n    from torch import nn"),
        ("mpm", "import importlib\nimportlib.import_module('torch')"),
        ("gns", "import torch\ntorch.load('weights.pt', weights_only=False)"),
        ("inverse", "import pickle\npickle.loads(b'')"),
        ("inverse", "\n" * 401),
    ):
        assert len(breaches(text, folder)) == 1


def imported(tree: ast.AST, ours: Set[str]) -> Iterator[str]:
    """The modules of `ours` that a module imports."""
    for _, module, names in imports(tree):
        inner = [submodule for name in names if (submodule := f"{module}.{name}") in ours]
        yield from inner or [module] * (module in ours)


def circles(texts: Mapping[str, str]) -> list[list[str]]:
    """Modules, each with its text, that import each other in a circle."""
    graph = networkx.DiGraph()
    for name, text in texts.items():
        graph.add_edges_from((name, other) for other in imported(ast.parse(text), texts.keys()) if other != name)
    graph.remove_edges_from(UPWARDS)
    return [sorted(component) for component in networkx.strongly_connected_components(graph) if len(component) > 1]


UPWARDS = {("datasets.flow.trajectory", "datasets.exchange.page")}
"""The one import of what stands above: `Trajectory.view` draws itself."""


def test_no_files_import_each_other_in_a_circle() -> None:
    names = [".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__") for path in MODULES]
    texts = {name: path.read_text() for name, path in zip(names, MODULES, strict=True)}
    assert circles(texts) == []
    late = {"a": "from b import other", "b": "if TYPE_CHECKING:\n    from a import Thing"}
    assert circles(late) == [["a", "b"]]


@pytest.mark.parametrize("folders", [("datasets", "gns"), ("mpm",)])
def test_nothing_banned_comes_in_by_the_back_door(folders: tuple[str, ...]) -> None:
    modules = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in MODULES if path.parts[-1][0] != "_"]
    code = "import sys; found = set()\n"
    for folder in folders:
        ours = [module for module in modules if module.startswith(f"{folder}.")]
        code += f"import {', '.join(ours)}\nfound |= sys.modules.keys() & {BANNED[folder]!r}\n"
    code += "print(*found)"
    result = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert result.stdout.splitlines()[-1] == ""
