"""talus COMMAND ...: the commands of all packages under one name; `python -m MODULE` calls the same functions."""

import re
import sys
from collections.abc import Sequence
from pathlib import Path

from datasets.command_line import run
from datasets.files import read_toml
from datasets.scene.library import SCENES, find

COMMANDS = {
    "site": ("datasets.site:command", "write a scene from a raster of elevations and a release polygon"),
    "run": ("mpm.run:command", "simulate a scene with the MPM"),
    "generate": ("mpm.generate:command", "make a dataset of MPM runs"),
    "train": ("gns.train:train", "train a surrogate"),
    "rollout": ("gns.rollout:rollout", "predict a scene with a surrogate"),
    "score": ("gns.score:score", "measure the errors of a surrogate on a dataset"),
    "adapt": ("inverse.adapt:main", "train a surrogate for one inverse problem"),
    "invert": ("inverse.__main__:main", "solve an inverse problem with one forward model"),
    "solve": ("validation.loop.__main__:main", "solve an inverse problem; the MPM confirms the answer"),
    "design": ("validation.design.__main__:main", "find a barrier design that keeps a limit"),
    "forecast": ("validation.forecast.__main__:main", "predict another scene with the result of an inversion"),
    "view": ("validation.view:command", "write one or two flows as an HTML page"),
    "vtk": ("validation.vtk:command", "convert a flow for ParaView, draw a picture"),
    "compare": ("datasets.compare:command", "compare two flows: fronts, profiles, energies"),
    "maps": ("datasets.maps:command", "write thickness, depth and velocity of a flow as rasters"),
    "forces": ("datasets.forces:command", "write the force on each solid over time"),
    "exchange": ("datasets.exchange.__main__:command", "convert datasets to and from the format of another code"),
    "demo": ("validation.demo:main", "find a secret friction angle from the front of a deposit"),
    "bench": ("validation.bench.__main__:PAGES", "repeat the measurements of a documentation page"),
    "scenes": ("validation.talus:scenes", "list the shipped scenes"),
    "problems": ("validation.talus:problems", "list the shipped inverse problems"),
    "designs": ("validation.talus:designs", "list the shipped design problems"),
}
PROBLEMS = Path(__file__).parents[1] / "inverse" / "problems"
DESIGNS = Path(__file__).parent / "design" / "problems"
SENTENCE = re.compile(r"(?<=[.?]) (?=[^a-z])")  # between two sentences


def scenes() -> str:
    """List the shipped scenes: name, dimension, description."""
    return listed(SCENES)


def problems() -> str:
    """List the shipped inverse problems: name, dimension, unknowns."""
    return listed(PROBLEMS)


def designs() -> str:
    """List the shipped design problems: name, dimension, design."""
    return listed(DESIGNS)


def listed(folder: Path) -> str:
    """A line for each file of a folder: name, dimension, the first sentence of its comment."""
    lines = []
    for path in sorted(folder.glob("*.toml"), key=lambda path: path.stem):
        table = read_toml(path)
        scene = table.get("scene", table)
        if isinstance(scene, str):
            scene = read_toml(find(scene, SCENES, "scene"))
        comment = re.match(r"(?:#.*\n)*", path.read_text(encoding="utf-8"))
        assert comment is not None, "it may be empty"
        text = " ".join(line.lstrip("# ") for line in comment[0].splitlines())
        lines.append(f"{path.stem:28s} {len(scene['domain']['size'])}D  {SENTENCE.split(text)[0].rstrip('.')}")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command named on the command line, and return its exit status."""
    return run(COMMANDS, "talus", arguments)


if __name__ == "__main__":
    sys.exit(main())
