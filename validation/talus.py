"""talus COMMAND ...: the commands of all packages under one name; each is that of `python -m MODULE`, which stays."""

import os
import re
import runpy
import sys
from pathlib import Path

from datasets.command_line import run
from datasets.errors import InputError
from datasets.files import read_toml
from datasets.library import SCENES, find

MODULES = {
    "run": ("mpm.run", "run a scene by the MPM"),
    "generate": ("mpm.generate", "make a dataset of MPM runs"),
    "train": ("gns.train", "train a surrogate"),
    "rollout": ("gns.rollout", "run a scene by a surrogate"),
    "adapt": ("inverse.adapt", "train the surrogate on the box of a problem"),
    "invert": ("inverse", "find the unknowns of a problem by one forward model"),
    "solve": ("validation.loop", "find them with uncertainty, confirmed by the MPM"),
    "design": ("validation.design", "where barriers stand so that a limit is kept as often as asked"),
    "view": ("validation.view", "look at a flow, or at two, in a browser"),
    "compare": ("datasets.compare", "two flows side by side: fronts, profiles, energies"),
    "bench": ("validation.bench", "measure again what a page of the documentation shows"),
}
"""Of each command its module and what it does."""
PROBLEMS = Path(__file__).parents[1] / "inverse" / "problems"
DESIGNS = Path(__file__).parent / "design" / "problems"
LISTS = {
    "scenes": (SCENES, "the scenes that ship"),
    "problems": (PROBLEMS, "the inverse problems that ship"),
    "designs": (DESIGNS, "the design problems that ship"),
}
"""Of each list its folder and what is in it."""

SENTENCE = re.compile(r"(?<=[.?]) (?=[^a-z])")
"""Between two sentences."""


def described(path: Path) -> str:
    """A line on a scene or a problem in TOML: name, dimension, the first sentence of its comment."""
    table = read_toml(path)
    scene = table.get("scene", table)
    if isinstance(scene, str):
        scene = read_toml(find(scene, SCENES, "scene"))
    comment: list[str] = []
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        comment.append(line.lstrip("# "))
    return f"{path.stem:28s} {len(scene['domain']['size'])}D  {SENTENCE.split(' '.join(comment))[0].rstrip('.')}"


def usage() -> str:
    """What `talus --help` prints."""
    lines = [f"  {name:10s}{what}" for name, (_, what) in (MODULES | LISTS).items()]
    return "\n".join(["Usage: talus COMMAND ...", "", *lines, "", "talus COMMAND --help explains one of them."])


def command(*arguments: str) -> None:
    """Print what ships, or how to use the commands. Raises InputError."""
    if arguments in ((), ("-h",), ("--help",)):
        print(usage())
    elif len(arguments) == 1 and arguments[0] in LISTS:
        print("\n".join(map(described, sorted(LISTS[arguments[0]][0].glob("*.toml"), key=lambda path: path.stem))))
    else:
        raise InputError(f"expected one of {', '.join([*MODULES, *LISTS])}", key=" ".join(arguments))


def main() -> int:
    """Run the command that is named on the command line, as `python -m` runs its module, with its exit status."""
    name = sys.argv[1] if len(sys.argv) > 1 else ""
    if name in MODULES:
        sys.argv = sys.argv[1:]
        runpy.run_module(MODULES[name][0], run_name="__main__", alter_sys=True)
        return 0
    try:
        status = run(lambda: command(*sys.argv[1:]), "talus", [])
        sys.stdout.flush()
    except BrokenPipeError:
        # Of `talus scenes | head`. Python would flush once more.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    return status


if __name__ == "__main__":
    sys.exit(main())
